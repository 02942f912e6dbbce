"""One round of discovery: the search from one model, and what the held-out records say of it."""

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, islice

import numpy as np
from jaxtyping import Float

from eoi_jax.data.record import Record
from eoi_jax.discovery.candidates import CandidateColumns, atoms, seen_at
from eoi_jax.discovery.cosine_modes import ModalRecord, informative_band, modal_record, model_rows
from eoi_jax.discovery.lags import Peak, lags, strongest
from eoi_jax.discovery.noise_spectrum import expected_power, fitted_power, local_power
from eoi_jax.discovery.regression import Base, Fit, fitted, settled, system, within_bounds
from eoi_jax.discovery.search import Search
from eoi_jax.discovery.side_by_side import map_in_threads, waits
from eoi_jax.estimation.identify import Identification
from eoi_jax.estimation.preparation import PreparedRecords
from eoi_jax.models.augmented import Placed, augmented, own_states, place
from eoi_jax.models.effects import (
    AsymmetricFriction,
    ConstantOffset,
    CoulombFriction,
    SinusoidalDisturbance,
)
from eoi_jax.models.effects.effect import AbstractActuator, AbstractEffect, AbstractTerm
from eoi_jax.models.effects.products import ModulatedSinusoid, Product
from eoi_jax.models.placements import placements
from eoi_jax.models.plant import Plant

_BAND = 2.0  # of the modes over the cut-off of F
# Over that, where fast modes still tell something: far beyond F a rig has dynamics of its own.
_WIDER = 2.0
_PEAKS = 6  # frequencies at which a sinusoid is tried
# Correlation of a motion with itself that counts as the same; harmonics of it that are looked for.
_IN_STEP, _HARMONICS = 0.95, 4
# Share of what a set leaves, and of what the model lacks, from which on a product refutes it.
_MOST, _NOTABLE = 0.5, 0.005
_NEXT = 3  # extensions of a set that are looked at
_EQUAL = 1.5  # ratio of friction levels up to which they are read as one level and an offset
TOLD_APART = 10.0  # twice the log-likelihood by which sets are progress apart
_NOISE_LIKE = 1.3  # mean square of a residual over its predicted power


@dataclass(frozen=True)
class Task:
    """One discovery: what is fixed during it."""

    plant: Plant
    prepared: PreparedRecords  # for the estimator
    records: tuple[Record, ...]
    held: tuple[Record, ...]
    effects: tuple[AbstractEffect, ...]
    declared: Identification
    alpha: float
    max_effects: int
    window: float | None

    @cached_property
    def threads(self) -> int:
        """How many may evaluate models beside this one; none where they would wait for ever."""
        return 0 if waits(self.plant) else os.cpu_count() or 1

    @cached_property
    def band(self) -> float:
        """Highest frequency of the modes [rad/s]."""
        cutoff = self.declared.lowpass.cutoff
        telling = informative_band(self.plant, self.records)
        return _BAND * float(np.clip(telling, cutoff, _WIDER * cutoff))


