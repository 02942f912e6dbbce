"""A round of discovery: a search from a model, and the tests of its sets on held-out records."""

import os
from collections.abc import Collection, Iterable, Sequence
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
from eoi_jax.discovery.remarks import (
    HELD_OUT,
    PRODUCT_ALONE,
    PRODUCT_OF_REST,
    Refusal,
    less_probable,
)
from eoi_jax.discovery.rules import RULES
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
from eoi_jax.models.step_scales import scaled_step, step_room, step_scales
from eoi_jax.simulation.validate import Validation, growth_that_rules, judged_runs

_RULES = RULES.round


@dataclass(frozen=True)
class Task:
    """The constants of a discovery: the declared model, its records and the options."""

    plant: Plant
    prepared: PreparedRecords  # for the estimator
    records: tuple[Record, ...]
    held_out: tuple[Record, ...]
    effects: tuple[AbstractEffect, ...]
    declared: Identification
    alpha: float
    max_effects: int
    window: float | None

    @cached_property
    def threads(self) -> int:
        """Number of threads that evaluate models; 0 if they would deadlock (`side_by_side`)."""
        return 0 if waits(self.plant) else os.cpu_count() or 1

    @cached_property
    def whole_runs(self) -> Validation:
        """Free runs of the declared model through whole records."""
        return judged_runs(self.declared.plant, self.held_out or self.records)

    @cached_property
    def longest(self) -> float | None:
        """Length of long free runs [s] where whole ones say nothing; None: whole records."""
        limit = RULES.judge.misled
        growth = growth_that_rules(self.declared.plant, self.whole_runs, limit=limit)
        return None if growth is None else growth.window

    @cached_property
    def band(self) -> float:
        """Highest frequency of the modes [rad/s]."""
        cutoff = self.declared.lowpass.cutoff
        telling = informative_band(self.plant, self.records)
        return RULES.modes.band * float(np.clip(telling, cutoff, RULES.modes.widest * cutoff))


