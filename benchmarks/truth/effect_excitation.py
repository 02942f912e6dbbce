"""Inputs and references of the cases: four kinds, each loud and quiet by turns."""

import numpy as np
from scipy.signal import lfilter

KINDS = ("multisine", "steps", "chirp", "square")


def excitation(
    kind: str, rng: np.random.Generator, n: int, period: float, pace: float
) -> np.ndarray:
    """Input of largest value 1 around the plant's `pace` [rad/s], loud and quiet by turns, (n,)."""
    time = np.arange(n) * period
    if kind == "square":
        edges = np.cumsum(rng.uniform(0.8, 6.0, n) / pace)
        which = np.searchsorted(edges, time)
        shape = rng.uniform(0.1, 1.0, n)[which] * (1 - 2 * (which % 2))
        return shape / np.max(np.abs(shape))
    if kind == "steps":
        edges = np.cumsum(rng.uniform(0.5, 4.0, n) / pace)
        held = rng.uniform(-1.0, 1.0, n)[np.searchsorted(edges, time)]
        shape = low_pass(held, rng.uniform(2.0, 5.0) * pace, period)
    elif kind == "multisine":
        shape = _multisine(rng, time, pace, 24)
    else:
        shape = _chirp(rng, time, pace) + 0.4 * _multisine(rng, time, pace, 12)
    knots = rng.uniform(0.15, 1.0, 12)
    shape *= np.interp(time, np.linspace(0.0, time[-1], len(knots)), knots)
    return shape / np.max(np.abs(shape))


def _multisine(rng: np.random.Generator, time: np.ndarray, pace: float, lines: int) -> np.ndarray:
    w = pace * np.exp(rng.uniform(np.log(0.15), np.log(3.5), lines))
    phase = rng.uniform(0.0, 2 * np.pi, lines)
    out = np.zeros_like(time)
    for one, start in zip(w, phase, strict=True):
        out += np.sin(one * time + start)
    return out / np.sqrt(lines / 2)


def _chirp(rng: np.random.Generator, time: np.ndarray, pace: float) -> np.ndarray:
    """Up and down between 0.15 and 3 times the pace, a few times."""
    sweeps = rng.uniform(2.0, 4.0)
    place = 0.5 - 0.5 * np.cos(2 * np.pi * sweeps * time / time[-1])
    w = pace * 0.15 * 20.0**place
    return np.sin(np.cumsum(w) * (time[1] - time[0]) + rng.uniform(0.0, 2 * np.pi))


def low_pass(x: np.ndarray, corner: float, period: float) -> np.ndarray:
    """Two equal first-order lags at `corner` [rad/s]."""
    keep = np.exp(-corner * period)
    once = [(1.0 - keep) ** 2]
    return np.asarray(lfilter(once, [1.0, -2 * keep, keep**2], x))
