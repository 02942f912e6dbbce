"""The free run of `simulate` as a function of arrays, for use inside other JAX code."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from eoi_jax._checks import check, check_choice, check_kind, check_positive, check_shape
from eoi_jax._types import Scalar
from eoi_jax.compiler.jax_private import Tracer
from eoi_jax.data.input_holds import TRACED_HOLDS
from eoi_jax.data.record import Record
from eoi_jax.models.free_starts import check_no_free_start
from eoi_jax.models.plant import Plant, State
from eoi_jax.simulation.integrator import free_run, frictional
from eoi_jax.simulation.simulate import acted, drive, initial_outputs


def rollout(
    plant: Plant,
    theta: Any,
    x0: Any,
    u: Any,
    h: Scalar | float,
    *,
    hold: str = "zero",
    substeps: int = 1,
    t0: Scalar | float = 0.0,
) -> State:
    """Free run of a plant, a pure function of arrays: `jit`, `vmap`, `grad` and `jvp` apply.

    The integrator is that of `simulate`: fourth-order Runge-Kutta steps of fixed length, cut where
    an output comes to rest, so that dry friction sticks, and where equations without dry friction
    jump with the state. Derivatives are those of the run with these instants: they are exact where
    a small change of the arguments leaves the order of stops, departures and jumps as it is. At
    other jumps (with time or inputs alone, with the state beside dry friction) they lack that of
    the instant.

    Args:
        plant: the equations. Which outputs stick is found at its own parameters.
        theta: parameter values: an array (np,) in the plant's order, a dict by name (the others are
            the plant's), or None for the plant's own.
        x0: state at the first sample: outputs and their derivatives, shape (r, ny), for a single
            output (r,), or by name, ``{"angle": (0.1, 0.0)}``; a `State`, which has internal states
            too; None for the plant's known starts, and zeros.
        u: inputs at the samples, shape (N, nu), for a single input (N,); (N, 0) without inputs.
        h: sample period [s]; where JAX traces it, its sign is not checked.
        hold: inputs between samples: ``"zero"`` (held) or ``"linear"``.
        substeps: Runge-Kutta steps per sample. `simulate` chooses their number by itself, this
            function does not: see that more do not change the result.
        t0: time of the first sample [s].

    Returns:
        States at all samples: `.y` of shape (N, r, ny), whose `.y[:, 0]` are the outputs, and `.z`
        of shape (N, nz). Where the run leaves the finite numbers, so do they.

    Raises:
        ValueError: a wrong shape, h ≤ 0, an unknown name or hold, less than one sub-step, or dry
            friction that the simulation does not cover.
    """
    check_kind("plant", plant, Plant, "a Plant")
    check_choice("hold", hold, TRACED_HOLDS)
    if not isinstance(h, Tracer):
        check_positive("h", h, "It is the sample period in seconds.")
    values = jnp.asarray((plant if theta is None else plant.with_parameters(theta)).theta, float)
    check(not isinstance(u, Record), "u", "must be an array", "a Record", "Give its `.inputs`.")
    inputs = jnp.asarray(u, float)
    inputs = inputs[:, None] if inputs.ndim == 1 else inputs
    rule, advice = "one row a sample, a column an input", "For several runs use `jax.vmap`."
    check_shape("u", inputs, (None, len(plant.inputs)), rule, advice)
    check(len(inputs) > 1, "u", "must have at least two samples", len(inputs))
    initial, internal = (x0.y, x0.z) if isinstance(x0, State) else (x0, None)
    if internal is None:
        check_no_free_start(plant, "x0", "Give `State(y, z)` with all internal states.")
        internal = plant.internal_start(values)
    check_shape("x0.z", internal, plant.internal_start(values).shape, "one value an internal state")
    start = State(initial_outputs(plant, initial, jnp), jnp.asarray(internal, float))
    time = t0 + h * np.arange(len(inputs))
    driven_by = acted(plant, drive(jnp.asarray(time, float), inputs, hold, substeps), values)
    return State(*free_run(plant, values, driven_by, start, frictional(plant), True))
