r"""A plant with its controller in the loop, as a plant whose last internal states are sampled.

Along a record the controller is first run on the *measured* outputs (`controller_replay.py`). That
gives its states $s^m_k$ and inputs $c^m_k$ at every sample; what it does not reproduce of the
recorded input, $w_k = u_k - c^m_k$ (rounding, a dither that nobody logged), acts as recorded. In a
simulation the plant gets

$u_k + \delta_k, \quad \delta_k = c(t_k, r_k, \hat y_k, s^m_k + \sigma_k) - c^m_k, \quad
\sigma_{k+1} = g(t_k, r_k, \hat y_k, s^m_k + \sigma_k) - s^m_{k+1}$,

that is the law driven by the simulated output, plus w. δ and σ are zero wherever a run starts, at a
window too: there the controller is in the state that it had, and is no unknown. They are internal
states that change at samples (`models/sampled_states.py`), r, c^m and s^m further inputs; so every
engine, the sensitivities and the least squares are those of any plant.

**What is estimated.** The true plant got K(r - y - e), with the noise e of the measured outputs;
the simulated one gets K(r - ŷ). At the true parameters of a linear loop the error is therefore
$y + e - \hat y = S e$ with the sensitivity function S = 1/(1 + GK). It is coloured, but independent
of r and the start, on which alone ŷ depends; so least squares is consistent, whatever the colour of
e. What it gives away: the motion that e itself has caused, as excitation, and the weights of the
frequencies, 1/|S|² for the best estimate. With the recorded input the error is e itself as long as
the start is known; of an unstable plant that holds in windows only, each of which pays for a start
of its own. A disturbance d of the plant adds S G d here, which stays bounded, and G d there, which
grows through each window. A law that is not linear, or meets its limits, adds a bias of second
order in e.

Source: output error of a closed loop, L. Ljung, *System Identification*, 2nd ed., section 13.5.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from eoi_jax._checks import check, check_choice, check_kind, timed
from eoi_jax.data.record import Record
from eoi_jax.models.check_records import check_records
from eoi_jax.models.controller import Controller
from eoi_jax.models.plant import Dynamics, Plant, State
from eoi_jax.models.sampled_states import SampledStates
from eoi_jax.simulation.controller_replay import compared, replayed_along

# -- the plant ----------------------------------------------------------------------------


@dataclass(frozen=True)
class _Layout:
    """Where a closed loop has what: inputs, then internal states.

    Attributes:
        inputs: of the plant. driven: numbers of those that the controller drives.
        references: their number.
        memory: number of values that the controller keeps from sample to sample.
        internal: states of the plant's own.
    """

    inputs: int
    driven: tuple[int, ...]
    references: int
    memory: int
    internal: int

    def split(self, u: Any) -> list[Any]:
        """Inputs of the plant, references, c^m, s^m, s^m of the next sample."""
        sizes = (self.inputs, self.references, len(self.driven), self.memory, self.memory)
        edges = itertools.accumulate(sizes, initial=0)
        return [u[first:last] for first, last in itertools.pairwise(edges)]

    def opened(self, x: State, u: Any) -> tuple[State, Any]:
        """State and inputs of the plant alone."""
        change = x.z[self.internal : self.internal + len(self.driven)]
        inputs = u[: self.inputs]
        return State(x.y, x.z[: self.internal]), inputs.at[np.asarray(self.driven)].add(change)


@dataclass(frozen=True)
class _Dynamics:
    """f of the closed loop."""

    base: Dynamics
    layout: _Layout

    def __call__(self, t: Any, x: State, u: Any, p: Any) -> Any:
        return self.base(t, *self.layout.opened(x, jnp.asarray(u)), p)


@dataclass(frozen=True)
class _Internal:
    """g: δ and σ stand still, and the clock runs down."""

    base: Dynamics | None
    layout: _Layout

    def __call__(self, t: Any, x: State, u: Any, p: Any) -> Any:
        still = jnp.zeros(len(self.layout.driven) + self.layout.memory, x.z.dtype)
        clock = -jnp.ones(1, x.z.dtype)
        if self.base is None:
            return jnp.concatenate([still, clock])
        rate = jnp.asarray(self.base(t, *self.layout.opened(x, jnp.asarray(u)), p))
        return jnp.concatenate([jnp.reshape(rate, (self.layout.internal,)), still, clock])


@dataclass(frozen=True)
class _Initial:
    """Initial internal states that are a function of the parameters."""

    base: Any
    added: int

    def __call__(self, p: Any) -> Any:
        start = jnp.ravel(jnp.asarray(self.base(p)))
        return jnp.concatenate([start, jnp.zeros(self.added, start.dtype)])


@dataclass(frozen=True)
class _Update:
    """δ and σ after a sample."""

    controller: Controller
    layout: _Layout

    def __call__(self, t: Any, x: State, u: Any, p: Any) -> Any:
        del p
        layout, count = self.layout, len(self.layout.driven)
        _, r, measured, state, following = layout.split(jnp.asarray(u))
        first = layout.internal + count
        state = state + x.z[first : first + layout.memory]
        inputs, new_state = self.controller.step(t, r, x.y[0], state, count)
        return jnp.concatenate([inputs - measured, new_state - following])


def _closed_plant(plant: Plant, controller: Controller, layout: _Layout, period: float) -> Plant:
    names = (
        *plant.inputs,
        *controller.reference,
        *(f"law for {plant.inputs[i]}" for i in layout.driven),
        *(f"controller state {i + 1}" for i in range(layout.memory)),
        *(f"next controller state {i + 1}" for i in range(layout.memory)),
    )
    sampled = SampledStates(_Update(controller, layout), len(layout.driven) + layout.memory, period)
    start = plant.internal_initial
    if callable(start):
        initial = _Initial(start, sampled.size)
    else:
        initial = (*start, *(0.0,) * sampled.size)
    limits = zip(plant.names, plant.lower.tolist(), plant.upper.tolist(), strict=True)
    channels = (*plant.names, *plant.inputs, *plant.outputs)
    return Plant(
        _Dynamics(plant.dynamics, layout),
        plant.parameters,
        plant.degrees,
        names,
        plant.outputs,
        _Internal(plant.internal, layout),
        initial,
        {name: (low, high) for name, low, high in limits},
        plant.fixed,
        {key: unit for key, unit in plant.units.items() if key in channels},
        plant.name,
        kinds=dict(plant.kind_items),
        sampled=sampled,
    )


# -- records ------------------------------------------------------------------------------


@dataclass(frozen=True)
class ClosedLoop:
    """A plant and its records with the controller in the loop.

    Attributes:
        plant: to be simulated. records: along these.
        opened: the plant alone. originals: its records, with the inputs that it has.
        note: how well the controller reproduces the recorded inputs.
    """

    plant: Plant
    records: tuple[Record, ...]
    opened: Plant
    originals: tuple[Record, ...]
    note: str

    def opened_at(self, closed: Plant) -> Plant:
        """The plant alone, with the parameters of a closed loop, which may have fixed more."""
        if closed.fixed == self.opened.fixed:
            return self.opened.with_parameters(closed.theta)
        return self.opened.declared_anew(closed.parameters, fixed=closed.fixed)

    def predictions(self, simulated: Sequence[Record]) -> tuple[Record, ...]:
        """Simulated records with the inputs of the original ones."""
        return tuple(
            record.with_inputs(original.inputs, original.input_names)
            for record, original in zip(simulated, self.originals, strict=True)
        )


def closed_loop(
    plant: Plant, records: Record | Sequence[Record], controller: Controller
) -> ClosedLoop:
    """A plant along records with the controller in the loop.

    Args:
        plant: the plant alone.
        records: with the inputs of the plant and the references of the controller.
        controller: of some or all of its inputs.

    Raises:
        ValueError: no controller, a reference that is no input of a record, a plant with delays or
            lags of inputs or with outputs of relative degree 0, records of different sampling, of
            another hold than zero or with skewed inputs, a law of wrong shapes, a controller with
            a state where outputs are missing, one that does not reproduce the recorded input.
    """
    check_kind("controller", controller, Controller, "a Controller")
    opened, driven = _checked(plant, records, controller)
    layout = _Layout(
        len(plant.inputs),
        driven,
        len(controller.reference),
        controller.size(len(driven)),
        len(plant.initial_internal),
    )
    controller.check_shapes(len(plant.outputs), len(driven))
    closed = _closed_plant(plant, controller, layout, opened[0][0].sample_period)
    closed_records, notes = [], []
    for record, references in opened:
        closed_record, note = _closed_record(record, references, closed, controller, layout)
        closed_records.append(closed_record)
        notes.append(note)
    note = f"Simulated with the controller in the loop. It reproduces {'; '.join(notes)}."
    if not all(record.hold_declared for record in _as_sequence(records)):
        note += " Nobody declared the hold of the inputs: a controller holds them (zero)."
    return ClosedLoop(
        closed, tuple(closed_records), plant, tuple(record for record, _ in opened), note
    )


def _as_sequence(records: Record | Sequence[Record]) -> tuple[Record, ...]:
    return (records,) if isinstance(records, Record) else tuple(records)


Opened = list[tuple[Record, Float[np.ndarray, "time nr"]]]


def _checked(
    plant: Plant, records: Record | Sequence[Record], controller: Controller
) -> tuple[Opened, tuple[int, ...]]:
    """The records with the plant's inputs and their references, and the driven inputs."""
    check_kind("plant", plant, Plant, "a Plant")
    rule = "must act on the plant at once where a controller drives them"
    advice = "Write the delay or lag as internal states, or as `delay` of the controller."
    check(plant.actuator is None, "plant.inputs", rule, "a delay or lag", advice)
    rule = "must be states (relative degree 1 or more) for a controller to read them"
    check(not plant.has_algebraic, "plant.outputs", rule, "relative degree 0")
    opened: Opened = []
    for record in _as_sequence(records):
        check_kind("records", record, Record, "a Record or several")
        for name in controller.reference:
            check_choice(f"controller.reference (input of {record.name})", name, record.input_names)
        index = [record.input_names.index(name) for name in controller.reference]
        alone = record.without_inputs(*controller.reference) if index else record
        opened.append((alone, record.inputs[:, index]))
    check_records(plant, [record for record, _ in opened])
    periods = [record.sample_period for record, _ in opened]
    rule = "must have the same sample period, that of the controller"
    same = np.ptp(periods) <= 1e-6 * max(periods)
    check(bool(same), "records", rule, f"{min(periods):g} s to {max(periods):g} s")
    for record, _ in opened:
        rule = "must be zero: a digital controller holds its output until the next sample"
        good = record.hold == "zero" or not record.hold_declared
        check(good, f"records[{record.name}].hold", rule, record.hold)
        rule = "must be zero: the controller sets its inputs at the instants of the samples"
        check(not np.any(record.skew), f"records[{record.name}].skew", rule, record.skew)
    return [(record.with_hold("zero"), r) for record, r in opened], controller.driven(plant.inputs)


