"""The rival of `refine_speed.py`: scipy `least_squares` over a loop that Numba compiles.

One simulator for each plant, written by hand with the state in local variables, as an expert would
for this very model; finite differences by scipy; the initial state among the unknowns. Shares the
inputs between the samples with the library (`simulate.drive`), and nothing else.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

import eoi_jax as eoi
from eoi_jax.simulation.simulate import drive

# Method and relative change of the cost at which to stop: scipy's own, and one nearer to ours.
SETTINGS = (("trf", 1e-8), ("lm", 1e-8), ("trf", 1e-6), ("lm", 1e-6))


def njit(function: Callable[..., np.ndarray]) -> Callable[..., np.ndarray]:
    """Compiled by Numba."""
    import numba

    return numba.njit(fastmath=True)(function)


@cache
def silverbox() -> Callable[..., np.ndarray]:
    """Runge-Kutta of order four; `u` (steps, 3) at the start, middle and end of each step."""

    @njit
    def run(p, y, v, u, h, substeps):
        gain, damping, stiffness, quadratic, cubic, offset = p
        out = np.empty(len(u) // substeps + 1)
        out[0] = y
        for k in range(len(u)):
            f0, f1, f2 = gain * u[k, 0] + offset, gain * u[k, 1] + offset, gain * u[k, 2] + offset
            a1 = f0 - damping * v - y * (stiffness + y * (quadratic + cubic * y))
            y2, v2 = y + 0.5 * h * v, v + 0.5 * h * a1
            a2 = f1 - damping * v2 - y2 * (stiffness + y2 * (quadratic + cubic * y2))
            y3, v3 = y + 0.5 * h * v2, v + 0.5 * h * a2
            a3 = f1 - damping * v3 - y3 * (stiffness + y3 * (quadratic + cubic * y3))
            y4, v4 = y + h * v3, v + h * a3
            a4 = f2 - damping * v4 - y4 * (stiffness + y4 * (quadratic + cubic * y4))
            y += h / 6.0 * (v + 2.0 * (v2 + v3) + v4)
            v += h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)
            if (k + 1) % substeps == 0:
                out[(k + 1) // substeps] = y
        return out

    return run


@cache
def emps() -> Callable[..., np.ndarray]:
    """The same, and dry friction: its side is held over a step, and a velocity that would turn
    stops on the way: for the rest of the step it sticks, or leaves the way the force pulls.
    """

    @njit
    def run(p, y, v, u, h, substeps):
        mass, viscous, coulomb, offset = p
        out = np.empty(len(u) // substeps + 1)
        out[0] = y
        b, dry = viscous / mass, coulomb / mass
        for k in range(len(u)):
            push = (u[k, 0] - offset) / mass
            if v > 0.0:
                force = push - dry
            elif v < 0.0 or push < -dry:
                force = push + dry
            elif push > dry:
                force = push - dry
            else:
                force = 0.0  # it sticks
            a1 = force - b * v
            v2 = v + 0.5 * h * a1
            a2 = force - b * v2
            v3 = v + 0.5 * h * a2
            a3 = force - b * v3
            v4 = v + h * a3
            a4 = force - b * v4
            after = v + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)
            if v * after < 0.0:
                part = h * v / (v - after)  # until it stops
                y += 0.5 * v * part
                away = max(push - dry, 0.0) + min(push + dry, 0.0)
                part = h - part
                v = away * part
                y += 0.5 * away * part * part
            else:
                y += h / 6.0 * (v + 2.0 * (v2 + v3) + v4)
                v = after
            if (k + 1) % substeps == 0:
                out[(k + 1) // substeps] = y
        return out

    return run


@dataclass(frozen=True)
class Fit:
    """What the rival found.

    Attributes:
        parameters: by name.
        cost: mean square error.
        evaluations: simulations, those for finite differences too.
        seconds: it took.
    """

    parameters: dict[str, float]
    cost: float
    evaluations: int
    seconds: float


def fit(
    run: Callable[..., np.ndarray], start: dict[str, float], record: eoi.Record, substeps: int,
    setting: tuple[str, float],
) -> Fit:  # fmt: skip
    """Output error from these parameters, everything that depends on the record included."""
    from scipy.optimize import least_squares

    began = time.perf_counter()
    method, tolerance = setting
    driven = drive(record.time, record.inputs, record.hold, substeps)
    u, h = np.ascontiguousarray(np.asarray(driven.inputs)[:, :, 0]), float(driven.step)
    y, (theta, scale) = record.outputs[:, 0], scaled(start)
    spread, count = np.std(y), 0

    def errors(x: np.ndarray) -> np.ndarray:
        nonlocal count
        count += 1
        error = (run(x[:-2] * scale, x[-2] * spread, x[-1] * rate, u, h, substeps) - y) / spread
        return np.clip(np.nan_to_num(error, nan=1e6), -1e6, 1e6)  # where a run diverges

    rate = np.std(np.diff(y)) / record.sample_period
    first = np.concatenate(
        [theta / scale, [y[0] / spread, (y[5] - y[0]) / (5 * h * substeps * rate)]]
    )
    options: dict[str, Any] = {"x_scale": "jac", "ftol": tolerance, "max_nfev": 2000}
    found = least_squares(errors, first, method=method, **options)
    parameters = dict(zip(start, map(float, found.x[:-2] * scale), strict=True))
    cost = float(np.mean(found.fun**2) * spread**2)
    return Fit(parameters, cost, count, time.perf_counter() - began)


def scaled(start: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Values and their sizes; one that starts at zero counts as the largest of the others."""
    theta = np.asarray(list(start.values()))
    size = np.abs(theta)
    return theta, np.where(size > 0, size, np.max(size))
