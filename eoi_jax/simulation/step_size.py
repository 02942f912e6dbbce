r"""Steps per sample of a simulation, from the fastest mode of the model.

A mode $e^{\lambda t}$ that is far faster than the sampling leaves no trace between two samples, but
the classical Runge-Kutta rule is stable only for $|\lambda h| < 2.8$, and its relative error per
step is $|\lambda h|^5 / 120$ (Hairer, Nørsett, Wanner, *Solving Ordinary Differential Equations I*,
sections II.1 and IV.2). λ are eigenvalues of the Jacobian of the whole state, outputs with their
derivatives and internal states, linearised along the measured signals.

That is where the halving of steps begins, not where it ends: the signals do not show every mode
that a run meets. A sensor that is full at 10 V never passes a rim that the model has at 10.1 V, and
an internal state is taken where it starts. At such a kink of f an explicit rule whose step is too
long does not diverge: it overshoots to the side without the fast mode, again and again. Only runs
with shorter steps tell, so steps are halved until these agree. Their error falls with h at least;
that of a chaotic run does not, and no steps are short enough for it.
"""

from collections.abc import Callable, Sequence, Sized
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from eoi_jax.compiler.pointwise import slopes_along
from eoi_jax.data.record import Record
from eoi_jax.models.jacobians import driven
from eoi_jax.models.plant import Plant, State
from eoi_jax.simulation.rates import rate_of


@dataclass(frozen=True)
class StepRules:
    """How the steps of a simulation follow from the model.

    Attributes:
        coarsest: steps per sample at least, which double until they are short enough. Four are
            exact enough for a record that is sampled ten times per period of its resonance.
        mode: largest |λh| of the fastest mode; a step then errs by 3e-4 of it.
        visible: rms change by halving, over the rms of the residual, that asks for shorter steps.
        resolution: the same change over the rms of the output, which shows in no measurement: less
            than a step of a converter of 23 bits.
        simulated: likewise of `simulate`, whose runs nothing was measured for, over the spread of
            the output: a tenth of the noise of a good sensor.
        halvings: how often steps are halved before it is asked whether that leads anywhere: whether
            the change is of first order in h. A chaotic run never settles.
        finest: steps per sample at most: a mode with a time constant of 1/500 of the sample period
            is followed. Faster ones are better replaced by their steady state.
        total: steps at most in all records together, because of their memory.
        instants: number of samples of a record at which the Jacobian is taken.
        quantile: of |λ| over these samples that counts: a slope that is infinite at one point (the
            root of an empty tank) is no mode.
    """

    coarsest: int = 4
    mode: float = 0.5
    visible: float = 0.02
    resolution: float = 1e-7
    simulated: float = 1e-4
    halvings: int = 3
    finest: int = 1024
    total: int = 20_000_000
    instants: int = 500
    quantile: float = 0.99


RULES = StepRules()


def fastest_mode(plant: Plant, record: Record, quantile: float = RULES.quantile) -> float:
    """Largest |λ| of the linearised plant along a record [1/s]; 0 where there is none.

    Derivatives of outputs are differences of the samples, internal states are where the plant
    starts them.

    Args:
        plant: with its parameter values.
        record: of its inputs and outputs.
        quantile: of |λ| over the samples.
    """
    record = record.bridged
    usable = record.valid if np.any(record.valid) else np.ones(len(record), dtype=bool)
    signals = record.time, record.inputs, record.outputs
    return mode_along(plant, *signals, usable, quantile)