class Round:
    """One search from one model, after an `earlier` one."""

    def __init__(
        self, task: Task, model: Plant, placed: Sequence[Placed], earlier: "Round | None" = None
    ):
        self.task, self.model, self.placed = task, model, tuple(placed)
        self.stretches = [modal_record(model, one, task.band) for one in task.records]
        self._known = earlier.terms if earlier and self._weighs_as(earlier) else {}
        self.base = base_of(model, self.stretches)
        self.refused: dict[Placed, str] = {}
        self.denied: Fit | None = None  # the best set that the held-out records alone refuse
        self._made: dict[tuple[Placed, bytes], list[CandidateColumns]] = {}
        self._beside = np.inf  # least that a set with a product leaves

    @cached_property
    def held(self) -> list[ModalRecord]:
        """The held-out records."""
        return [modal_record(self.model, one, self.task.band) for one in self.task.held]

    def _weighs_as(self, other: "Round") -> bool:
        """Whether the same samples count: the columns of a term are then the same."""
        return all(
            np.array_equal(a, b)
            for one, before in zip(self.stretches, other.stretches, strict=True)
            for a, b in zip(one.weight, before.weight, strict=True)
        )

    @property
    def terms(self) -> dict[Placed, list[CandidateColumns]]:
        """The grid of each term that was searched."""
        several: dict[Placed, list[CandidateColumns]] = {}
        for one in self.found.grid:
            if isinstance(one.placed.effect, AbstractTerm):
                several.setdefault(one.placed, []).append(one)
        return several

    @property
    def lacking(self) -> float:
        """Power of what the model leaves beside constants: an offset may dwarf all that varies."""
        present = {one.site for one in self.placed}
        constants = [
            atom
            for one in placements(self.model, [ConstantOffset()])
            if one.site not in present
            for atom in self._make(one, np.zeros((1, 0)))
        ]
        residual = fitted(self.base, constants, np.ones_like(self.base.target)).residual
        return self.base.signal_power(residual)

    def search(self, lacking: float) -> None:
        """Find the best set that the held-out records do not refuse.

        Args:
            lacking: power that the declared model left, the measure of what matters.
        """
        task, model = self.task, self.model
        present = {one.site for one in self.placed}
        spilling = {one.effect.name for one in self.placed if one.on_state}
        peaks = self._peaks()
        cutoff = task.declared.lowpass.cutoff
        looked = {
            one: seen_at(model, one, self.stretches, cutoff, peaks, self._lags(one))
            for one in placements(model, task.effects)
            if one.site not in present and not (one.on_state and one.effect.name in spilling)
        }
        self.candidates = [one for one, seen in looked.items() if one.effect.shows(seen)]

        def gridded(one: Placed) -> list[CandidateColumns]:
            shapes = one.effect.grid(looked[one])
            known = self._known.get(one, [])
            same = [atom.shape for atom in known] == [tuple(row) for row in shapes.tolist()]
            return known if known and same else self._make(one, shapes)

        # Each effect is a kernel of its own: their compilers run side by side.
        grid = list(chain.from_iterable(map_in_threads(task.threads, gridded, self.candidates)))
        names = len({one.effect.name for one in self.candidates})
        self.found = Search(
            self.base, grid, self._make, task.alpha, task.max_effects, max(names, 1), lacking
        )
        self.sets = self.found.run()
        self.chosen = self._first_accepted()
        self._made.clear()  # a round is kept to the end, what it tried is not

    @property
    def exhausted(self) -> bool:
        """Whether the chosen set leaves no more than noise."""
        power = expected_power(self.base.noise, self.base.local, self.base.output)
        return float(np.mean(self.kept.residual**2 / power)) < _NOISE_LIKE

    @property
    def declared(self) -> Fit:
        """The model without anything added, within its bounds."""
        return within_bounds(self.base, self.found.fit([]), self.found.power)

    @cached_property
    def kept(self) -> Fit:
        """The chosen set within the bounds of the model: what is added, and judged."""
        return within_bounds(self.base, self.chosen, self.found.power)

    def augmented(self, added: dict[Placed, tuple[float, ...]]) -> Plant:
        """The model with the chosen set, at its fitted values.

        Args:
            added: the effects as they are read, with their parameters.
        """
        return self._grown(self.kept, added)

    def _grown(self, fit: Fit, added: dict[Placed, tuple[float, ...]]) -> Plant:
        """The model with a set; fitted once more where internal states bend the columns."""
        theta = np.array(self.model.theta)
        theta[self.base.free] += fit.theta[: len(self.base.free)]
        theta = np.clip(theta, self.model.lower, self.model.upper)
        values = {
            name: value
            for one, numbers in added.items()
            for name, value in zip(one.names, numbers, strict=True)
        }
        whole = augmented(self.model, list(added), values, self._bounds(list(added)))
        wanted = np.concatenate([theta, np.asarray(whole.theta)[len(theta) :]])
        if own_states(self.model) == 0:
            return whole.with_parameters(wanted)
        return settled(whole, self.stretches, self.found.power, wanted)

    def _bounds(self, added: Sequence[Placed]) -> dict[str, tuple[float, float]]:
        """Of the scales of what changes internal states: the ends of their grid.

        What is faster than the modes is not in the data, and makes the model stiff.
        """
        bounds = {}
        for one in added:
            gains = len(one.effect.gains)
            for d, parameter in enumerate(one.effect.shapes if one.on_state else ()):
                if parameter.lower == 0.0:
                    span = self.found.spans[one]
                    bounds[one.names[gains + d]] = (float(span.low[d]), float(span.high[d]))
        return bounds

    def _make(
        self, placed: Placed, shapes: Float[np.ndarray, "grid shapes"]
    ) -> list[CandidateColumns]:
        key = (placed, shapes.tobytes())
        if key not in self._made:  # sets that share an effect ask for the same shapes
            late = self._late(placed)
            self._made[key] = atoms(self.model, placed, shapes, self.stretches, late)
        return self._made[key]

    def _peaks(self) -> Float[np.ndarray, " peaks"]:
        """Frequencies at which the residual of the declared model stands out."""
        peaks, first = [], 0
        for one in self.stretches:
            for _ in self.model.outputs:
                own = slice(first, first + len(one.omega))
                peaks += _standing_out(one.omega, *(part[own] for part in self._left))
                first = own.stop
        free = (peak for peak in strongest(peaks) if not in_step(self.stretches, peak))
        return np.asarray(list(islice(free, _PEAKS)))

    def _lags(self, placed: Placed) -> Float[np.ndarray, " lags"]:
        """Lags at which the residual of the declared model follows an input."""
        if not isinstance(placed.effect, AbstractActuator):
            return np.zeros(0)
        return lags(self.model, self.stretches, *self._left, placed.channel)

    @cached_property
    def _left(self) -> tuple[Float[np.ndarray, " rows"], Float[np.ndarray, " rows"]]:
        """What the declared model leaves, and its power S."""
        base = self.base
        residual = fitted(base, [], np.ones_like(base.target)).residual
        return residual, fitted_power(residual, base.noise, base.local, base.output)

    def _late(self, placed: Placed) -> str | None:
        """The time by which an effect that is in the model delays the same input."""
        if not isinstance(placed.effect, AbstractActuator):
            return None
        own = (one for one in self.placed if isinstance(one.effect, AbstractActuator))
        return next((one.names[0] for one in own if one.channel == placed.channel), None)

    def _first_accepted(self) -> Fit:
        for i, fit in enumerate(self.sets):
            if not fit.atoms:
                return fit
            if self._accepted(fit):
                return self._preferred(fit, self.sets[i + 1 :])
        return self.found.fit([])

    def _accepted(self, fit: Fit) -> bool:
        worth = fit.physical and self.found.material(fit)
        return worth and self._complete(fit) and self._better(fit)

    def _preferred(self, fit: Fit, others: Sequence[Fit]) -> Fit:
        """Of sets that the records do not tell apart, another one if the held-out records do.

        A dead zone that is never entered is an offset, until it is entered in another record.
        """
        search = self.found
        near = [
            one
            for one in others
            if 0 < len(one.atoms) <= len(fit.atoms)
            and search.value(one) - search.value(fit) < TOLD_APART
        ]
        if not near or not self.task.held:
            return fit
        base = base_of(self.model, self.held)
        own = self._held_residual(base, fit)
        power = fitted_power(own, base.noise, base.local, base.output)

        def cost(one: Fit) -> float:
            return float(np.sum(self._held_residual(base, one) ** 2 / power))

        best = min(near, key=cost)
        if cost(best) > float(np.sum(own**2 / power)) - TOLD_APART or not self._accepted(best):
            return fit
        for placed in fit.keys - best.keys:
            self.refused[placed] = f"the held-out records prefer {_named(best.keys - fit.keys)}"
        return best

    def _complete(self, fit: Fit) -> bool:
        """Whether no term that the library lacks takes most of what a set and one more leave.

        Regression specification error test (Ramsey 1969): an answer that is right leaves nothing in
        products of signals. A gain that varies with position or time is nearly an offset or a
        disturbance where signals vary little about their mean; the rest gives it away.
        """
        power, found = self.base.signal_power, self.found
        # What one more effect of the library takes is not held against the set.
        left = min(power(one.residual) for one in [fit, *found.extended(fit)[:_NEXT]])
        held = {product: one.placed for one in reversed(fit.atoms) for product in _products(one)}
        for (product, shape), refused in held.items():
            more = self._make(product, np.reshape(shape, (1, -1)))
            # Also against what products left of a better set: its twin is no better.
            rest = power(found.fit([*fit.atoms, *more]).residual)
            self._beside = min(rest, self._beside)
            if left - self._beside > max(_MOST * left, _NOTABLE * found.lacking):
                self.refused[refused] = "a product of signals takes most of the rest"
                return False
            # One that does better than the whole set: the set imitates it.
            if power(fit.residual) - power(found.fit(more).residual) > _NOTABLE * found.lacking:
                self.refused[refused] = "a product of signals takes more, alone"
                return False
        return True

    def _better(self, fit: Fit) -> bool:
        """Each effect must lower the held-out error beside the others."""
        if not self.task.held:
            return True
        base = base_of(self.model, self.held)
        residual = self._held_residual(base, fit)
        power = fitted_power(residual, base.noise, base.local, base.output)
        for one in fit.atoms:
            rest = self.found.fit([other for other in fit.atoms if other is not one])
            without = self._held_residual(base, rest)
            if float(np.sum(without**2 / power)) <= float(np.sum(residual**2 / power)):
                self.refused[one.placed] = "held-out error grows"
                self.denied = fit if self.denied is None else self.denied
                return False
        return True

    def _held_residual(self, base: Base, fit: Fit) -> Float[np.ndarray, " rows"]:
        """What the set leaves on the held-out records, at the parameters of the fit."""
        if own_states(self.model) > 0:
            return model_rows(self._grown(fit, values_of(fit)), self.held)[0][0]
        made = [
            atoms(
                self.model,
                one.placed,
                np.reshape(one.shape, (1, -1)),
                self.held,
                self._late(one.placed),
            )[0]
            for one in fit.atoms
        ]
        target, columns = system(base, made)
        return target - columns @ fit.theta


