"""What a round of discovery starts from: a model, and its residual as modes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice

import numpy as np
from jaxtyping import Float

from eoi_jax.data.record import Record
from eoi_jax.discovery.candidates import CandidateColumns, Seen, atoms, seen_at
from eoi_jax.discovery.cosine_modes import ModalRecord, modal_record, model_rows, motion
from eoi_jax.discovery.free_start_modes import with_free_starts
from eoi_jax.discovery.lags import Peak, lags, strongest
from eoi_jax.discovery.noise_spectrum import fitted_power, local_power
from eoi_jax.discovery.regression import Base, Fit, fitted, settled
from eoi_jax.discovery.rules import RULES
from eoi_jax.discovery.search import Scores
from eoi_jax.discovery.task import Task
from eoi_jax.discovery.wavenumbers import wavenumbers
from eoi_jax.models.augmented import Placed, augmented, own_states
from eoi_jax.models.effects import ConstantOffset, PositionRipple
from eoi_jax.models.effects.effect import AbstractActuator
from eoi_jax.models.placements import placements
from eoi_jax.models.plant import Plant
from eoi_jax.models.step_scales import scaled_step, step_room, step_scales

_RULES = RULES.round


@dataclass(frozen=True)
class RoundStart:
    """A model along the records of a discovery.

    Attributes:
        task: the constants of the discovery.
        model: the declared model, with the effects that were added so far.
        placed: these effects.
    """

    task: Task
    model: Plant
    placed: tuple[Placed, ...] = ()

    @cached_property
    def modes(self) -> list[ModalRecord]:
        """The records of the fit as modes."""
        return self._as_modes(self.task.records)

    @cached_property
    def held_out_modes(self) -> list[ModalRecord]:
        """The held-out records as modes."""
        return self._as_modes(self.task.held_out)

    def _as_modes(self, records: Sequence[Record]) -> list[ModalRecord]:
        return [
            with_free_starts(self.model, modal_record(self.model, record, self.task.band), record)
            for record in records
        ]

    @cached_property
    def base(self) -> Base:
        """The residual and the slopes of the model on the records of the fit."""
        return base_of(self.model, self.modes)

    @cached_property
    def held_out_base(self) -> Base:
        """The same on the held-out records."""
        return base_of(self.model, self.held_out_modes)

    @property
    def lacking(self) -> float:
        """Power of the model's residual without constants: an offset may dwarf the variations."""
        present = {placed.site for placed in self.placed}
        constants = [
            atom
            for placed in placements(self.model, [ConstantOffset()])
            if placed.site not in present
            for atom in self.columns(placed, np.zeros((1, 0)))
        ]
        residual = fitted(self.base, constants, self.base.output_level).residual
        return self.base.signal_power(residual)

    def has_weights_of(self, rival: "RoundStart") -> bool:
        """Whether the weights of the samples are equal; the columns of a term then are too."""
        return all(
            np.array_equal(a, b)
            for record, rival_record in zip(self.modes, rival.modes, strict=True)
            for a, b in zip(record.weight, rival_record.weight, strict=True)
        )

    def signals_of_candidates(self) -> dict[Placed, Seen]:
        """What the model shows to each effect that may be added, at each place."""
        present = {placed.site for placed in self.placed}
        spilling = {placed.effect.name for placed in self.placed if placed.on_state}
        peaks, cutoff = self._peaks(), self.task.declared.lowpass.cutoff
        return {
            placed: seen_at(
                self.model,
                placed,
                self.modes,
                cutoff,
                peaks,
                self._lags(placed),
                self._wavenumbers(placed),
            )
            for placed in placements(self.model, self.task.effects)
            if placed.site not in present
            and not (placed.on_state and placed.effect.name in spilling)
        }

    def columns(
        self, placed: Placed, shapes: Float[np.ndarray, "grid shapes"]
    ) -> list[CandidateColumns]:
        """The atoms of an effect at these shapes on the records of the fit."""
        return atoms(self.model, placed, shapes, self.modes, self._delay_parameter(placed))

    def held_out_columns(self, atom: CandidateColumns) -> CandidateColumns:
        """An atom on the held-out records."""
        shapes, delay = np.reshape(atom.shape, (1, -1)), self._delay_parameter(atom.placed)
        return atoms(self.model, atom.placed, shapes, self.held_out_modes, delay)[0]

    def with_effects(
        self, scores: Scores, fit: Fit, added: Mapping[Placed, tuple[float, ...]]
    ) -> Plant:
        """The model with a set; fitted again if the declared model is not affine.

        Args:
            scores: of the search that found it.
            fit: of the set.
            added: its effects with their parameters.
        """
        theta, step = np.array(self.model.theta), np.zeros(len(self.model.names))
        step[self.base.free] = fit.theta[: len(self.base.free)]
        theta += scaled_step(theta, step, step_scales(self.model))
        theta = np.clip(theta, self.model.lower, self.model.upper)
        values = {
            name: value
            for placed, numbers in added.items()
            for name, value in zip(placed.names, physical(placed, numbers), strict=True)
        }
        plant = augmented(self.model, list(added), values, _bounds(scores, list(added)))
        parameters = np.concatenate([theta, np.asarray(plant.theta)[len(theta) :]])
        if own_states(self.model) == 0 and self.task.plant.is_affine:
            return plant.with_parameters(parameters)
        return settled(plant, self.modes, scores.power, parameters)

    def _peaks(self) -> Float[np.ndarray, " peaks"]:
        """Frequencies [rad/s] of the peaks in the residual of the declared model."""
        peaks, first = [], 0
        for record in self.modes:
            for _ in self.model.outputs:
                rows = slice(first, first + len(record.omega))
                peaks += _residual_peaks(
                    record.omega, *(part[rows] for part in self._residual_and_power)
                )
                first = rows.stop
        free = (peak for peak in strongest(peaks) if not in_step(self.modes, peak))
        return np.asarray(list(islice(free, _RULES.peaks)))

    def _lags(self, placed: Placed) -> Float[np.ndarray, " lags"]:
        """Lags [s] at which the residual of the declared model follows an input."""
        if not isinstance(placed.effect, AbstractActuator):
            return np.zeros(0)
        return lags(self.model, self.modes, *self._residual_and_power, placed.channel)

    def _wavenumbers(self, placed: Placed) -> Float[np.ndarray, " wavenumbers"]:
        """Wavenumbers at which the residual of the declared model repeats along the position."""
        if not isinstance(placed.effect, PositionRipple) or placed.against is not None:
            return np.zeros(0)
        return wavenumbers(self.modes, *self._residual_and_power, placed)

    @cached_property
    def _residual_and_power(self) -> tuple[Float[np.ndarray, " rows"], Float[np.ndarray, " rows"]]:
        """The residual of the declared model, and its power S."""
        base = self.base
        residual = fitted(base, [], base.output_level).residual
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


