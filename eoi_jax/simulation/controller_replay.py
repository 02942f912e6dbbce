"""The controller of a record, run on its measured outputs: does it give the recorded inputs?

Its state at the start is the one with which it comes nearest, by least squares, unless it is known.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from eoi_jax._checks import check, counted, percent
from eoi_jax.compiler.programs import jit
from eoi_jax.data.noise import quanta
from eoi_jax.data.record import Record
from eoi_jax.models.controller import Controller


@dataclass(frozen=True)
class ReplaySettings:
    """How a controller is compared with the recorded input.

    Attributes:
        levels: a recorded input with at least so many steps of quantisation in its range may differ
            from the law by one of them.
        rounding: rms of a difference by truncation, over the step, and some more.
        explains: share of the difference below which another law is named as the reason.
        longest: delay that is tried as the reason [samples].
    """

    levels: int = 8
    rounding: float = 0.6
    explains: float = 0.2
    longest: int = 3


_SETTINGS = ReplaySettings()

Host = Array | np.ndarray


@jit(static=("controller", "count"))
def _replay(
    controller: Controller,
    count: int,
    time: Float[Host, " time"],
    r: Float[Host, "time nr"],
    y: Float[Host, "time ny"],
    start: Float[Host, " memory"],
) -> tuple[Array, Array, Array]:
    """Inputs, the memory after each sample, and derivatives of the inputs with the start."""

    def run(start: Array) -> tuple[Array, Array]:
        def body(s: Array, row: tuple) -> tuple[Array, tuple[Array, Array]]:
            t, references, outputs = row
            u, s = controller.step(t, references, outputs, s, count)
            return s, (u, s)

        rows = (jnp.asarray(time), jnp.asarray(r), jnp.asarray(y))
        return jax.lax.scan(body, start, rows)[1]

    u, memory = run(jnp.asarray(start))
    slopes = jax.jacfwd(lambda value: run(value)[0])(jnp.asarray(start))
    return u, memory, slopes


@dataclass(frozen=True)
class Replayed:
    """The controller on the measured outputs of one stretch with known inputs.

    Attributes:
        u: c^m, (time, count).
        states: s^m, (time, memory). next_states: of the next sample, likewise.
        slopes: derivatives of u with the controller's own states at the start, (time, count, own).
        valid: where the outputs were measured, (time,).
    """

    u: Float[np.ndarray, "time count"]
    states: Float[np.ndarray, "time memory"]
    next_states: Float[np.ndarray, "time memory"]
    slopes: Float[np.ndarray, "time count own"]
    valid: Bool[np.ndarray, " time"]


def replayed_along(
    controller: Controller,
    record: Record,
    references: Float[np.ndarray, "time nr"],
    inputs: Float[np.ndarray, "time count"],
    samples: slice,
) -> Replayed:
    """The controller on the measured outputs of a stretch, from the state that comes nearest.

    Args:
        controller: of the record.
        record: with the inputs of the plant.
        references: at all its samples.
        inputs: that the controller drives, likewise.
        samples: of the stretch.
    """
    from scipy.optimize import least_squares

    count, states = inputs.shape[1], controller.states
    signals = record.time[samples], references[samples], record.outputs[samples]
    u, valid = inputs[samples], np.all(record.output_valid[samples], axis=1)
    waiting = np.zeros((controller.delay, count))
    waiting[: len(u)] = u[: controller.delay]
    run = partial(_replay, controller=controller, count=count, time=signals[0], r=signals[1],
                  y=signals[2])  # fmt: skip

    def replay(state: np.ndarray) -> tuple[np.ndarray, ...]:
        return tuple(map(np.asarray, run(start=np.concatenate([state, waiting.ravel()]))))

    state = np.zeros(states)
    if controller.initial is not None and samples.start == 0:
        state = np.asarray(controller.initial)
    elif states:
        scale = np.where(np.std(u, axis=0) > 0, np.std(u, axis=0), 1.0)

        def error(state: np.ndarray) -> np.ndarray:
            return (((replay(state)[0] - u) / scale)[valid]).ravel()

        def slopes(state: np.ndarray) -> np.ndarray:
            return (replay(state)[2][..., :states] / scale[:, None])[valid].reshape(-1, states)

        fit: Any = least_squares(error, state, slopes, x_scale="jac")  # type: ignore[arg-type]
        state = fit.x
    law, updated, moved = replay(state)
    start = np.concatenate([state, waiting.ravel()])[None]
    memory = np.concatenate([start, updated])
    return Replayed(law, memory[:-1], memory[1:], moved[..., :states], valid)


def compared(
    record: Record,
    inputs: Float[np.ndarray, "time count"],
    law: Float[np.ndarray, "time count"],
    stretches: Sequence[tuple[slice, Replayed]],
    controller: Controller,
    driven: Sequence[int],
) -> str:
    """How near the law comes to the recorded inputs, in words.

    Args:
        record: with the inputs of the plant.
        inputs: those that the controller drives.
        law: what it gives, where that is known.
        stretches: samples of each stretch with known inputs, and the controller on them.
        controller: of the record.
        driven: numbers of its inputs.

    Raises:
        ValueError: not near enough.
    """
    covered = np.zeros(len(record), dtype=bool)
    for samples, replayed in stretches:
        covered[samples] = replayed.valid
    rule = "must have a sample with known inputs and outputs for the controller"
    check(bool(np.any(covered)), f"records[{record.name}]", rule, "none")
    shares = []
    for j, number in enumerate(driven):
        name, u = record.input_names[number], inputs[covered, j]
        unit, error = record.units.get(name, ""), u - law[covered, j]
        size, spread = float(np.sqrt(np.mean(error**2))), float(np.std(u))
        quantum = float(quanta(u[:, None], np.ones((len(u), 1), dtype=bool))[0])
        rounding = _SETTINGS.rounding * quantum
        if quantum * _SETTINGS.levels > np.ptp(u):
            rounding = 0.0
        relative = "no variation of it"
        if spread > 0:  # rounding alone says nothing
            relative = percent(size / spread) if size > 1e-9 * spread else "every digit"
        good = np.isfinite(size) and size <= max(controller.tolerance * spread, rounding, 1e-12)
        if not good:
            worst = record.time[covered][int(np.argmax(np.nan_to_num(np.abs(error), nan=np.inf)))]
            value = f"a difference of {size:.3g} {unit}".rstrip()
            value += f" rms ({relative} of its standard deviation), largest at t = {worst:g} s"
            rule = f"must reproduce the recorded input {name} of {record.name} from the measured "
            rule += f"outputs, to {100 * controller.tolerance:g} % or its quantisation"
            check(False, "controller", rule, value, _reason(inputs, stretches, j, size))
        shares.append(f"the recorded {name} of {record.name} to {relative}")
    return ", ".join(shares)


def _reason(
    inputs: Float[np.ndarray, "time count"],
    stretches: Sequence[tuple[slice, Replayed]],
    j: int,
    size: float,
) -> str:
    """Which simple change of the law explains the difference, as a sentence.

    The law delayed, times a factor, with an offset, each with the states at the start that then
    come nearest: their columns are part of the least squares.
    """
    candidates = [(0, True, False), (0, False, True), (0, True, True)]
    candidates += [(delay, False, False) for delay in range(1, _SETTINGS.longest + 1)]
    candidates += [(delay, True, False) for delay in range(1, _SETTINGS.longest + 1)]
    for delay, scaled, shifted in candidates:
        target, columns = [], []
        for samples, replayed in stretches:
            rows = np.flatnonzero(replayed.valid)
            rows = rows[rows >= delay]
            target.append(inputs[samples, j][rows])
            law = replayed.u[rows - delay, j][:, None]
            slopes = replayed.slopes[rows - delay, j]
            columns.append(np.concatenate([law, np.ones_like(law), slopes], axis=1))
        u, design = np.concatenate(target), np.concatenate(columns)
        fixed = np.zeros(len(u)) if scaled else design[:, 0]
        design = design[:, [scaled, shifted, *(True,) * (design.shape[1] - 2)]]
        if not np.all(np.isfinite(design)) or len(u) <= design.shape[1]:
            continue
        values = np.linalg.lstsq(design, u - fixed, rcond=1e-10)[0]
        remaining = np.sqrt(np.mean((u - fixed - design @ values) ** 2))
        if remaining <= _SETTINGS.explains * size:
            parts = [f"a delay of {counted(delay, 'sample')} (`delay={delay}`)"] if delay else []
            parts += [f"a factor of {values[0]:.4g}"] if scaled else []
            parts += [f"an offset of {values[int(scaled)]:.4g}"] if shifted else []
            return f"With {' and '.join(parts)} the law would leave {remaining:.2g}."
    return (
        "Neither a delay of up to "
        f"{_SETTINGS.longest} samples, nor a factor, nor an offset explains it: look at gains, "
        "signs, limits, and at which signals the controller reads. Are the samples those of the "
        "controller? A record whose stamps are not uniform is resampled; `Record.from_period` "
        "takes the samples as they are."
    )
