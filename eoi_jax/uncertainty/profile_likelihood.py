r"""Profile likelihood: how much worse the best fit gets while one parameter is held elsewhere.

$D(\theta_i) = n_e\,[\min_{\theta_{j\ne i}} V(\theta) - V(\hat\theta)]$, V = Σ_j log rmse_j²

With white residuals n_e is the number of samples, D is 2 Δ(log-likelihood), and the interval ends
where it reaches the χ² quantile. Coloured residuals hold fewer samples' worth: then D is a multiple
of χ² (Kent 1982), by the variance that the estimate has over the one it would have with white
residuals. So n_e is what makes D near the optimum the square of the error over the standard error,
D ≈ (θ_i − θ̂_i)²/C_ii, with the C that knows about the colour; what the profile adds is its shape.

**Sources.** J. Kent, Biometrika 69 (1982) 19; A. Raue et al., Bioinformatics 25 (2009) 1923.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import check, check_choice, check_kind, real
from eoi_jax._display import Result
from eoi_jax.data.holds import made_alike
from eoi_jax.data.record import Record
from eoi_jax.estimation.degrees_of_freedom import student
from eoi_jax.models.check_records import check_records
from eoi_jax.models.controller import Controller
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.refine import refine
from eoi_jax.refinement.result import Refinement
from eoi_jax.uncertainty.uncertainty import uncertainty


@dataclass(frozen=True, eq=False, repr=False)
class Profile(Result):
    """The profile of one parameter.

    `plot` shows the profile, its threshold and the parabola of the standard error.

    Attributes:
        name: of the parameter.
        values: at which it was held, ascending, the estimate among them, shape (points,).
        statistic: D at these, shape (points,): by how much twice the log-likelihood of `samples`
            independent samples is below its best.
        parameters: best ones of all names at these, shape (points, np).
        estimate: θ̂_i.
        standard_error: of the refinement.
        threshold: that D must reach at the ends of the interval.
        level: of the interval.
        interval: infinite on a side where D does not reach the threshold.
        samples: n_e, the independent ones that coloured residuals are worth.
        notes: why a side is open, and what else there is to know.
        unit: of the parameter, "" where unknown.
    """

    name: str
    values: Float[np.ndarray, " points"]
    statistic: Float[np.ndarray, " points"]
    parameters: Float[np.ndarray, "points np"]
    estimate: float
    standard_error: float
    threshold: float
    level: float
    interval: tuple[float, float]
    samples: float
    notes: tuple[str, ...]
    unit: str


def profile(
    refinement: Refinement,
    records: Record | Sequence[Record],
    name: str,
    *,
    level: float = 0.95,
    substeps: int | None = None,
    max_steps: int = 50,
    controller: Controller | None = None,
) -> Profile:
    """Profile likelihood of one parameter of a refined estimate.

    Points go outwards from the estimate until the threshold is passed; each fit starts from its
    neighbour's.

    Args:
        refinement: result of `refine`, with an answer.
        records: that it was made from; undeclared holds and skews are those that it has found.
        name: of a free parameter with a standard error.
        level: of the interval.
        substeps: steps of the simulation per sample; those of the refinement if None.
        max_steps: of the solver, for each point.
        controller: that of the refinement, if it had one in the loop.

    Returns:
        The profile, and the interval in it. On a bound it ends there.

    Raises:
        ValueError: no such free parameter, one without a standard error, no other free one, a
            controller where the refinement had none, or none where it had one.

    Source:
        J. Kent, Biometrika 69 (1982) 19; A. Raue et al., Bioinformatics 25 (2009) 1923.
    """
    check_kind("refinement", refinement, Refinement, "what `refine` returned")
    plant = refinement.plant
    check(refinement.status.ok, "refinement", "must have an answer", str(refinement.status))
    rule = "must be the one of the refinement, and None if it had none"
    check((controller is not None) == refinement.in_loop, "controller", rule, controller)
    fitted, used = records, refinement.records
    if controller is None:  # beside one, records hold its reference as a further input
        fitted = made_alike(check_records(plant, records), used, used)
    free = [parameter for parameter in plant.names if parameter not in plant.fixed]
    check_choice("name", name, free)
    check(len(free) > 1, "name", "must have another free parameter beside it", name,
          "The interval of `uncertainty` is that of a single one.")  # fmt: skip
    check(0.0 < real(level) < 1.0, "level", "must lie in (0, 1)", level)
    certainty = uncertainty(refinement)
    error = certainty.standard_errors[name]
    good = bool(np.isfinite(error) and error > 0)
    check(good, "name", "must have a finite standard error", f"{name} ± {error:g}")
    quantile = float(student(level, certainty.degrees_of_freedom)[plant.names.index(name)])
    fixed_plant = plant.declared_anew(fixed=(name,))
    count = refinement.substeps if substeps is None else substeps

    def fit(start: Plant, value: float) -> Refinement:
        moved = start.with_parameters({name: value})
        return refine(
            moved, fitted, window=refinement.window or np.inf, substeps=count,
            max_steps=max_steps, controller=controller,
        )  # fmt: skip

    centre = fit(fixed_plant, plant.parameters[name])
    check(centre.status.ok, "records", "must be those of the refinement", str(centre.status))
    search = _Search(fit, name, centre, error, quantile, _limits(plant, name))
    return search.run(level, plant.units.get(name, ""))


def _limits(plant: Plant, name: str) -> tuple[float, float]:
    i = plant.names.index(name)
    return float(plant.lower[i]), float(plant.upper[i])


@dataclass(frozen=True)
class _Search:
    """Points outwards from the estimate, to both sides.

    Lengths are in half widths of the interval that a parabola would have.
    """

    fit: Callable[[Plant, float], Refinement]
    name: str
    centre: Refinement
    error: float
    quantile: float
    limits: tuple[float, float]
    step: float = 0.5  # between points
    max_distance: float = 4.0  # beyond which a side is open

    def run(self, level: float, unit: str) -> Profile:
        value, half_width = self.centre.parameters[self.name], self.quantile * self.error
        # Both neighbours together: what is odd in D (its skewness) cancels.
        first = [
            self._fit_at(self.centre, value + side * self.step * half_width) for side in (-1, 1)
        ]
        rises = [point.cost - self.centre.cost for point in first if point.status.ok]
        rise = float(np.mean(rises)) if rises else np.nan
        rule = "must have an optimum with a curvature that the profile can see"
        check(rise > 0, "refinement", rule, f"{rise:.2g} in the cost")
        samples = (self.step * self.quantile) ** 2 / rise
        sides = [
            self._outwards(side, point, samples) for side, point in zip((-1, 1), first, strict=True)
        ]
        points = sorted(
            [self.centre, *sides[0][0], *sides[1][0]], key=lambda point: point.parameters[self.name]
        )
        statistic = np.asarray([samples * (point.cost - self.centre.cost) for point in points])
        notes = [*sides[0][1], *sides[1][1]]
        if np.min(statistic) < -0.1 * self.quantile**2:
            notes.append("the fit gets better along the profile: refine from there")
        values = np.asarray([point.parameters[self.name] for point in points])
        return Profile(
            self.name,
            values,
            statistic,
            np.stack([np.asarray(point.plant.theta) for point in points]),
            value,
            self.error,
            self.quantile**2,
            level,
            self._interval(values, statistic, value),
            samples,
            tuple(notes),
            unit,
        )

    def _fit_at(self, neighbour: Refinement, value: float) -> Refinement:
        return self.fit(neighbour.plant, float(np.clip(value, *self.limits)))

    def _outwards(
        self, side: int, point: Refinement, samples: float
    ) -> tuple[list[Refinement], list[str]]:
        """Points of one side, and why it is open if it is."""
        start, half_width = self.centre.parameters[self.name], self.quantile * self.error
        end = "below" if side < 0 else "above"
        points: list[Refinement] = []
        while point.status.ok and np.isfinite(point.cost):
            points.append(point)
            value = point.parameters[self.name]
            if samples * (point.cost - self.centre.cost) >= self.quantile**2:
                return points, []
            if value in self.limits:
                return points, [f"open {end}: the bound {value:g} lies inside the interval"]
            if abs(value - start) > self.max_distance * half_width:
                return points, [
                    f"open {end}: the cost stays below the threshold as far as {value:g}"
                ]
            point = self._fit_at(point, value + side * self.step * half_width)
        return points, [f"open {end}: {point.status}"]

    def _interval(
        self, values: np.ndarray, statistic: np.ndarray, estimate: float
    ) -> tuple[float, float]:
        """Where the signed root of D, which is nearly straight, passes ± its threshold."""
        root = np.sqrt(np.maximum(statistic, 0.0))
        ends = []
        for side in (-1, 1):
            (beyond_threshold,) = np.nonzero(
                (side * (values - estimate) > 0) & (root >= self.quantile)
            )
            if not len(beyond_threshold):
                ends.append(side * np.inf)
                continue
            outer = beyond_threshold[0] if side > 0 else beyond_threshold[-1]
            inner = outer - side
            share = (self.quantile - root[inner]) / (root[outer] - root[inner])
            ends.append(values[inner] + share * (values[outer] - values[inner]))
        low, high = np.clip(ends, *self.limits)  # an open end: as far as the bound
        return float(low), float(high)
