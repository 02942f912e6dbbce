r"""Parameters over time by recursive least squares, eqs. (12) and (13).

The recursion runs over the rows that the batch form (11) adds up at the estimate θ, one sample
after the other, so that without forgetting it ends at θ plus the increment of that pass:

    θ(t) = θ + Δ̂(t),   Δ̂ = A⁻¹ Σ λ^age ζᵀ e,   A = Σ λ^age ζᵀ φ

with e = F[u_eq] and ζ = φ = F[∂f/∂θ], or with instrumental variables ζ. Its covariance is
σ² A⁻¹ J A⁻ᵀ with J = Σ λ^(2 age) ζᵀζ. Residuals are coloured: σ² is taken for each parameter such
that the band of all samples is the standard error of the estimate (`robust_covariance.py`).

It follows the iteration, as a loop of its own. Inside a pass it would come too early: which pass is
the best one, the weights 1/P_j of the outputs and which parameters stay on their bounds are known
at the end of a pass, instruments after all of them. The rows are there already, for the standard
errors and the drifts. In real time, where one step must do it all, `OnlineEstimator.step` is the
step of the pass and that of the recursion.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import check, real
from eoi_jax._display import Result
from eoi_jax.data.record import Record
from eoi_jax.estimation.parameter_drift import ParameterDrift, find_drifts
from eoi_jax.estimation.parameter_recursion import recursion_over_rows
from eoi_jax.estimation.regression.recursive_least_squares import RecursiveLeastSquares
from eoi_jax.estimation.regression.sample_rows import SampleRows, normal_equations
from eoi_jax.models.plant import Plant


@dataclass(frozen=True, eq=False, repr=False)
class ParameterHistory(Result):
    """Parameters over time; the records follow each other in the order of `identify`.

    `plot` shows each parameter with its 95 % interval along the first record.

    Attributes:
        names: of the parameters.
        records: names.
        time: of each record's samples [s], one array (N,) per record.
        values: the estimate from the samples so far, one array (N, np) per record; NaN as long as
            they leave a parameter open.
        standard_errors: of `values`, likewise; infinite where they leave a parameter open.
        forgetting: λ, by which the weight of past samples falls with each sample.
        drifts: parameters that change.
        units: of the parameters.
    """

    names: tuple[str, ...]
    records: tuple[str, ...]
    time: list[np.ndarray]
    values: list[np.ndarray]
    standard_errors: list[np.ndarray]
    forgetting: float
    drifts: tuple[ParameterDrift, ...] = ()
    units: tuple[str, ...] = ()


def check_forgetting(recursive: bool, forgetting: float) -> float:
    """Check the arguments of `identify`.

    Args:
        recursive: whether parameters over time are asked for.
        forgetting: λ.

    Raises:
        ValueError: a factor outside (0, 1], or one that nothing uses.
    """
    RecursiveLeastSquares(forgetting)
    rule = "must be 1 without `recursive=True`, which it belongs to"
    check(recursive or real(forgetting) == 1.0, "forgetting", rule, forgetting)
    return real(forgetting)


def parameter_history(
    plant: Plant,
    rows: SampleRows,
    records: Sequence[Record],
    errors: Float[np.ndarray, " np"],
    forgetting: float,
) -> ParameterHistory:
    """Parameters over time, from the rows of the estimate.

    Args:
        plant: with the estimate.
        rows: at the estimate.
        records: as used.
        errors: standard errors of the estimate, shape (np,).
        forgetting: λ.
    """
    increments, variances = recursion_over_rows(RecursiveLeastSquares(forgetting), rows)
    theta, free = np.asarray(plant.theta), np.any(rows.zeta != 0.0, axis=(0, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(free, errors**2 / _variance(rows.zeta, rows.regressors), 1.0)
        deviations = np.where(free, np.sqrt(ratio * variances), np.where(errors > 0, errors, 0.0))
    values = np.where(np.isfinite(variances) | ~free, theta + increments, np.nan)
    first = np.where(free, np.nan, theta), np.where(free, np.inf, 0.0)
    return ParameterHistory(
        tuple(plant.names),
        tuple(record.name for record in records),
        [np.asarray(record.time) for record in records],
        _at_samples(rows, records, values, first[0]),
        _at_samples(rows, records, deviations, first[1]),
        forgetting,
        find_drifts(plant, rows, records),
        tuple(plant.units.get(name, "") for name in plant.names),
    )


def _at_samples(
    rows: SampleRows,
    records: Sequence[Record],
    values: Float[np.ndarray, "samples np"],
    first: Float[np.ndarray, " np"],
) -> list[np.ndarray]:
    """Values at every sample, (N, np) per record: those after the last row that led there."""
    placed = []
    for i, record in enumerate(records):
        own = rows.record == i
        last = np.full(len(record), -1)
        last[rows.sample[own]] = np.flatnonzero(own)
        last[0] = max(last[0], np.max(np.flatnonzero(rows.record < i), initial=-1))
        last = np.maximum.accumulate(last)
        placed.append(np.where((last < 0)[:, None], first, values[last]))
    return placed


def _variance(
    zeta: Float[np.ndarray, "samples rows np"], phi: Float[np.ndarray, "samples rows np"]
) -> Float[np.ndarray, " np"]:
    """Diagonal of A⁻¹ J A⁻ᵀ of all samples; zero for what is not estimated."""
    used = np.any(zeta != 0.0, axis=(0, 1))
    sums = normal_equations(np.zeros(zeta.shape[:2]), phi[..., used], zeta[..., used])
    variance = np.zeros(len(used))
    if sums.determined():
        variance[used] = np.diagonal(sums.covariance)
    return variance