class Round:
    """A search from a model; an `earlier` round lends the columns that it has computed."""

    def __init__(
        self, task: Task, model: Plant, placed: Sequence[Placed], earlier: "Round | None" = None
    ):
        self.task, self.model, self.placed = task, model, tuple(placed)
        self.stretches = [modal_record(model, record, task.band) for record in task.records]
        self._known_terms = earlier.terms if earlier and self._same_weights(earlier) else {}
        self.base = base_of(model, self.stretches)
        self.refused: dict[Placed, Refusal] = {}
        self.denied: Fit | None = None  # the best set that only the held-out records refuse
        self.rejected: set[frozenset] = set()  # sets that were refused
        self._columns_of: dict[tuple[Placed, bytes], list[CandidateColumns]] = {}
        self._least_with_product = np.inf  # least residual power of a set with a product

    @cached_property
    def held_out_modes(self) -> list[ModalRecord]:
        """The held-out records as modes."""
        return [modal_record(self.model, record, self.task.band) for record in self.task.held_out]

    def _same_weights(self, previous: "Round") -> bool:
        """Whether the weights of the samples are equal; the columns of a term then are too."""
        return all(
            np.array_equal(a, b)
            for record, previous_record in zip(self.stretches, previous.stretches, strict=True)
            for a, b in zip(record.weight, previous_record.weight, strict=True)
        )

    @property
    def terms(self) -> dict[Placed, list[CandidateColumns]]:
        """The atoms of each searched term."""
        grids: dict[Placed, list[CandidateColumns]] = {}
        for atom in self.candidate_search.grid:
            if isinstance(atom.placed.effect, AbstractTerm):
                grids.setdefault(atom.placed, []).append(atom)
        return grids

    @property
    def lacking(self) -> float:
        """Power of the model's residual without constants: an offset may dwarf the variations."""
        present = {placed.site for placed in self.placed}
        constants = [
            atom
            for placed in placements(self.model, [ConstantOffset()])
            if placed.site not in present
            for atom in self._make(placed, np.zeros((1, 0)))
        ]
        residual = fitted(self.base, constants, np.ones_like(self.base.target)).residual
        return self.base.signal_power(residual)

    def search(self, lacking: float) -> None:
        """Find the best set that the held-out records do not refuse.

        Args:
            lacking: residual power of the declared model, the reference of material effects.
        """
        task, model = self.task, self.model
        present = {placed.site for placed in self.placed}
        spilling = {placed.effect.name for placed in self.placed if placed.on_state}
        peaks = self._peaks()
        cutoff = task.declared.lowpass.cutoff
        seen_signals = {
            placed: seen_at(model, placed, self.stretches, cutoff, peaks, self._lags(placed))
            for placed in placements(model, task.effects)
            if placed.site not in present
            and not (placed.on_state and placed.effect.name in spilling)
        }
        self.candidates = [
            placed for placed, seen in seen_signals.items() if placed.effect.shows(seen)
        ]

        def gridded(placed: Placed) -> list[CandidateColumns]:
            shapes = placed.effect.grid(seen_signals[placed])
            known_atoms = self._known_terms.get(placed, [])
            unchanged = [atom.shape for atom in known_atoms] == [
                tuple(row) for row in shapes.tolist()
            ]
            return known_atoms if known_atoms and unchanged else self._make(placed, shapes)

        # Each effect is a separate kernel: they are compiled in parallel.
        grid = list(chain.from_iterable(map_in_threads(task.threads, gridded, self.candidates)))
        names = len({placed.effect.name for placed in self.candidates})
        self.candidate_search = Search(
            self.base, grid, self._make, task.alpha, task.max_effects, max(names, 1), lacking
        )
        self.sets = self.candidate_search.run()
        self.chosen = self._first_accepted()
        self._columns_of.clear()  # the round stays in memory, its refined atoms need not

    @property
    def exhausted(self) -> bool:
        """Whether the residual of the chosen set is noise."""
        power = expected_power(self.base.noise, self.base.local, self.base.output)
        return float(np.mean(self.bounded_fit.residual**2 / power)) < _RULES.noise_like

    @property
    def declared(self) -> Fit:
        """The fit of the model without added effects, within its bounds."""
        return within_bounds(self.base, self.candidate_search.fit([]), self.candidate_search.power)

    @cached_property
    def bounded_fit(self) -> Fit:
        """The fit of the chosen set within the bounds of the model, which is added and tested."""
        return within_bounds(self.base, self.chosen, self.candidate_search.power)

    def augmented(self, added: dict[Placed, tuple[float, ...]]) -> Plant:
        """The model with the chosen set, at its fitted values.

        Args:
            added: the effects with their parameters, as `read_friction` interprets them.
        """
        return self._plant_with(self.bounded_fit, added)

    def _plant_with(self, fit: Fit, added: dict[Placed, tuple[float, ...]]) -> Plant:
        """The model with a set; fitted again if the declared model is not affine."""
        theta, step = np.array(self.model.theta), np.zeros(len(self.model.names))
        step[self.base.free] = fit.theta[: len(self.base.free)]
        theta += scaled_step(theta, step, step_scales(self.model))
        theta = np.clip(theta, self.model.lower, self.model.upper)
        values = {
            name: value
            for placed, numbers in added.items()
            for name, value in zip(placed.names, numbers, strict=True)
        }
        plant = augmented(self.model, list(added), values, self._bounds(list(added)))
        parameters = np.concatenate([theta, np.asarray(plant.theta)[len(theta) :]])
        if own_states(self.model) == 0 and self.task.plant.is_affine:
            return plant.with_parameters(parameters)
        return settled(plant, self.stretches, self.candidate_search.power, parameters)

    def _bounds(self, added: Sequence[Placed]) -> dict[str, tuple[float, float]]:
        """Bounds of the scales of effects on internal states: the ends of their grids.

        Dynamics faster than the modes are not in the data and make the model stiff.
        """
        bounds = {}
        for placed in added:
            gains = len(placed.effect.gains)
            for d, parameter in enumerate(placed.effect.shapes if placed.on_state else ()):
                if parameter.lower == 0.0:
                    span = self.candidate_search.spans[placed]
                    bounds[placed.names[gains + d]] = (float(span.low[d]), float(span.high[d]))
        return bounds

    def _make(
        self, placed: Placed, shapes: Float[np.ndarray, "grid shapes"]
    ) -> list[CandidateColumns]:
        key = (placed, shapes.tobytes())
        if key not in self._columns_of:  # sets that share an effect ask for the same shapes
            delay = self._delay_parameter(placed)
            self._columns_of[key] = atoms(self.model, placed, shapes, self.stretches, delay)
        return self._columns_of[key]

    def _peaks(self) -> Float[np.ndarray, " peaks"]:
        """Frequencies [rad/s] of the peaks in the residual of the declared model."""
        peaks, first = [], 0
        for record in self.stretches:
            for _ in self.model.outputs:
                rows = slice(first, first + len(record.omega))
                peaks += _residual_peaks(
                    record.omega, *(part[rows] for part in self._residual_and_power)
                )
                first = rows.stop
        free = (peak for peak in strongest(peaks) if not in_step(self.stretches, peak))
        return np.asarray(list(islice(free, _RULES.peaks)))

    def _lags(self, placed: Placed) -> Float[np.ndarray, " lags"]:
        """Lags [s] at which the residual of the declared model follows an input."""
        if not isinstance(placed.effect, AbstractActuator):
            return np.zeros(0)
        return lags(self.model, self.stretches, *self._residual_and_power, placed.channel)

    @cached_property
    def _residual_and_power(self) -> tuple[Float[np.ndarray, " rows"], Float[np.ndarray, " rows"]]:
        """The residual of the declared model, and its power S."""
        base = self.base
        residual = fitted(base, [], np.ones_like(base.target)).residual
        return residual, fitted_power(residual, base.noise, base.local, base.output)

    def _delay_parameter(self, placed: Placed) -> str | None:
        """Name of the parameter by which an effect in the model delays the same input."""
        if not isinstance(placed.effect, AbstractActuator):
            return None
        actuators = (
            actuator for actuator in self.placed if isinstance(actuator.effect, AbstractActuator)
        )
        return next(
            (actuator.names[0] for actuator in actuators if actuator.channel == placed.channel),
            None,
        )

    def _first_accepted(self) -> Fit:
        for i, fit in enumerate(self.sets):
            if not fit.atoms:
                return fit
            if self._accepts(fit):
                return self._preferred(fit, self.sets[i + 1 :])
        return self.candidate_search.fit([])

    def _accepts(self, fit: Fit) -> bool:
        accepted = (
            fit.physical
            and self.candidate_search.material(fit)
            and self._passes_product_test(fit)
            and self._lowers_held_out_error(fit)
        )
        if not accepted:
            self.rejected.add(fit.keys)
        return accepted

    def _preferred(self, fit: Fit, remaining: Sequence[Fit]) -> Fit:
        """The most probable set, held-out records included, of those that are hardly told apart.

        A dead zone that is never entered equals an offset, unless a held-out record enters it.
        """
        search = self.candidate_search
        alternatives = [
            alternative
            for alternative in remaining
            if 0 < len(alternative.atoms) <= len(fit.atoms)
            and search.value(alternative) - search.value(fit) < _RULES.told_apart
        ]
        if not alternatives or not self.task.held_out:
            return fit
        costs = self._held_out_costs([fit, *alternatives])
        ordered = sorted(
            [fit, *alternatives], key=lambda item: search.value(item) + costs[item.keys]
        )
        best = next(item for item in ordered if item is fit or self._accepts(item))
        for placed in fit.keys - best.keys:
            self.refused[placed] = less_probable(_effect_names(best.keys - fit.keys))
        return best

    def _held_out_costs(self, sets: Sequence[Fit]) -> dict[frozenset, float]:
        """Costs on the held-out records, under the residual power that the first set leaves there.

        Args:
            sets: fits to the records of the fit.
        """
        base = base_of(self.model, self.held_out_modes)
        residuals = [self._held_out_residual(base, fit) for fit in sets]
        power = fitted_power(residuals[0], base.noise, base.local, base.output)
        pairs = zip(sets, residuals, strict=True)
        return {fit.keys: float(np.sum(residual**2 / power)) for fit, residual in pairs}

    @cached_property
    def plausible(self) -> list[tuple[frozenset[Placed], float]]:
        """Sets that may be the answer, with twice their negative log-likelihood and penalty.

        The chosen one and those that are not refused, on the records of the fit and on held-out
        ones.
        """
        search, chosen = self.candidate_search, self.chosen
        limit = search.value(chosen) + RULES.probability.implausible
        rivals = [
            fit
            for fit in self.sets
            if fit.keys != chosen.keys
            and fit.keys not in self.rejected
            and search.value(fit) < limit
            and search.material(fit)
        ]
        costs = {fit.keys: 0.0 for fit in (chosen, *rivals)}
        if rivals and self.task.held_out:
            costs = self._held_out_costs([chosen, *rivals])
        return [(fit.keys, search.value(fit) + costs[fit.keys]) for fit in (chosen, *rivals)]

    def removed(self, laws: Collection[Placed]) -> float:
        """Power of the residual that laws of the chosen set take beside the others."""
        search = self.candidate_search
        remaining = [atom for atom in self.chosen.atoms if atom.placed not in laws]
        power = self.base.signal_power
        return power(search.fit(remaining).residual) - power(self.chosen.residual)

    def _passes_product_test(self, fit: Fit) -> bool:
        """Whether no product of signals explains most of the residual of a set and its extensions.

        Regression specification error test (Ramsey 1969): the residual of a correct set does not
        correlate with products of signals. A gain that varies with position or time resembles an
        offset or a disturbance if signals vary little about their mean; the residual reveals it.
        """
        power, search = self.base.signal_power, self.candidate_search
        # A residual that a further effect of the library explains does not count against the set.
        remainder = min(
            power(extended.residual)
            for extended in [fit, *search.extended(fit)[: _RULES.extensions]]
        )
        products = {
            product: atom.placed
            for atom in reversed(fit.atoms)
            for product in _products(self.model, atom)
        }
        for (product, shape), placed in products.items():
            product_atoms = self._make(product, np.reshape(shape, (1, -1)))
            # Also compare with products beside better sets: an equivalent set fails like them.
            with_product = power(search.fit([*fit.atoms, *product_atoms]).residual)
            self._least_with_product = min(with_product, self._least_with_product)
            if remainder - self._least_with_product > max(
                _RULES.product * remainder, _RULES.notable * search.lacking
            ):
                self.refused[placed] = PRODUCT_OF_REST
                return False
            # A product that alone explains more than the set: the set imitates it.
            if (
                power(fit.residual) - power(search.fit(product_atoms).residual)
                > _RULES.notable * search.lacking
            ):
                self.refused[placed] = PRODUCT_ALONE
                return False
        return True

    def _lowers_held_out_error(self, fit: Fit) -> bool:
        """Each effect must lower the held-out error beside the others."""
        if not self.task.held_out:
            return True
        base = base_of(self.model, self.held_out_modes)
        residual = self._held_out_residual(base, fit)
        power = fitted_power(residual, base.noise, base.local, base.output)
        for atom in fit.atoms:
            fit_without = self.candidate_search.fit(
                [neighbor for neighbor in fit.atoms if neighbor is not atom]
            )
            residual_without = self._held_out_residual(base, fit_without)
            if float(np.sum(residual_without**2 / power)) <= float(np.sum(residual**2 / power)):
                self.refused[atom.placed] = HELD_OUT
                self.denied = fit if self.denied is None else self.denied
                return False
        return True

    def _held_out_residual(self, base: Base, fit: Fit) -> Float[np.ndarray, " rows"]:
        """The residual of the set on the held-out records, at the parameters of the fit."""
        if own_states(self.model) > 0:
            return model_rows(self._plant_with(fit, values_of(fit)), self.held_out_modes)[0][0]
        candidates = [
            atoms(
                self.model,
                atom.placed,
                np.reshape(atom.shape, (1, -1)),
                self.held_out_modes,
                self._delay_parameter(atom.placed),
            )[0]
            for atom in fit.atoms
        ]
        target, columns = system(base, candidates)
        return target - columns @ fit.theta