def _standing_out(omega: np.ndarray, residual: np.ndarray, power: np.ndarray) -> list[Peak]:
    """Frequencies [rad/s] of the maxima of one output of one record."""
    ratio = residual**2 / power
    ratio = ratio[:-1] + ratio[1:]  # a frequency between two modes shows in both
    inner = (ratio[1:-1] >= ratio[:-2]) & (ratio[1:-1] >= ratio[2:])
    middle, width = 0.5 * (omega[:-1] + omega[1:]), np.diff(omega)
    return [
        Peak(float(middle[i]), float(ratio[i]), float(width[i])) for i in 1 + np.flatnonzero(inner)
    ]


def _named(several: Iterable[Placed]) -> str:
    return " and ".join(sorted({one.effect.name for one in several}))


def _products(one: CandidateColumns) -> list[tuple[Placed, tuple[float, ...]]]:
    """What is held against an effect, with its shape parameters."""
    pairs = (("u", "y"), ("u", "v"), ("y", "v"))
    held: list[tuple[AbstractTerm, tuple[float, ...]]] = [(Product(*pair), ()) for pair in pairs]
    if isinstance(one.placed.effect, SinusoidalDisturbance):
        held += [(ModulatedSinusoid(by), one.shape) for by in ("y", "v", "u")]
    where = one.placed.output, one.placed.through
    return [(Placed(term, where[0], (), through=where[1]), shape) for term, shape in held]


