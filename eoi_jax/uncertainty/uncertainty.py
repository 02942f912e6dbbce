r"""How sure an estimate is: errors, intervals, what cannot be told apart, physical parameters.

The covariance C is that of the estimate, which knows that its residual is coloured. The degrees of
freedom ν of each variance say how sure that one is: intervals are θ ± t_ν √C_ii. Other quantities
q = g(θ) have the covariance J C Jᵀ, J = ∂g/∂θ (delta method), and the fewest degrees of freedom of
what they depend on. Directions of θ that left no trace are kept beside C: what changes along one of
them has no finite error.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from eoi_jax._checks import check, check_kind, is_or_are, real
from eoi_jax._display import Result
from eoi_jax.estimation.common_factors import listed
from eoi_jax.estimation.degrees_of_freedom import student
from eoi_jax.estimation.identify import Identification
from eoi_jax.estimation.regression.identifiability import (
    format_direction,
    groups_of,
    identifiable_combinations,
)
from eoi_jax.estimation.regression.least_squares import unidentified_directions
from eoi_jax.models.parameters import parameter_type
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.result import Refinement


@dataclass(frozen=True, eq=False, repr=False)
class Uncertainty(Result):
    """Estimates with their covariance.

    `plot` shows parameters with their intervals, and their correlation.

    Attributes:
        parameters: estimates by name.
        covariance: of them, shape (np, np); 0 for what is fixed, NaN where it is not known.
        degrees_of_freedom: of each variance, shape (np,); infinite where they are not known.
        untraced: directions that left no trace, one a column, shape (np, k).
        unclear: sentences on what ended on a bound, and what cannot, or can hardly, be told apart.
        units: by name, as far as they are known.
        draws: estimates of a bootstrap, shape (resamples, np); None without.
        lower, upper: bounds, which intervals keep, shape (np,); None without.
    """

    parameters: dict[str, float]
    covariance: Float[np.ndarray, "np np"]
    degrees_of_freedom: Float[np.ndarray, " np"]
    untraced: Float[np.ndarray, "np k"]
    unclear: tuple[str, ...]
    units: dict[str, str]
    draws: Float[np.ndarray, "resamples np"] | None = None
    lower: Float[np.ndarray, " np"] | None = None
    upper: Float[np.ndarray, " np"] | None = None

    @property
    def standard_errors(self) -> dict[str, float]:
        """By name; infinite where the data leave a parameter open, NaN for one on its bound."""
        errors = np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))
        errors = np.where(np.any(self.untraced != 0, axis=1), np.inf, errors)
        return {name: float(error) for name, error in zip(self.parameters, errors, strict=True)}

    @property
    def correlation(self) -> Float[np.ndarray, "np np"]:
        """Of the estimates; NaN where one of the two has no finite error above zero."""
        errors = np.asarray(list(self.standard_errors.values()))
        finite_errors = np.where(np.isfinite(errors) & (errors > 0), errors, np.nan)
        return self.covariance / np.outer(finite_errors, finite_errors)

    def intervals(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Confidence intervals by name.

        Args:
            level: the share of experiments whose interval holds the truth.

        Returns:
            (low, high): symmetric, from the t distribution; of a bootstrap the quantiles of its
            draws, at a level that makes up for their narrowness (T. Hesterberg, The American
            Statistician 69 (2015) 371, "expanded percentile"). They end at bounds, beyond which the
            truth cannot be. A fixed parameter has no width, one that the data leave open no ends
            but its bounds, and one on its bound NaN.

        Raises:
            ValueError: a level outside (0, 1).
        """
        check(0.0 < real(level) < 1.0, "level", "must lie in (0, 1)", level)
        quantile = student(level, self.degrees_of_freedom)
        value = np.asarray(list(self.parameters.values()))
        half_width = quantile * np.asarray(list(self.standard_errors.values()))
        ends = (
            (value - half_width, value + half_width)
            if self.draws is None
            else self._percentiles(quantile)
        )
        lower = -np.inf if self.lower is None else self.lower
        upper = np.inf if self.upper is None else self.upper
        kept = [np.clip(end, lower, upper) for end in ends]
        return {
            name: (float(low), float(high))
            for name, low, high in zip(self.parameters, *kept, strict=True)
        }

    def _percentiles(self, quantile: Float[np.ndarray, " np"]) -> tuple[np.ndarray, np.ndarray]:
        from scipy.special import ndtr

        tails = ndtr(-quantile * np.sqrt(1.0 + 1.0 / self.degrees_of_freedom))
        draws = np.asarray(self.draws).T
        low, high = (
            [np.quantile(values, tail) for values, tail in zip(draws, probabilities, strict=True)]
            for probabilities in (tails, 1.0 - tails)
        )
        return np.asarray(low), np.asarray(high)

    def physical(
        self, function: Callable[[Any], Mapping[str, Any]], units: Mapping[str, str] | None = None
    ) -> "Uncertainty":
        """Other quantities that follow from the parameters, by the delta method.

        Args:
            function: of the parameters by name, as a model function gets them; returns scalars
                by name: ``lambda p: {"mass": 1 / p.inverse_mass}``. Written with `jax.numpy`.
            units: of these quantities, by name.

        Returns:
            The quantities with their covariance, and so their errors, intervals and correlation.

        Raises:
            ValueError: not a dict of scalars, not finite, not differentiable by JAX, a parameter
                that there is not.
        """
        named = parameter_type(tuple(self.parameters))
        theta = jnp.asarray(list(self.parameters.values()))
        names: list[str] = []

        def stacked(at: Any) -> Any:
            quantities = function(named(*at))
            names[:] = _checked_names(quantities)
            return jnp.stack([jnp.asarray(quantity, at.dtype) for quantity in quantities.values()])

        try:
            value = np.asarray(stacked(theta))
            slope = np.asarray(jax.jacfwd(stacked)(theta))
        except jax.errors.JAXTypeError as error:
            check(False, "function", "must be differentiable by JAX", type(error).__name__,
                  "Use jax.numpy in place of math and numpy, and no float() or int().")  # fmt: skip
            raise
        for name, quantity, row in zip(names, value, slope, strict=True):
            check(
                bool(np.isfinite(quantity)), f"function[{name}]", "must be finite", float(quantity)
            )
            check(bool(np.all(np.isfinite(row))), f"function[{name}]",
                  "must have finite derivatives with the parameters", row)  # fmt: skip
        draws = None
        if self.draws is not None:
            draws = np.asarray(jax.vmap(stacked)(jnp.asarray(self.draws)))
        return Uncertainty(
            {name: float(quantity) for name, quantity in zip(names, value, strict=True)},
            _propagated(slope, self.covariance),
            np.min(np.where(slope != 0, self.degrees_of_freedom, np.inf), axis=1),
            _moved(slope, self.untraced),
            (),
            dict(units or {}),
            draws,
        )