def _residual_peaks(omega: np.ndarray, residual: np.ndarray, power: np.ndarray) -> list[Peak]:
    """Peaks over frequency [rad/s] of the residual of an output in a record."""
    ratio = residual**2 / power
    ratio = ratio[:-1] + ratio[1:]  # a frequency between two modes shows in both
    inner = (ratio[1:-1] >= ratio[:-2]) & (ratio[1:-1] >= ratio[2:])
    middle, width = 0.5 * (omega[:-1] + omega[1:]), np.diff(omega)
    return [
        Peak(float(middle[i]), float(ratio[i]), float(width[i])) for i in 1 + np.flatnonzero(inner)
    ]


def _effect_names(effects: Iterable[Placed]) -> str:
    return " and ".join(sorted({placed.effect.label for placed in effects}))


def _products(model: Plant, atom: CandidateColumns) -> list[tuple[Placed, tuple[float, ...]]]:
    """The products of signals that can refute an effect, with their shape parameters."""
    degree = min(model.degrees[atom.placed.output], 2)
    pairs = ((), (("u", "y"), ("y", "y")), (("u", "y"), ("u", "v"), ("y", "v")))[degree]
    terms: list[tuple[AbstractTerm, tuple[float, ...]]] = [(Product(*pair), ()) for pair in pairs]
    if isinstance(atom.placed.effect, SinusoidalDisturbance):
        factors = (("u",), ("y", "u"), ("y", "v", "u"))[degree]
        terms += [(ModulatedSinusoid(signal), atom.shape) for signal in factors]
    location = atom.placed.output, atom.placed.through
    return [(Placed(term, location[0], (), through=location[1]), shape) for term, shape in terms]