def mode_along(
    plant: Plant,
    time: Float[np.ndarray, " time"],
    inputs: Float[np.ndarray, "time nu"],
    outputs: Float[np.ndarray, "time ny"],
    usable: Bool[np.ndarray, " time"] | None = None,
    quantile: float = RULES.quantile,
) -> float:
    """`fastest_mode` along signals that are no record.

    Args:
        plant: with its parameter values.
        time: uniform grid [s].
        inputs: at each instant.
        outputs: likewise.
        usable: instants that count; None: all.
        quantile: as of `fastest_mode`.
    """
    rows = [outputs]
    for _ in range(1, plant.relative_degree):
        rows.append(np.gradient(rows[-1], time[1] - time[0], axis=0))
    acted_inputs = np.asarray(driven(plant, time, inputs))
    instants = np.arange(len(time)) if usable is None else np.flatnonzero(usable)
    # Always as many, so that a plant which only XLA evaluates is compiled once.
    index = instants[np.linspace(0, len(instants) - 1, RULES.instants).astype(int)]
    y = np.stack(rows, axis=1)[index].reshape(len(index), -1)
    z = np.broadcast_to(plant.initial_internal, (len(index), len(plant.initial_internal)))
    signals = time[index], acted_inputs[index]
    x = np.concatenate([y, z], axis=1)
    slopes = slopes_along(_rates, ("fixed", "rows", "rows"), 2, plant, signals, x)
    slopes = slopes[np.all(np.isfinite(slopes), axis=(1, 2))]
    if not slopes.size:
        return 0.0
    sizes = np.max(np.abs(np.linalg.eigvals(slopes)), axis=1)
    return float(np.quantile(sizes, quantile))


@dataclass(frozen=True)
class StepChoice:
    """Steps per sample by the fastest mode.

    Attributes:
        count: steps per sample.
        note: a sentence where the mode is too fast for as many steps as there may be, else "".
    """

    count: int
    note: str = ""


def choose_steps(plant: Plant, records: Sequence[Record], total: int = RULES.total) -> StepChoice:
    """Steps per sample by which the fastest mode of a plant is followed along all records.

    Args:
        plant: with its parameter values.
        records: of its inputs and outputs.
        total: steps at most in all records together.
    """
    rates = [fastest_mode(plant, record) * record.sample_period for record in records]
    number = int(np.argmax(rates))
    count, limit = RULES.coarsest, finest_steps(records, total)
    while count * RULES.mode < rates[number] and 2 * count <= limit:
        count *= 2
    if count * RULES.mode >= rates[number]:
        return StepChoice(count)
    period = records[number].sample_period
    return StepChoice(count, (
        f"The model has a mode with a time constant of {period / rates[number]:.2g} s, which needs "
        f"more than {count} steps of the simulation in a sample period of {period:.2g} s. Replace "
        "the fast state by its steady state, or bound the parameters that make it fast."
    ))  # fmt: skip


# Rms by which halving the steps changes runs, of what they leave of the outputs, and of these.
StepChange = tuple[Float[np.ndarray, " ny"], Float[np.ndarray, " ny"], Float[np.ndarray, " ny"]]


def settled_steps(
    count: int,
    limit: int,
    change: Callable[[int], StepChange],
    resolution: float = RULES.resolution,
) -> tuple[int, bool]:
    """Steps per sample, doubled until runs of half as long ones agree.

    Args:
        count: to begin with.
        limit: steps per sample at most.
        change: of the runs by halving such steps, the residual of the finer ones, not finite where
            they diverge, and the measured outputs.
        resolution: share of the measured outputs that shows in nothing.

    Returns:
        The fewest that are enough, or, where none are, the most that were looked at; and whether
        they are enough.
    """
    first, halvings = np.zeros(0), 0
    while 2 * count <= limit:
        size, residual, measured = change(count)
        enough = size <= np.maximum(RULES.visible * residual, resolution * measured)
        if np.all(enough):
            return count, True
        first = size if halvings == 0 else first
        # Of first order at least; what is so in the limit begins a little slower.
        falls = np.isfinite(size) & ~(size > 1.2 * first / 2**halvings)
        count, halvings = 2 * count, halvings + 1
        if halvings > RULES.halvings and not np.all(falls | enough):
            break
    return count, False


def finest_steps(records: Sequence[Sized], total: int = RULES.total) -> int:
    """Steps per sample that records of these lengths may have at most, so many in all."""
    return min(RULES.finest, max(total // sum(map(len, records)), RULES.coarsest))


def _rates(plant: Plant, row: tuple[Any, ...], x: Array) -> Float[Array, " states"]:
    """dx/dt, all outputs with their derivatives first."""
    (t, u), ny = row, len(plant.outputs)
    size = plant.rows * ny
    state = State(jnp.reshape(x[:size], (plant.rows, ny)), x[size:])
    slope = rate_of(plant, jnp.asarray(plant.theta), t, state, u)
    return jnp.concatenate([jnp.ravel(slope.y), slope.z])