def in_step(stretches: Sequence[ModalRecord], omega: float) -> bool:
    """Whether the motion repeats, or mirrors, itself after some periods of a frequency [rad/s].

    Then it has harmonics there, and so has everything that depends on it: a disturbance of that
    frequency cannot be progress from a friction or spring that the library does not have.
    """
    if omega <= 0.0:
        return False
    for j in range(stretches[0].y.shape[2]):
        for periods in range(1, _HARMONICS + 1):
            products = np.zeros(3)
            for one in stretches:
                lag = round(2.0 * np.pi * periods / (omega * one.sample_period))
                speed = np.diff(one.y[:, 0, j])
                if lag <= len(speed) // 2:
                    a, b = speed[lag:], speed[: len(speed) - lag]
                    products += [np.sum(a * b), np.sum(a * a), np.sum(b * b)]
            both, first, second = products
            if abs(both) > _IN_STEP * np.sqrt(first * second):
                return True
    return False


def base_of(model: Plant, stretches: Sequence[ModalRecord]) -> Base:
    """The declared model along the records, as modes."""
    error, slopes = model_rows(model, stretches)
    free = np.flatnonzero(model.free)
    parts, noise, output = [], [], []
    for one in stretches:
        for j in range(len(model.outputs)):
            parts.append(local_power(one.rows(one.highest[j])))
            noise.append(one.noise[:, j])
            output.append(np.full(len(one.omega), j))
    return Base(
        error[0],
        slopes[0][:, free],
        free,
        np.concatenate(noise),
        np.concatenate(parts),
        np.concatenate(output),
        (
            (np.asarray(model.lower) - model.theta)[free],
            (np.asarray(model.upper) - model.theta)[free],
        ),
    )


def values_of(fit: Fit) -> dict[Placed, tuple[float, ...]]:
    """Parameters of each effect of a set, gains first."""
    return {
        one.placed: (*(float(gain) for gain in gains), *one.shape)
        for one, gains in zip(fit.atoms, fit.gains, strict=True)
    }


def read_friction(plant: Plant, fit: Fit) -> dict[Placed, tuple[float, ...]]:
    """The set, with asymmetric dry friction read as it is commonly meant.

    Two levels c₊, c₋ and one level (c₊ + c₋)/2 beside an offset (c₋ - c₊)/2 are the same function.
    Nearly equal levels are called Coulomb friction and an offset, very different ones asymmetric.
    """
    added = {}
    for placed, values in values_of(fit).items():
        if isinstance(placed.effect, AsymmetricFriction) and max(values) < _EQUAL * min(values):
            forward, backward = values
            where = placed.channel, placed.against, placed.through
            level = place(plant, CoulombFriction(), *where)
            offset = place(plant, ConstantOffset(), *where)
            added[level] = (0.5 * (forward + backward),)
            added[offset] = (0.5 * (backward - forward),)
        else:
            added[placed] = values
    return added