def in_step(stretches: Sequence[ModalRecord], omega: float) -> bool:
    """Whether the motion repeats itself, with either sign, after some periods of a frequency.

    Then it has harmonics at that frequency (`omega` [rad/s]), and so has everything that depends on
    it: a disturbance of that frequency cannot be distinguished from a friction or spring that the
    library lacks.
    """
    if omega <= 0.0:
        return False
    for j in range(stretches[0].y.shape[2]):
        for periods in range(1, _RULES.harmonics + 1):
            products = np.zeros(3)
            for record in stretches:
                lag = round(2.0 * np.pi * periods / (omega * record.sample_period))
                speed = np.diff(record.y[:, 0, j])
                if lag <= len(speed) // 2:
                    a, b = speed[lag:], speed[: len(speed) - lag]
                    products += [np.sum(a * b), np.sum(a * a), np.sum(b * b)]
            product, first, second = products
            if abs(product) > _RULES.periodic * np.sqrt(first * second):
                return True
    return False


def base_of(model: Plant, stretches: Sequence[ModalRecord]) -> Base:
    """The residual and the slopes of the declared model along the records, as modes."""
    error, slopes = model_rows(model, stretches)
    free = np.flatnonzero(model.free)
    theta, lower, upper = (np.asarray(part) for part in (model.theta, model.lower, model.upper))
    smallest, largest = step_room(theta, lower, upper, step_scales(model))
    parts, noise, output = [], [], []
    for record in stretches:
        for j in range(len(model.outputs)):
            parts.append(local_power(record.rows(record.highest[j])))
            noise.append(record.noise[:, j])
            output.append(np.full(len(record.omega), j))
    return Base(
        error[0],
        slopes[0][:, free],
        free,
        np.concatenate(noise),
        np.concatenate(parts),
        np.concatenate(output),
        (smallest[free], largest[free]),
    )


def values_of(fit: Fit) -> dict[Placed, tuple[float, ...]]:
    """Parameters of each effect of a set, gains first."""
    return {
        atom.placed: (*(float(gain) for gain in gains), *atom.shape)
        for atom, gains in zip(fit.atoms, fit.gains, strict=True)
    }


def read_friction(plant: Plant, fit: Fit) -> dict[Placed, tuple[float, ...]]:
    """The set, with asymmetric dry friction of similar levels read as a level and an offset.

    Two levels c₊, c₋ and a level (c₊ + c₋)/2 beside an offset (c₋ - c₊)/2 are the same function.
    Similar levels are called Coulomb friction and an offset, very different ones asymmetric.
    """
    added = {}
    for placed, values in values_of(fit).items():
        asymmetric = isinstance(placed.effect, AsymmetricFriction)
        if asymmetric and max(values) < _RULES.similar_levels * min(values):
            forward, backward = values
            location = placed.channel, placed.against, placed.through
            level = place(plant, CoulombFriction(), *location)
            offset = place(plant, ConstantOffset(), *location)
            added[level] = (0.5 * (forward + backward),)
            added[offset] = (0.5 * (backward - forward),)
        else:
            added[placed] = values
    return added
