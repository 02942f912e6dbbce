"""Records of the paper's plants that share no code with the library's simulator.

An estimate from data that the estimator's own simulator made proves little: both may err alike.
Here the equations are written a second time, and solved another way:

- linear plants: the exact solution for an input that is held, or linear, between samples (matrix
  exponential; run mode by mode). Accuracy: rounding, about 1e-15 of y.
- tank: a Taylor series of third order for the square root of the level, in plain Python floats. At
  0.1 ms its steps err by about 1e-18 each.
- pendulum: SciPy's DOP853 to 1e-12 from event to event; a stop is an event, and at rest it sticks
  until the input frees it. Steps are at most 4 ms, so that dense output errs by less than 1e-12.

Where the library's simulator agrees, and how closely, is a column of the tables.
"""

import math
from collections.abc import Callable, Mapping
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import lfilter

GRAVITY = 9.81
Parameters = Mapping[str, float]


def three_masses(p: Parameters, time: np.ndarray, u: np.ndarray, hold: str) -> np.ndarray:
    """Eq. (18) from rest: positions, shape (N, 3)."""
    a = np.zeros((6, 6))
    a[:3, 3:] = np.eye(3)
    a[3, [0, 1, 3]] = -p["a2"], p["a3"], -p["a4"]
    a[4, [0, 1, 2, 4]] = p["b1"], -p["b2"], p["b3"], -p["b4"]
    a[5, [1, 2, 5]] = p["c1"], -p["c2"], -p["c3"]
    return _linear(a, np.array([0, 0, 0, p["a1"], 0, 0]), time, u, hold)[:, :3]


def one_mass(p: Parameters, time: np.ndarray, u: np.ndarray, hold: str) -> np.ndarray:
    """Eq. (21) from rest: position, shape (N, 1)."""
    a = np.array([[0.0, 1.0], [-p["alpha"], -p["beta"]]])
    return _linear(a, np.array([0.0, p["rho"]]), time, u, hold)[:, :1]


def level_tank(
    p: Parameters, time: np.ndarray, u: np.ndarray, hold: str, start: float
) -> np.ndarray:
    """Eq. (16) from the level `start`: level, shape (N, 1)."""
    h, half, beta = _period(time), 0.5 * p["alpha"] * math.sqrt(2.0 * GRAVITY), p["beta"]
    first = u.tolist()
    last = first if hold == "zero" else [*first[1:], first[-1]]
    root, levels = math.sqrt(start), [start]
    for v0, v1 in zip(first[:-1], last[:-1], strict=True):
        # s = √x: s' = -half + q r with r = 1/s and q = ½ β V, V linear in time.
        q, dq, r = 0.5 * beta * v0, 0.5 * beta * (v1 - v0) / h, 1.0 / root
        s1 = q * r - half
        r1 = -r * r * s1
        s2 = dq * r + q * r1
        r2 = 2.0 * r**3 * s1**2 - r * r * s2
        s3 = 2.0 * dq * r1 + q * r2
        root += h * (s1 + 0.5 * h * (s2 + h / 3.0 * s3))
        levels.append(root * root)
    return np.asarray(levels)[:, None]


def pendulum(p: Parameters, time: np.ndarray, u: np.ndarray, hold: str) -> np.ndarray:
    """Eq. (20) from rest under a held input, dry friction sticking: angle, shape (N, 1)."""
    if hold != "zero":
        raise ValueError(f"`hold` must be zero: events are solved for a held input, got {hold}.")
    angle = np.zeros(len(time))
    edges = [0, *(np.flatnonzero(np.diff(u)) + 1).tolist(), len(time) - 1]
    state = (0.0, 0.0)
    for first, last in pairwise(edges):
        stamps, push = time[first : last + 1], p["d"] * u[first]

        def smooth(y: float, v: float, push: float = push) -> float:
            return push - p["a"] * math.sin(y) - p["b"] * v

        angle[first : last + 1], state = _swing(smooth, p["c"], stamps, state)
    return angle[:, None]


def body(
    smooth: Callable[[float, float, float], float],
    level: float,
    time: np.ndarray,
    u: np.ndarray,
) -> np.ndarray:
    """y'' = smooth(y, y', u) - level sign(y') from rest under a held input: y, shape (N, 1).

    To nine digits: for records with noise.
    """
    y = np.zeros(len(time))
    edges = [0, *(np.flatnonzero(np.diff(u)) + 1).tolist(), len(time) - 1]
    state = (0.0, 0.0)
    for first, last in pairwise(edges):
        stamps, push = time[first : last + 1], float(u[first])

        def pushed(y: float, v: float, push: float = push) -> float:
            return smooth(y, v, push)

        longest = 20.0 * _period(time)  # so that no two stops fall into one step
        y[first : last + 1], state = _swing(pushed, level, stamps, state, longest, 1e-9)
    return y[:, None]