def uncertainty(estimate: Identification | Refinement) -> Uncertainty:
    """How sure an estimate is.

    Args:
        estimate: result of `identify` or of `refine`.

    Returns:
        Its covariance with what follows from it: intervals, correlation, physical parameters, and
        in words which combinations of parameters the data do not tell.

    Raises:
        ValueError: an estimate without an answer; its status says why.
    """
    check_kind("estimate", estimate, (Identification, Refinement), "an estimate")
    status = estimate.status
    check(status.fits, "estimate", "must be one with an answer", str(status))
    plant, covariance = estimate.plant, np.asarray(estimate.covariance)
    theta = np.asarray(plant.theta, dtype=float)
    freedom = estimate.degrees_of_freedom
    freedom = np.full(len(theta), np.inf if freedom is None else freedom)
    bound = _on_bounds(theta, plant, covariance)
    information = getattr(estimate, "information", None)
    untraced = np.zeros((len(theta), 0))
    if information is not None:
        untraced = unidentified_directions(
            np.asarray(information), np.where(bound, 0.0, plant.free)
        )
    units = {name: unit for name, unit in plant.units.items() if name in plant.names}
    limits = (np.asarray(bound, dtype=float) for bound in (plant.lower, plant.upper))
    result = Uncertainty(
        estimate.parameters, covariance, freedom, untraced, (), units, None, *limits
    )
    precision = _precision(covariance, freedom) if information is None else np.asarray(information)
    errors = np.asarray(list(result.standard_errors.values()))
    unclear = [
        _BOUND.format(name, value)
        for name, value, on in zip(plant.names, theta, bound, strict=True)
        if on
    ]
    unclear += _open(untraced, theta, plant.names) + _weak(precision, errors, theta, plant.names)
    return replace(result, unclear=tuple(unclear))


