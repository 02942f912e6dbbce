r"""Parameters that are not constant along the records.

At every candidate time the record is split in two, and the estimates of both parts, by one linear
step from that of all samples, are compared by Wald's statistic. At its maximum each parameter's
difference is judged, with σ² from the residuals of parameters that are polynomials of time before
and after it: those of constant ones would count a drift as noise. As in `robust_covariance.py`, σ²
is the mean square of the scores' cosine coefficients, here without the lowest ones, which the
polynomials take. Where a model is not linear in its parameters one step is not enough: what is
told are the estimates of both parts by themselves (`part_estimates.py`).

The chance that the largest of many statistics exceeds c is, for samples between the shares q and
1 - q of a record,

    P ≈ √(c/2π) e^(-c/2) [(1 - 1/c) log((1-q)²/q²) + 2/c]

(B. James, K. James, D. Siegmund, Biometrika 74 (1987) 71; the critical values are those of D.
Andrews, Econometrica 61 (1993) 821), times the number of parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from eoi_jax.data.record import Record
from eoi_jax.estimation.regression.robust_covariance import (
    cosine_count,
    cosine_sums,
    independent_samples,
)
from eoi_jax.estimation.regression.sample_rows import NormalEquations, SampleRows, normal_equations
from eoi_jax.models.plant import Plant


@dataclass(frozen=True)
class DriftSettings:
    """When a parameter is said to drift."""

    margin: float = 0.15  # share of the samples at both ends in which no change is sought
    candidates: int = 200  # times at which the samples are split
    degrees: tuple[int, ...] = (3, 1, 0)  # of the polynomials; the first that the samples allow
    independent: float = 8.0  # independent samples for each parameter of the polynomials of one θ
    min_cosines: int = 4
    min_change: float = 1e-3  # over the larger value; discretisation may change one by less
    min_deviations: float = 3.0  # standard errors of estimates of both parts by themselves
    max_probability: float = 1e-3  # of such a change by chance, over all times and parameters


_SETTINGS = DriftSettings()


@dataclass(frozen=True)
class ParameterDrift:
    """A parameter whose estimate changes along the records.

    Attributes:
        parameter: name.
        record: name of the record in which it changes most.
        time: of that change [s].
        before, after: estimates from the samples before and after that time.
        errors: their standard errors.
        probability: of such a change by chance.
        unit: of the parameter.
        place: of the change, index of the record and of the sample in it.
        degrees_of_freedom: of the noise by which it is judged.
        tested: parameters of which changes were sought.
    """

    parameter: str
    record: str
    time: float
    before: float
    after: float
    errors: tuple[float, float]
    probability: float
    unit: str = ""
    place: tuple[int, int] = (0, 0)
    degrees_of_freedom: float = np.inf
    tested: int = 1

    @property
    def sentence(self) -> str:
        """What changes, when, and how sure that is."""
        unit = f" {self.unit}" if self.unit else ""
        return (
            f"{self.parameter} is not constant: {self.before:.4g} ± {self.errors[0]:.1g}{unit} "
            f"before {self.time:.4g} s of {self.record}, {self.after:.4g} ± {self.errors[1]:.1g}"
            f"{unit} after (by chance: {self.probability:.1g}). Either it changes, or what the "
            "model lacks does"
        )


def find_drifts(
    plant: Plant, rows: SampleRows, records: Sequence[Record], settings: DriftSettings = _SETTINGS
) -> tuple[ParameterDrift, ...]:
    """Parameters whose estimates before and after some time differ by more than their errors.

    Args:
        plant: with the estimate, from which the rows are.
        rows: of all records.
        records: as used.
        settings: when a change counts.
    """
    used = np.flatnonzero(np.any(rows.zeta != 0.0, axis=(0, 1)))
    scored = np.flatnonzero(rows.scored)
    found = _most_likely_split(rows, used, scored, settings)
    if found is None:
        return ()
    split, earlier, after = found
    noise = _residual_variance(rows, used, split, earlier + after, settings)
    if noise is None:
        return ()
    place = int(rows.record[split]), int(rows.sample[split])
    record, theta = records[place[0]], np.asarray(plant.theta)[used]
    values = [theta + part.estimate for part in (earlier, after)]
    variances = [noise[0] * np.diagonal(part.covariance) for part in (earlier, after)]
    drifts = []
    for k, i in enumerate(used):
        drift = ParameterDrift(
            parameter=plant.names[i],
            record=record.name,
            time=float(record.time[place[1]]),
            before=float(values[0][k]),
            after=float(values[1][k]),
            errors=(float(np.sqrt(variances[0][k])), float(np.sqrt(variances[1][k]))),
            probability=1.0,
            unit=plant.units.get(plant.names[i], ""),
            place=place,
            degrees_of_freedom=noise[1],
            tested=len(used),
        )
        drifts.append(_judged(drift, drift.errors, settings))
    return tuple(drift for drift in drifts if drift is not None)


def own_drifts(
    drifts: Sequence[ParameterDrift], fits: Sequence[Any], settings: DriftSettings = _SETTINGS
) -> tuple[ParameterDrift, ...]:
    """Drifts as two estimates say, those of the samples before and after the change.

    A change counts where it is more than the noise explains that the linear step is judged by, and
    some standard errors of the estimates: these contain what drifts on both sides of the change.

    Args:
        drifts: by a linear step, all with one change.
        fits: two `Identification`s.
        settings: when a change counts.
    """
    judged = []
    for drift in drifts:
        before, after = (fit.parameters[drift.parameter] for fit in fits)
        errors = tuple(fit.standard_errors[drift.parameter] for fit in fits)
        if abs(after - before) > settings.min_deviations * np.hypot(*errors):
            changed = replace(drift, before=before, after=after, errors=errors)
            judged.append(_judged(changed, drift.errors, settings))
    return tuple(drift for drift in judged if drift is not None)


def _judged(
    drift: ParameterDrift, errors: tuple[float, float], settings: DriftSettings
) -> ParameterDrift | None:
    """The drift with its probability, given these standard errors; None where it is none."""
    change, variance = abs(drift.after - drift.before), float(np.sum(np.square(errors)))
    single = _chance(change, variance, drift.degrees_of_freedom, settings)
    probability = min(single * drift.tested, 1.0)
    least = settings.min_change * max(abs(drift.before), abs(drift.after))
    if not (probability <= settings.max_probability and change > least):
        return None
    return replace(drift, probability=probability)


def _most_likely_split(
    rows: SampleRows,
    used: Int[np.ndarray, " k"],
    scored: Int[np.ndarray, " some"],
    settings: DriftSettings,
) -> tuple[int, NormalEquations, NormalEquations] | None:
    """The sample from which on the estimate differs most, and the sums before and after it."""
    edges = np.linspace(settings.margin, 1.0 - settings.margin, settings.candidates)
    places = np.unique(scored[(edges * (len(scored) - 1)).astype(int)]) if len(scored) else scored
    best = _best_split(rows, used, places)
    if best is None:
        return None
    # The samples between the neighbours of the best candidate.
    middle = int(np.searchsorted(places, best[0]))
    ends = places[max(middle - 1, 0)], places[min(middle + 1, len(places) - 1)]
    close = scored[(scored >= ends[0]) & (scored <= ends[1])]
    chosen = np.linspace(0, len(close) - 1, min(len(close), settings.candidates)).astype(int)
    return _best_split(rows, used, close[chosen]) or best


def _best_split(
    rows: SampleRows, used: Int[np.ndarray, " k"], places: Int[np.ndarray, " some"]
) -> tuple[int, NormalEquations, NormalEquations] | None:
    """Of these samples that with the largest statistic of Wald, and the sums before and after."""
    if not len(places):
        return None
    zeta, phi = rows.zeta[..., used], rows.regressors[..., used]
    bounds = [0, *places.tolist(), len(rows.error)]
    pieces = [slice(*ends) for ends in pairwise(bounds)]
    sums = [normal_equations(rows.error[piece], phi[piece], zeta[piece]) for piece in pieces]
    totals = list(accumulate(sums))
    best, largest = None, 0.0
    for place, earlier in zip(places, totals[:-1], strict=True):
        after = totals[-1] - earlier
        if earlier.determined() and after.determined():
            change = after.estimate - earlier.estimate
            wald = change @ np.linalg.solve(earlier.covariance + after.covariance, change)
            if wald > largest:
                best, largest = (int(place), earlier, after), wald
    return best


def _residual_variance(
    rows: SampleRows,
    used: Int[np.ndarray, " k"],
    split: int,
    sums: NormalEquations,
    settings: DriftSettings,
) -> tuple[Float[np.ndarray, " k"], float] | None:
    """σ² for each parameter, and its degrees of freedom; None where the samples are too few."""
    zeta, phi = rows.zeta[..., used], rows.regressors[..., used]
    for degree in settings.degrees:
        parts = slice(None, split), slice(split, None)
        scores = [_scores(rows.error[part], phi[part], zeta[part], degree) for part in parts]
        if scores[0] is None or scores[1] is None:
            continue
        joined = np.concatenate([scores[0], scores[1]])
        lengths = np.unique(rows.record, return_counts=True)[1].tolist()
        independent, taken = independent_samples(joined, lengths), 2 * (degree + 1)
        if independent < settings.independent * taken:
            continue
        count = max(cosine_count(independent), settings.min_cosines)
        waves = np.sqrt(2.0) * cosine_sums(joined.T, taken + count)[:, taken:]
        inverse = np.linalg.inv(sums.cross)
        covariance = inverse @ (waves @ waves.T / waves.shape[1]) @ inverse.T
        return np.diagonal(covariance) / np.diagonal(sums.covariance), float(waves.shape[1])
    return None


def _scores(
    error: Float[np.ndarray, "samples rows"],
    phi: Float[np.ndarray, "samples rows k"],
    zeta: Float[np.ndarray, "samples rows k"],
    degree: int,
) -> Float[np.ndarray, "samples k"] | None:
    """Σ ζᵀ(e - φ Δ̂(t)) of each sample, Δ̂ a polynomial of time; None if it is not determined."""
    samples, _, size = phi.shape
    powers = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, samples), degree)
    # φ times all powers of time at once would take several times the memory of the rows.
    products = np.einsum("sja,sjb->sab", zeta, phi)
    cross = np.einsum("si,sk,sab->iakb", powers, powers, products, optimize=True)
    rhs = np.einsum("si,sja,sj->ia", powers, zeta, error, optimize=True)
    squares = np.einsum("sja,sja->sa", zeta, zeta)
    alone = np.einsum("si,sa->ia", powers**2, squares).ravel()
    count = (degree + 1) * size
    sums = NormalEquations(cross.reshape(count, count), np.diag(alone), rhs.ravel())
    if not sums.determined():
        return None
    increments = powers @ sums.estimate.reshape(degree + 1, size)
    return np.einsum("sja,sj->sa", zeta, error) - np.einsum("sab,sb->sa", products, increments)


def _chance(change: float, variance: float, freedom: float, settings: DriftSettings) -> float:
    """Chance of such a change of a constant parameter, at the best of all times.

    Student's t as the normal deviate of the same chance in the formula of the module's docstring.
    """
    from scipy.stats import norm, t

    if not variance > 0:
        return 1.0
    single = float(t.logsf(abs(change) / np.sqrt(variance), min(freedom, 1e9)))
    c = float(norm.isf(np.exp(max(single, -700.0)))) ** 2
    q = settings.margin
    if c <= 1.0:
        return 1.0
    crossings = (1.0 - 1.0 / c) * 2.0 * np.log((1.0 - q) / q) + 2.0 / c
    return float(min(np.sqrt(c / (2.0 * np.pi)) * np.exp(-0.5 * c) * crossings, 1.0))
