"""Where passes begin internal states whose start the plant leaves open.

An observer corrects what is measured; internal states only follow it, from their start on. A start
that the plant declares as free is a parameter of one record: as such it is estimated beside those
of the model, from where a free run of the model over the first samples begins.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from eoi_jax.data.record import Record
from eoi_jax.data.windows import start_samples
from eoi_jax.models.augmented import augmented
from eoi_jax.models.free_starts import free_start_names, starts_text
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.initial_state import Run, initial_states, states_of
from eoi_jax.simulation.integrator import Drive, frictional
from eoi_jax.simulation.simulate import acted, drive

StartMaps = Float[np.ndarray, "records nz columns"]  # `kernel.Steps.z_start`


@dataclass(frozen=True)
class OwnStarts:
    """A plant whose free starts are parameters, as many as records have them.

    Attributes:
        plant: with these behind its own parameters, which its functions do not read.
        states: places of the states with free starts among all internal ones.
        count: number of parameters of the plant without them.
        values: of all internal states at the start of each record, with which a search begins.
    """

    plant: Plant
    states: Int[np.ndarray, " free"]
    count: int
    values: Float[np.ndarray, "records nz"]

    @classmethod
    def begun(cls, plant: Plant, records: Sequence[Record]) -> "OwnStarts":
        """That of a plant with free starts.

        Args:
            plant: at the parameters of the first pass.
            records: whose hold is decided.
        """
        values, names = _starts(plant, records), free_start_names(plant)
        (states,) = np.nonzero(plant.free_internal)
        added = {
            f"{name}_start_{i + 1}": float(value)
            for i, row in enumerate(values[:, states])
            for name, value in zip(names, row, strict=True)
        }
        return cls(augmented(plant, (), {}, idle=added), states, len(plant.names), values)

    @property
    def of_parameters(self) -> StartMaps:
        """Starts as these parameters."""
        maps = np.zeros((*self.values.shape, 1 + len(self.plant.names)))
        for i in range(len(maps)):
            columns = 1 + self.count + i * len(self.states) + np.arange(len(self.states))
            maps[i, self.states, columns] = 1.0
        return maps

    def constant(self, theta: Float[np.ndarray, " np"]) -> StartMaps:
        """Starts at values of these parameters, for the plant without them.

        Args:
            theta: all parameters; of starts that are not finite the first ones are kept.
        """
        values, starts = self.values.copy(), theta[self.count :].reshape(len(self.values), -1)
        values[:, self.states] = np.where(np.isfinite(starts), starts, values[:, self.states])
        return _constant(values, self.count)


def settled_starts(
    plant: Plant,
    records: Sequence[Record],
    passes: int,
    fit: Callable[[Plant, int, StartMaps], Plant],
    fewest: int = 3,
) -> StartMaps | None:
    """Free starts of each record, estimated beside the parameters.

    Args:
        plant: at the parameters of the first pass; with one pass the starts belong to these.
        records: whose hold is decided.
        passes: largest number of iterations.
        fit: gives a plant with its estimate by so many passes.
        fewest: passes where the parameters stay, as states need not enter linearly.

    Returns:
        None where the plant declares all starts.
    """
    if not np.any(plant.free_internal):
        return None
    begun = OwnStarts.begun(plant, records)
    model = begun.plant if passes > 1 else begun.plant.declared_anew(fixed=plant.names)
    fitted = fit(model, max(passes, fewest), begun.of_parameters)
    return begun.constant(np.asarray(fitted.theta))


def first_starts(plant: Plant, records: Sequence[Record]) -> StartMaps | None:
    """Internal states at the start of each record by a free run over its first samples.

    Args:
        plant: at the parameters of the run.
        records: whose hold is decided.

    Returns:
        None where the plant declares all starts.
    """
    if not np.any(plant.free_internal):
        return None
    return _constant(_starts(plant, records), len(plant.names))


def _constant(values: Float[np.ndarray, "records nz"], parameters: int) -> StartMaps:
    maps = np.zeros((*values.shape, 1 + parameters))
    maps[..., 0] = values
    return maps


def _starts(plant: Plant, records: Sequence[Record]) -> Float[np.ndarray, "records nz"]:
    return np.stack([_start(plant, record) for record in records])


def _start(plant: Plant, record: Record) -> Float[np.ndarray, " nz"]:
    count = min(start_samples(record, plant.rows), len(record))
    head = acted(plant, drive(record.time[:count], record.inputs[:count], record.hold))
    arrays = (np.asarray(part)[None] for part in (head.time, head.step, head.inputs, head.last))
    time, step, inputs, last = arrays
    lane = Drive(time, step, inputs, head.substeps, last)
    run = Run(plant, frictional(plant), head.substeps)
    y, valid = record.outputs[None, :count], record.output_valid[None, :count]
    begins = np.asarray([not record.continues])
    values = initial_states(run, lane, y, valid, record.noise[None], begins=begins)
    return states_of(run, values).z[0]


def pass_start_notes(
    plant: Plant, records: Sequence[Record], z_start: StartMaps | None
) -> tuple[str, ...]:
    """A note on where passes begin free starts; none where the plant declares all.

    Args:
        plant: the plant.
        records: of the passes.
        z_start: constant starts; with derivatives nothing is said of them yet.
    """
    if z_start is None or np.any(z_start[..., 1:]):
        return ()
    text = starts_text(plant, [record.name for record in records], list(z_start[..., 0]))
    note = (
        f"free starts of the records: {text}; estimated beside the parameters, whose ± takes them"
    )
    return (f"{note} as exact (that of `refine` does not)",)