# -- what cannot be told apart ----------------------------------------------------------------

_BOUND = "{} ended on its bound, {:g}: it has no error, and those of the others hold beside it"


def _on_bounds(
    theta: Float[np.ndarray, " np"], plant: Plant, covariance: Float[np.ndarray, "np np"]
) -> Bool[np.ndarray, " np"]:
    """Which parameters are on a bound, and were estimated no further: the others beside them."""
    on = (theta == np.asarray(plant.lower)) | (theta == np.asarray(plant.upper))
    return on & np.isnan(np.diagonal(covariance)) & (np.asarray(plant.free) > 0)


def _open(
    untraced: Float[np.ndarray, "np k"],
    theta: Float[np.ndarray, " np"],
    names: tuple[str, ...],
    tolerance: float = 1e-3,
) -> list[str]:
    """Sentences on directions that left no trace, together where they share parameters.

    Weights that stand for whole numbers are within `tolerance` of them: they are not noisy.
    """
    sentences = []
    for group in groups_of(untraced):
        involved, combinations = identifiable_combinations(
            untraced[:, group], theta, names, tolerance
        )
        if len(involved) == len(group):
            sentences.append(f"{listed(involved)} left no trace in the data")
        elif combinations:
            sentences.append(f"only {listed(combinations)} can be told, not {listed(involved)}")
        else:
            changes = [format_direction(untraced[:, column], theta, names) for column in group]
            sentences += [f"a change of {change} leaves no trace in the data" for change in changes]
    return sentences