def _closed_record(
    record: Record,
    references: Float[np.ndarray, "time nr"],
    closed: Plant,
    controller: Controller,
    layout: _Layout,
) -> tuple[Record, str]:
    """The record with what the law needs as further inputs, and how near the law came."""
    inputs, memory = record.inputs[:, layout.driven], layout.memory
    law, state, following = inputs.copy(), *np.zeros((2, len(record), memory))
    stretches = []
    for start, stop in record.input_segments():
        samples = slice(start, stop)
        missing = int(np.sum(~np.all(record.output_valid[samples], axis=1)))
        check(missing == 0 or not memory, f"records[{record.name}].outputs",
              "must be measured at every sample, as the state of the controller follows from them",
              timed(missing, record.sample_period, "missing sample"),
              "Split the record there, or use windows with the recorded input.")  # fmt: skip
        replayed = replayed_along(controller, record, references, inputs, samples)
        stretches.append((samples, replayed))
        law[samples] = np.where(replayed.valid[:, None], replayed.u, inputs[samples])
        state[samples], following[samples] = replayed.states, replayed.next_states
    note = compared(record, inputs, law, stretches, controller, layout.driven)
    columns = np.concatenate([record.inputs, references, law, state, following], axis=1)
    names = (*record.input_names, *closed.inputs[layout.inputs :])
    return record.with_inputs(columns, names), note
