"""Library of the rival (see `sindy_rival`): terms, smoothed signals, and the equation in rows."""

# ruff: noqa: ARG005 (terms of one kind share one signature)

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import fft, sparse
from scipy.signal import lfilter

# What each model declares, by the keys of the terms below.
DECLARED: Mapping[str, tuple[str, ...]] = {
    "mass": ("linear_stiffness", "viscous_friction", "input"),
    "mass_no_spring": ("viscous_friction", "input"),
    "mass_no_damper": ("linear_stiffness", "input"),
    "pendulum": ("gravity", "viscous_friction", "coulomb_friction", "input"),
    "pendulum_frictionless": ("gravity", "viscous_friction", "input"),
    "pendulum_no_gravity": ("viscous_friction", "coulomb_friction", "input"),
    "tank": ("outflow", "input"),
}
CLIPS = (0.02, 0.045, 0.08, 0.12, 0.17, 0.23, 0.3, 0.38, 0.47, 0.57, 0.68, 0.8, 0.9)  # of max |u|
STOPS = (0.48, 0.58, 0.66, 0.73, 0.79, 0.84, 0.88, 0.915, 0.945, 0.97)  # quantiles of y


@dataclass(frozen=True)
class Term:
    """One column: the effect it stands for, its shape, the sign that its coefficient must have.

    Sign 0 is free. For terms in the input the sign is relative to the input's gain.
    """

    effect: str
    shape: tuple[float, ...] = ()
    sign: int = 0


# -- terms ---------------------------------------------------------------------------------------
# Written with abs and arithmetic where possible: the same line serves arrays and plain floats.

MOTION: Mapping[str, Callable[..., Any]] = {
    "linear_stiffness": lambda y, v: y,
    "leak": lambda y, v: y,
    "outflow": lambda y, v: (0.5 * (y + abs(y))) ** 0.5,
    "viscous_friction": lambda y, v: v,
    "quadratic_drag": lambda y, v: v * abs(v),
    "cubic_damping": lambda y, v: v * v * v,
    "quadratic_stiffness": lambda y, v: y * y,
    "cubic_stiffness": lambda y, v: y * y * y,
    "gravity": lambda y, v: np.sin(y),
    "position_ripple": lambda y, v, kappa, phase: np.sin(kappa * y + phase),
    "end_stop": lambda y, v, side, at: 0.5 * side * (side * y - at + abs(side * y - at)),
    "overflow": lambda y, v, at: 0.5 * (y - at + abs(y - at)),
    "free_play": lambda y, v, gap: 0.5 * (abs(y + gap) - abs(y - gap)),
}
DRY: Mapping[str, Callable[..., Any]] = {  # level of a friction that acts against sign(v)
    "coulomb_friction": lambda v: 1.0 + 0.0 * v,
    "stribeck_friction": lambda v, vs: np.exp(-((v / vs) ** 2)),
}
DRIVEN: Mapping[str, Callable[..., np.ndarray]] = {  # t: middle of each sample; u: held over it
    "input": lambda t, u: u,
    "constant_offset": lambda t, u: np.ones_like(t),
    "drift": lambda t, u: (t - t[0]) / (t[-1] - t[0]),
    "sinusoidal_disturbance": lambda t, u, w, phase: np.sin(w * t + phase),
    "input_clip": lambda t, u, level: np.clip(u, -level, level),
    "input_delay": lambda t, u, samples: _shifted(u, int(samples)) - u,
    "actuator_lag": lambda t, u, samples: _lag(u, samples) - u,
    "input_quadratic": lambda t, u, odd: u * (abs(u) if odd else u),
}


def _shifted(u: np.ndarray, samples: int) -> np.ndarray:
    return np.r_[np.full(samples, u[0]), u[:-samples]]


def _lag(u: np.ndarray, samples: float) -> np.ndarray:
    """First-order lag of the held input, its mean over each sample, from rest at u[0]."""
    pole = np.exp(-1.0 / samples)
    after = lfilter([1.0 - pole], [1.0, -pole], u, zi=np.array([pole * u[0]]))[0]
    before = np.r_[u[0], after[:-1]]
    return u + (before - after) * samples  # exact: the integral of an exponential