def _weak(
    precision: Float[np.ndarray, "np np"],
    errors: Float[np.ndarray, " np"],
    theta: Float[np.ndarray, " np"],
    names: tuple[str, ...],
    tolerance: float = 0.05,
    inflation: float = 10.0,
    min_change: float = 0.1,
    surer: float = 0.5,
) -> list[str]:
    """Sentences on combinations that noise hides though each of their parameters alone would show.

    In units of the error that each parameter had if the others were known, the precision has a unit
    diagonal; a small eigenvalue is a combination that shows far less than its parts. It is said of
    the parameters that lose by it: those that are not well known, and would be with the others.

    Args:
        precision: information, or the inverse of a covariance.
        errors: standard errors; no finite one above zero for what takes no part.
        theta: the parameters.
        names: of them.
        tolerance: of weights that stand for whole numbers, which noise hides.
        inflation: error of a combination over what it were if it alone were estimated, at least.
        min_change: relative error of a parameter, from which it is worth a sentence.
        surer: error of a combination over that of each of its parts, below which it is named.
    """
    used = np.isfinite(errors) & (errors > 0) & (np.diagonal(precision) > 0)
    if np.sum(used) < 2:
        return []
    part = precision[np.ix_(used, used)]
    scale = np.sqrt(np.diagonal(part))
    scaled = part / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled)
    relative = np.where(used, errors, 0.0) / np.where(theta != 0, np.abs(theta), np.inf)
    covariance = np.zeros_like(precision)
    # Scaled, or the units decide what is rounding.
    inverse = np.linalg.pinv(scaled, hermitian=True) / np.outer(scale, scale)
    covariance[np.ix_(used, used)] = inverse
    variances, lone_variances = np.diagonal(covariance), np.zeros(len(theta))
    lone_variances[used] = 1.0 / scale**2  # variances with the others known
    inflated = (variances > inflation * lone_variances) & ((relative >= min_change) | (theta == 0))

    def is_surer(slope: Float[np.ndarray, " np"]) -> bool:
        parts = (slope**2 * variances)[slope != 0]
        return bool(slope @ covariance @ slope < surer**2 * np.min(parts))

    sentences = []
    for vector in vectors.T[values * inflation**2 < 1.0]:
        direction = np.zeros(len(theta))
        direction[used] = vector / scale
        direction[~inflated] = 0.0
        if np.sum(direction != 0) < 2:
            continue
        involved, combinations = identifiable_combinations(
            direction[:, None], theta, names, tolerance, is_surer
        )
        if len(involved) < 2:
            continue
        sizes = [relative[names.index(name)] for name in involved]
        within = " to ".join(dict.fromkeys(f"{size:.0%}" for size in (min(sizes), max(sizes))))
        sentence = f"{listed(involved)} can hardly be told apart, only to within {within}"
        if combinations:
            sentences.append(
                f"{sentence}; {listed(combinations)} {is_or_are(len(combinations))} surer"
            )
        else:
            change = format_direction(direction, theta, names)
            sentences.append(f"{sentence}: a change of {change} hardly shows")
    return sentences


def _precision(
    covariance: Float[np.ndarray, "np np"], freedom: Float[np.ndarray, " np"]
) -> Float[np.ndarray, "np np"]:
    """Inverse of a covariance; zero where it is not known, or too unsure to be inverted."""
    errors = np.sqrt(np.maximum(np.nan_to_num(np.diagonal(covariance)), 0.0))
    if np.min(freedom[errors > 0], initial=np.inf) <= 2 * np.sum(errors > 0):
        return np.zeros_like(covariance)
    scale = np.outer(errors, errors)
    correlation = np.where(scale > 0, covariance, 0.0) / np.where(scale > 0, scale, 1.0)
    inverse = np.linalg.pinv(correlation, rcond=1e-12, hermitian=True)
    return inverse / np.where(scale > 0, scale, 1.0)


# -- other quantities -------------------------------------------------------------------------


def _checked_names(quantities: Any) -> list[str]:
    check(isinstance(quantities, Mapping) and len(quantities) > 0, "function",
          "must return a dict of scalars by name", type(quantities).__name__)  # fmt: skip
    for name, quantity in quantities.items():
        check(isinstance(name, str), "function", "must return names as texts", repr(name))
        shape = np.shape(quantity)
        check(shape == (), f"function[{name}]", "must be a scalar", f"shape {shape}")
    return list(quantities)


def _propagated(
    slope: Float[np.ndarray, "nq np"], covariance: Float[np.ndarray, "np np"]
) -> Float[np.ndarray, "nq nq"]:
    """J C Jᵀ; what depends on a parameter of unknown error is unknown, and nothing else."""
    unknown = ~np.isfinite(np.diagonal(covariance))
    moved = slope @ np.where(np.isfinite(covariance), covariance, 0.0) @ slope.T
    lost = np.any(slope[:, unknown] != 0, axis=1)
    moved[lost] = moved[:, lost] = np.nan
    return moved


def _moved(
    slope: Float[np.ndarray, "nq np"], untraced: Float[np.ndarray, "np k"]
) -> Float[np.ndarray, "nq k"]:
    """What changes along the directions without a trace; zero up to rounding is zero."""
    parts = np.abs(slope) @ np.abs(untraced)
    moved = slope @ untraced
    return np.where(np.abs(moved) > 1e-6 * parts, moved, 0.0)