def physical(placed: Placed, numbers: Sequence[float]) -> tuple[float, ...]:
    """Parameters of an effect, each within its physical range: a set without another may leave it.

    Args:
        placed: the effect.
        numbers: of its parameters, gains first.
    """
    pairs = zip(placed.effect.parameters, numbers, strict=True)
    return tuple(
        float(np.clip(value, parameter.lower, parameter.upper)) for parameter, value in pairs
    )


def _bounds(scores: Scores, added: Sequence[Placed]) -> dict[str, tuple[float, float]]:
    """Bounds of the scales of effects on internal states: the ends of their grids.

    Dynamics faster than the modes are not in the data and make the model stiff.
    """
    bounds = {}
    for placed in added:
        gains = len(placed.effect.gains)
        for d, parameter in enumerate(placed.effect.shapes if placed.on_state else ()):
            if parameter.lower == 0.0:
                span = scores.problem.spans[placed]
                bounds[placed.names[gains + d]] = (float(span.low[d]), float(span.high[d]))
    return bounds


def _residual_peaks(omega: np.ndarray, residual: np.ndarray, power: np.ndarray) -> list[Peak]:
    """Peaks over frequency [rad/s] of the residual of an output in a record."""
    ratio = residual**2 / power
    ratio = ratio[:-1] + ratio[1:]  # a frequency between two modes shows in both
    inner = (ratio[1:-1] >= ratio[:-2]) & (ratio[1:-1] >= ratio[2:])
    middle, width = 0.5 * (omega[:-1] + omega[1:]), np.diff(omega)
    return [
        Peak(float(middle[i]), float(ratio[i]), float(width[i])) for i in 1 + np.flatnonzero(inner)
    ]


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
        for j, degree in enumerate(model.degrees):
            parts.append(local_power(motion(record, j, degree)))
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