def _hysteresis(y: np.ndarray, shapes: Sequence[tuple[float, ...]]) -> np.ndarray:
    """Bouc-Wen states driven by the motion y, one column per shape (largest z, β share)."""
    largest, share = np.array(shapes).T
    z, states = np.zeros(len(largest)), np.empty((len(y), len(largest)))
    for k, step in enumerate(np.diff(y, prepend=y[0])):
        states[k] = z = bouc_wen(z, float(step), largest, share)
    return states


def bouc_wen(z: Any, step: float, largest: Any, share: Any) -> Any:
    """Exact step of ż = ẏ - β|ẏ|z - γẏ|z|, for y moving by `step` in one direction.

    β + γ = 1 / `largest`, β = `share` of it: along the motion z approaches ±`largest`.
    """
    direction = np.sign(step)
    along = direction * z
    rate = np.where(along >= 0, 1.0, 2.0 * share - 1.0 + 1e-9) / largest
    decay = np.exp(-rate * abs(step))
    return direction * (along * decay + (1.0 - decay) / rate) if direction else z


# -- signals -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Signals:
    """A record ready for the library: raw, smoothed, and thinned by `thin` where smooth is enough.

    `sigma`: standard deviation of the white noise in `raw`.
    """

    h: float
    time: np.ndarray
    u: np.ndarray
    raw: np.ndarray
    y: np.ndarray
    v: np.ndarray
    sigma: float
    thin: int