def duffing(p: Parameters, time: np.ndarray, u: np.ndarray, hold: str) -> np.ndarray:
    """Duffing oscillator from rest under a held input: displacement, shape (N, 1).

    Thirty steps of Gauss's rule of order four (two stages) a sample, in plain Python floats: at a
    tenth of a period a sample they err by about 1e-9 of y.
    """
    if hold != "zero":
        raise ValueError(f"`hold` must be zero: steps do not cross a change, got {hold}.")
    count = 30
    h, c, k, k3 = _period(time) / count, p["damping"], p["stiffness"], p["cubic_stiffness"]
    root = math.sqrt(3.0) / 6.0
    a11, a12, a21, a22 = 0.25 * h, (0.25 - root) * h, (0.25 + root) * h, 0.25 * h
    y = v = 0.0
    out = [0.0]
    for value in u[:-1].tolist():
        push = p["gain"] * value + p["offset"]
        for _ in range(count):
            v1 = v2 = v
            f1 = f2 = push - c * v - k * y - k3 * y**3
            for _ in range(4):  # each round of the fixed point gains a factor of h ω
                v1, v2 = v + a11 * f1 + a12 * f2, v + a21 * f1 + a22 * f2
                y1, y2 = y + a11 * v1 + a12 * v2, y + a21 * v1 + a22 * v2
                f1, f2 = push - c * v1 - k * y1 - k3 * y1**3, push - c * v2 - k * y2 - k3 * y2**3
            y, v = y + 0.5 * h * (v1 + v2), v + 0.5 * h * (f1 + f2)
        out.append(y)
    return np.asarray(out)[:, None]


def _swing(
    smooth: Callable[[float, float], float],
    level: float,
    stamps: np.ndarray,
    state: tuple[float, float],
    longest: float = 4e-3,
    rtol: float = 1e-12,
) -> tuple[np.ndarray, tuple[float, float]]:
    """Positions at `stamps`, position and velocity at the last one, with dry friction `level`."""
    y, v = state
    t, end = float(stamps[0]), float(stamps[-1])
    out = np.full(len(stamps), y)
    while t < end:
        force = smooth(y, 0.0)
        if v == 0.0 and abs(force) <= level:  # it sticks, and nothing changes any more
            out[stamps >= t] = y
            return out, (y, 0.0)
        way = math.copysign(1.0, v if v != 0.0 else force)

        def field(_t: float, x: np.ndarray, way: float = way) -> tuple[float, float]:
            return x[1], smooth(x[0], x[1]) - way * level

        def stop(_t: float, x: np.ndarray) -> float:
            return x[1]

        stop.terminal, stop.direction = level > 0.0, -way  # type: ignore[attr-defined]
        leg = solve_ivp(
            field, (t, end), (y, v), "DOP853", dense_output=True, events=stop,
            rtol=rtol, atol=1e-2 * rtol, max_step=longest,
        )  # fmt: skip
        inside = (stamps >= t) & (stamps <= leg.t[-1])
        out[inside] = leg.sol(stamps[inside])[0]
        t, y = float(leg.t[-1]), float(leg.y[0, -1])
        v = 0.0 if leg.status == 1 else float(leg.y[1, -1])
    return out, (y, v)


def _linear(a: np.ndarray, b: np.ndarray, time: np.ndarray, u: np.ndarray, hold: str) -> np.ndarray:
    """States of ẋ = a x + b u from rest, exact at the samples, shape (N, n)."""
    n, h = len(b), _period(time)
    # u and its slope as two more states: the top row blocks give ∫e^{a s} b and ∫∫e^{a s} b.
    big = np.zeros((n + 2, n + 2))
    big[:n, :n], big[:n, n], big[n, n + 1] = a, b, 1.0
    step = expm(big * h)
    slope = np.diff(u) / h if hold == "linear" else np.zeros(len(u) - 1)
    eigenvalues, modes = np.linalg.eig(a)
    drive = np.linalg.solve(modes, step[:n, n:].astype(complex))
    x = np.zeros((len(u), n))
    for mode, (value, gains) in enumerate(zip(eigenvalues, drive, strict=True)):
        forced = gains[0] * u[:-1] + gains[1] * slope
        z = lfilter([1.0], [1.0, -np.exp(value * h)], forced)
        x[1:] += np.real(np.outer(z, modes[:, mode]))
    return x


def _period(time: np.ndarray) -> float:
    return float(time[-1] - time[0]) / (len(time) - 1)


def with_sensor(
    y: np.ndarray, noise: np.ndarray | float, quantum: np.ndarray | float, seed: int
) -> np.ndarray:
    """White noise of that standard deviation added, then rounded to multiples of `quantum`."""
    seen = y + noise * np.random.default_rng(seed).standard_normal(y.shape)
    steps = np.broadcast_to(quantum, y.shape[1:])
    return np.where(steps > 0, np.round(seen / np.where(steps > 0, steps, 1.0)) * steps, seen)