def signals(time: np.ndarray, inputs: np.ndarray, outputs: np.ndarray) -> Signals:
    """Smooth the output and differentiate it once, for the nonlinear terms only."""
    h = float(time[1] - time[0])
    raw = np.ravel(outputs)
    y, sigma = _smooth(raw)
    thin = max(1, len(raw) // 10_000)
    return Signals(h, time, np.ravel(inputs), raw, y, np.gradient(y, h), sigma, thin)


def _smooth(y: np.ndarray) -> tuple[np.ndarray, float]:
    """Wiener filter: each frequency weighted by its share of signal; white noise is assumed.

    Sine series about the line that joins the ends: its odd continuation is smooth.
    """
    ends = min(20, len(y) // 10)
    line = np.linspace(np.mean(y[:ends]), np.mean(y[-ends:]), len(y))
    series = np.asarray(fft.dst(y - line, type=1, norm="ortho"))
    power = series**2
    floor = float(np.median(power[len(power) // 2 :])) / 0.455  # median of χ² with one degree
    width = 31
    local = np.convolve(power, np.full(width, 1.0 / width), mode="same")
    weight = np.clip(1.0 - floor / np.maximum(local, 1e-300), 0.0, 1.0)
    last = np.flatnonzero(local > 3.0 * floor)[-1:]
    weight[int(last[0]) + 1 if len(last) else 1 :] = 0.0
    return line + np.asarray(fft.idst(weight * series, type=1, norm="ortho")), floor**0.5


# -- rows: the equation against bumps -------------------------------------------------------------


@dataclass(frozen=True)
class Rows:
    """The equation in rows: left-hand side y^(r), and what turns a signal into rows.

    `level` and `slope` are the rows of the output and of its rate, taken from the raw output;
    `held` acts on what is held over a sample, `thinned` on what is evaluated at every thin-th
    sample. `noise`: standard deviation of the left-hand side's noise.
    """

    left: np.ndarray
    level: np.ndarray
    slope: np.ndarray
    held: sparse.csr_array
    thinned: sparse.csr_array
    noise: float

    def take(self, which: np.ndarray) -> "Rows":
        """Some of the rows."""
        names = ("left", "level", "slope", "held", "thinned")
        return replace(self, **{name: getattr(self, name)[which] for name in names})


def weak_rows(s: Signals, order: int, half: int) -> Rows:
    """Bumps (1 - s²)^6 of half width `half` samples, one every half of that."""
    n, thin = len(s.raw), s.thin
    half = thin * max(1, round(half / thin))
    centres = np.arange(half, n - half - 1, thin * max(1, half // (2 * thin)))
    width = half * s.h

    def shape(derivative: int, every: int, shift: float) -> tuple[np.ndarray, np.ndarray]:
        offset = np.arange(-half, half + 1, every)
        bump = np.polynomial.Polynomial([1.0, 0.0, -1.0]) ** 6
        position = (offset + shift) / half
        value = np.where(abs(position) < 1.0, bump.deriv(derivative)(position), 0.0)
        return offset, value * (every * s.h / width ** (derivative + 1))

    def weights(derivative: int, every: int, shift: float) -> sparse.csr_array:
        offset, value = shape(derivative, every, shift)
        columns = (centres[:, None] + offset) // every
        start = np.arange(0, columns.size + 1, len(offset))
        data = np.tile(value, len(centres)), columns.ravel(), start
        return sparse.csr_array(data, shape=(len(centres), -(-n // every)))

    return Rows(
        left=np.asarray(weights(order, 1, 0.0) @ s.raw) * (-1.0) ** order,
        level=weights(0, 1, 0.0) @ s.raw,
        slope=-(weights(1, 1, 0.0) @ s.raw),
        held=weights(0, 1, 0.5),
        thinned=weights(0, thin, 0.0),
        noise=s.sigma * float(np.linalg.norm(shape(order, 1, 0.0)[1])),
    )


def derivative_rows(s: Signals, order: int, half: int) -> Rows:
    """The usual way: PySINDy's smoothed finite differences, at thinned instants."""
    import pysindy  # pyright: ignore[reportMissingImports]  (an extra: benchmarks)

    n, thin = len(s.raw), s.thin
    centres = np.arange(thin * (half // thin), n - half, thin * max(1, half // (4 * thin)))
    savitzky = {"window_length": 2 * (half // 2) + 1, "polyorder": 3}
    differentiate = pysindy.SmoothedFiniteDifference(smoother_kws=savitzky)
    step: Any = s.h  # a number is documented, its annotation is wrong
    slope = differentiate(s.raw[:, None], step)
    highest = slope if order == 1 else differentiate(slope, step)
    return Rows(
        left=np.asarray(highest)[centres, 0],
        level=s.y[centres],
        slope=np.asarray(slope)[centres, 0],
        held=_pick(centres, n),
        thinned=_pick(centres // thin, -(-n // thin)),
        noise=0.0,
    )


def _pick(indices: np.ndarray, size: int) -> sparse.csr_array:
    ones = np.ones(len(indices)), indices, np.arange(len(indices) + 1)
    return sparse.csr_array(ones, shape=(len(indices), size))


def columns(terms: Sequence[Term], s: Signals, rows: Rows) -> np.ndarray:
    """The terms as columns, (rows, terms)."""
    y, v = s.y[:: s.thin], s.v[:: s.thin]
    middle = s.time + 0.5 * s.h
    out = np.empty((len(rows.left), len(terms)))
    moving, driven, memory = {}, {}, {}
    for j, term in enumerate(terms):
        if term.effect in ("linear_stiffness", "leak"):
            out[:, j] = rows.level
        elif term.effect == "viscous_friction":
            out[:, j] = rows.slope
        elif term.effect in MOTION:
            moving[j] = MOTION[term.effect](y, v, *term.shape)
        elif term.effect in DRY:
            moving[j] = DRY[term.effect](v, *term.shape) * np.sign(v)
        elif term.effect == "hysteresis":
            memory[j] = term.shape
        else:
            driven[j] = DRIVEN[term.effect](middle, s.u, *term.shape)
    if memory:
        every = max(1, len(y) // 5000)  # the state is smooth: a Python loop over fewer steps
        states = _hysteresis(y[::every], list(memory.values()))
        at = np.arange(len(y)) / every
        for j, z in zip(memory, states.T, strict=True):
            moving[j] = np.interp(at, np.arange(len(z)), z)
    for group, weight in ((moving, rows.thinned), (driven, rows.held)):
        if group:
            out[:, list(group)] = weight @ np.array(list(group.values())).T
    return out


# -- the library -----------------------------------------------------------------------------------


def declared_terms(declared: str) -> tuple[Term, ...]:
    """The terms of the declared model."""
    return tuple(Term(effect) for effect in DECLARED[declared])


def library(declared: str, s: Signals) -> list[Term]:
    """Every effect that fits the plant, on grids of its shapes taken from the record's range."""
    n = len(s.u)
    terms = [Term("constant_offset"), Term("drift")]
    terms += [Term("input_quadratic", (float(odd),)) for odd in (True, False)]
    largest = float(np.max(np.abs(s.u)))
    terms += [Term("input_clip", (largest * share,)) for share in CLIPS]
    unit = n / 30_000
    delays = {
        max(1, round(unit * d)) for d in (2, 3, 4, 5, 7, 9, 12, 15, 19, 24, 30, 37, 45, 55, 70)
    }
    terms += [Term("input_delay", (float(d),), 1) for d in sorted(delays)]
    lags = (3, 5, 7, 10, 14, 20, 28, 40, 56, 80, 110, 160)
    terms += [Term("actuator_lag", (unit * lag,), 1) for lag in lags]
    levels = np.quantile(s.y, np.array(STOPS))
    if declared == "tank":
        terms += [Term("leak", (), -1)]
        return terms + [Term("overflow", (float(level),), -1) for level in levels]
    terms += _mechanical(s, levels)
    known = DECLARED[declared]
    return [term for term in terms if term.effect not in known]


def _mechanical(s: Signals, levels: np.ndarray) -> list[Term]:
    """What acts on a position and its velocity."""
    reach, speed = float(np.max(np.abs(s.y))), float(np.std(s.v))
    names = ("linear_stiffness", "viscous_friction", "coulomb_friction", "quadratic_drag")
    terms = [Term(name, (), -1) for name in (*names, "cubic_damping", "gravity")]
    terms += [Term("quadratic_stiffness"), Term("cubic_stiffness")]
    terms += [Term("stribeck_friction", (speed * r,), -1) for r in (0.04, 0.08, 0.14, 0.22, 0.35)]
    terms += [Term("free_play", (reach * r,), 1) for r in np.geomspace(0.06, 0.63, 12)]
    terms += [Term("end_stop", (1.0, float(level)), -1) for level in levels]
    lower = -np.quantile(s.y, 1.0 - np.array(STOPS))
    terms += [Term("end_stop", (-1.0, float(level)), -1) for level in lower]
    shapes = [(reach * r, b) for r in (0.04, 0.1, 0.22, 0.5, 1.1) for b in (0.55, 0.85)]
    terms += [Term("hysteresis", shape, -1) for shape in shapes]
    base = 2.0 * np.pi / float(np.ptp(s.y))
    waves = [(base * m, p) for m in np.arange(2.6, 18.0, 0.3) for p in (0.0, 0.5 * np.pi)]
    return terms + [Term("position_ripple", wave) for wave in waves]


def sinusoids(left: np.ndarray, known: np.ndarray, s: Signals, rows: Rows) -> list[Term]:
    """Sine and cosine at the frequencies of a grid where what `known` leaves of `left` peaks."""
    span = float(s.time[-1] - s.time[0])
    centre = (rows.held @ (s.time + 0.5 * s.h)) / (rows.held @ np.ones(len(s.time)))
    spacing = float(np.median(np.diff(centre)))
    grid = np.arange(1.3, 0.5 * span / spacing, 0.3) * 2.0 * np.pi / span
    wave = np.exp(1j * np.outer(centre, grid))
    basis = np.linalg.qr(known / np.linalg.norm(known, axis=0))[0]
    wave -= basis @ (basis.T @ wave)
    power = abs((left - basis @ (basis.T @ left)) @ wave) ** 2 / np.sum(abs(wave) ** 2, axis=0)
    chosen, phases = sorted(np.argsort(power)[-6:]), (0.0, 0.5 * np.pi)
    return [Term("sinusoidal_disturbance", (float(grid[i]), p)) for i in chosen for p in phases]
