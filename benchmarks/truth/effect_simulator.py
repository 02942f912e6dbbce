"""Plants with hidden effects, many at a time, in plain NumPy: no code shared with the library.

A *lane* is one plant with one input; all lanes of a plant advance together in one Python loop.

    mechanics   y'' = -k y - a sin y - c v - f sign v + b u + effects       (k = 0 or a = 0)
    tank        y'  = -alpha sqrt(y) + b u + effects

The input is held between samples (or computed by a controller from the noisy sample). Each sample
takes two sub-steps of classical Runge-Kutta, or 2m. They are equal, except under an input delay:
there the sub-steps meet where the delayed input jumps, so that no step has a jump inside.

Dry friction. A step keeps the sign of the velocity it began with. If the velocity passes zero, the
step is cut there: velocity becomes exactly zero, and the plant sticks if the other forces are below
the level of the friction, or leaves in their direction. A stuck plant does not creep; if its force
passes the level inside a step, it leaves there. No event search: the cut comes from the parabola
through the step's velocity (the line through its force), one formula for all lanes, and the
remainder is a midpoint step. These err by the third power of the step.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

Array = np.ndarray
Parameters = Mapping[str, float | Array]

# Rows of the state: output, its rate, lagged input, Bouc-Wen, hidden oscillator and its rate.
Y, V, LAG, BOUC_WEN, PARTNER, PARTNER_RATE = range(6)


@dataclass
class Point:
    """What the effects depend on: output, its rate, input, time, sign of the motion."""

    y: Array
    v: Array
    u: Array
    t: Array
    side: Array


# What an effect adds to y^(r). x.u is the input before any effect.
FORCES: dict[str, Callable[[Any, Parameters], Array]] = {
    "viscous_friction": lambda x, p: -p["c"] * x.v,
    "quadratic_drag": lambda x, p: -p["c"] * x.v * np.abs(x.v),
    "cubic_damping": lambda x, p: -p["c"] * x.v * x.v * x.v,
    "linear_stiffness": lambda x, p: -p["k"] * x.y,
    "quadratic_stiffness": lambda x, p: -p["k"] * x.y * x.y,
    "cubic_stiffness": lambda x, p: -p["k"] * x.y * x.y * x.y,
    "gravity": lambda x, p: -p["g"] * np.sin(x.y),
    "position_ripple": lambda x, p: p["a"] * np.sin(p["kappa"] * x.y + p["phi"]),
    # side = 1: above s; side = -1: below s.
    "end_stop": lambda x, p: -p["k"] * p["side"] * np.maximum(p["side"] * (x.y - p["s"]), 0),
    "free_play": lambda x, p: p["k"] * np.minimum(np.maximum(x.y, -p["g"]), p["g"]),
    "constant_offset": lambda x, p: p["offset"] + 0 * x.t,
    "drift": lambda x, p: p["slope"] * x.t,
    "sinusoidal_disturbance": lambda x, p: p["a"] * np.sin(p["w"] * x.t + p["phi"]),
    "leak": lambda x, p: -p["k"] * x.y,
    "overflow": lambda x, p: -p["k"] * np.maximum(x.y - p["level"], 0),
    "outside:van_der_pol": lambda x, p: -p["c"] * x.v * x.y * x.y,
    "outside:parametric_stiffness": lambda x, p: -p["k"] * x.y * np.cos(p["w"] * x.t),
    "outside:input_times_position": lambda x, p: p["q"] * x.u * x.y,
    "outside:input_times_velocity": lambda x, p: p["q"] * x.u * x.v,
    "outside:varying_input_gain": lambda x, p: p["q"] * x.u * np.sin(p["w"] * x.t + p["phi"]),
}
# Level of dry friction, not negative; it acts against the motion, whose sign is x.side.
DRY: dict[str, Callable[[Any, Parameters], Array]] = {
    "coulomb_friction": lambda x, p: p["c"] + 0 * x.v,
    "asymmetric_friction": lambda x, p: np.where(x.side > 0, p["c_plus"], p["c_minus"]),
    "stribeck_friction": lambda x, p: (
        p["fc"] + (p["fs"] - p["fc"]) * np.exp(-((x.v / p["vs"]) ** 2))
    ),
    "outside:position_friction": lambda x, p: p["c"] * x.y * x.y,
}
# What the plant gets instead of u.
INPUTS: dict[str, Callable[[Array, Parameters], Array]] = {
    "input_dead_zone": lambda u, p: np.sign(u) * np.maximum(np.abs(u) - p["g"], 0),
    "input_saturation": lambda u, p: np.clip(u, -p["level"], p["level"]),
    "input_quadratic": lambda u, p: u + p["q"] * u * np.where(p["odd"] > 0, np.abs(u), u),
}
# Signals that the caller hands in, times a gain.
SIGNALS = ("outside:coloured_disturbance", "outside:random_shocks")
# Effects with a memory; the simulator knows them.
MEMORY = ("input_delay", "actuator_lag", "hysteresis", "outside:second_resonance")


@dataclass(frozen=True)
class Lanes:
    """A batch of plants with their inputs; n samples, L lanes.

    Attributes:
        tank: relative degree 1 with an outflow alpha sqrt(y); else 2.
        base: {"stiffness", "gravity", "damping", "dry", "outflow", "gain": (L,)}; zero if absent.
        effects: for each lane {name: {parameter: value}}.
        drive: input, or the controller's reference where it has a gain, (n, L).
        noise: what the sensor adds, (n, L).
        signal: disturbance as acceleration (or flow), held between samples, (n, L).
        control: {"kp", "ki", "kd", "tf", "bias": (L,)}; bias is also the input before the record.
        start: output at the first sample, (L,); at rest.
        lowest: lower limit of what a controller may apply.
        period: sample period [s].
    """

    tank: bool
    base: dict[str, Array]
    effects: tuple[dict[str, dict[str, float]], ...]
    drive: Array
    noise: Array
    signal: Array
    control: dict[str, Array]
    start: Array
    lowest: float
    period: float

    def decimated(self, stride: int) -> "Lanes":
        """The same at every `stride`-th sample."""
        cut = {key: getattr(self, key)[::stride] for key in ("drive", "noise", "signal")}
        return replace(self, **cut, period=self.period * stride)


@dataclass(frozen=True)
class History:
    """What a simulation leaves: y and u at each sample, (n, L); state and y^(r) at some."""

    y: Array
    u: Array
    states: Array  # (n / stride, 6, L)
    highest: Array  # y^(r), (n / stride, L)


def simulate(lanes: Lanes, *, halves: int = 1, stride: int = 1) -> History:
    """All lanes over time.

    Args:
        lanes: what to simulate.
        halves: Runge-Kutta steps in each of the two parts of a sample.
        stride: keep the whole state at every `stride`-th sample.

    Returns:
        The trajectories. A lane that diverges holds NaN or inf.
    """
    model = _Model(lanes)
    n, count = lanes.drive.shape
    kept = -(-n // stride)
    out = History(
        np.empty((n, count)), np.empty((n, count)),
        np.empty((kept, 6, count)), np.empty((kept, count)),
    )  # fmt: skip
    x = np.zeros((6, count))
    x[Y], x[PARTNER], x[LAG] = lanes.start, lanes.start, lanes.control["bias"]
    controller = _Controller(lanes)
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(n):
            out.y[k] = x[Y]
            out.u[k] = controller.input(k, x[Y])
            model.hold(k, out.u)
            if k % stride == 0:
                out.states[k // stride] = x
                out.highest[k // stride] = model.highest(x, k * lanes.period)
            x = model.sample(x, k * lanes.period, halves)
    return out


class _View:
    """A point as some of the lanes see it; takes out of it only what is asked for."""

    def __init__(self, point: Point, lanes: Array | slice):
        self.point, self.lanes = point, lanes

    @property
    def y(self) -> Array:
        return self.point.y[self.lanes]

    @property
    def v(self) -> Array:
        return self.point.v[self.lanes]

    @property
    def u(self) -> Array:
        return self.point.u[self.lanes]

    @property
    def t(self) -> Array:
        return self.point.t[self.lanes]

    @property
    def side(self) -> Array:
        return self.point.side[self.lanes]


class _Controller:
    """PID on the noisy output with a filtered rate; passes the drive on where its gains are zero.

    The rate comes through a first-order filter, for a difference of noisy samples is only noise.
    """

    def __init__(self, lanes: Lanes):
        self.lanes, self.gains = lanes, lanes.control
        self.closed = (lanes.control["kp"] != 0).astype(float)
        self.smooth, self.integral = lanes.start.copy(), np.zeros_like(lanes.start)

    def input(self, k: int, y: Array) -> Array:
        drive, c, period = self.lanes.drive[k], self.gains, self.lanes.period
        if not self.closed.any():
            return drive
        seen = y + self.lanes.noise[k]
        error = self.closed * (drive - seen)
        rate = (seen - self.smooth) / c["tf"]
        self.smooth += -np.expm1(-period / c["tf"]) * (seen - self.smooth)
        u = c["kp"] * error + c["ki"] * self.integral - c["kd"] * rate + self.closed * c["bias"]
        u += (1 - self.closed) * drive
        limited = np.maximum(u, self.lanes.lowest)
        self.integral += np.where(limited == u, period * error, 0.0)  # no wind-up at the limit
        return limited


class _Model:
    """Right-hand side of all lanes, and one sample of it."""

    def __init__(self, lanes: Lanes):
        self.lanes, self.period = lanes, lanes.period
        self.base = lanes.base
        zero = np.zeros_like(lanes.start)
        self.point = Point(zero, zero, zero, zero, zero)
        self.forces, self.dry = (
            [(i, f, _View(self.point, i), p) for i, f, p in _gather(table, lanes.effects)]
            for table in (FORCES, DRY)
        )
        self.inputs = _gather(INPUTS, lanes.effects)
        self.memory = {
            name: (i, p) for i, name, p in _gather(dict.fromkeys(MEMORY), lanes.effects, name=True)
        }
        self.noisy = _gather(dict.fromkeys(SIGNALS), lanes.effects, name=True)
        rubs = lanes.base["dry"] > 0  # a fresh array
        for i, *_ in self.dry:
            rubs[i] = True
        self.rubs, self.any_dry = rubs, bool(rubs.any())
        self.swings = bool(lanes.base["gravity"].any())
        count = len(lanes.start)
        share = np.full(count, 0.5)  # of the sample, where its two parts meet
        self.delay = np.zeros(count, int)
        if "input_delay" in self.memory:
            i, p = self.memory["input_delay"]
            whole = p["tau"] / self.period
            self.delay[i], share[i] = np.floor(whole), whole - np.floor(whole)
            self.late = np.arange(count)[i]
        self.parts = (share * self.period, (1 - share) * self.period)
        self.side = np.zeros(count)

    def hold(self, k: int, u: Array) -> None:
        """Inputs in the two parts of sample k, and the disturbance."""
        self.u = u[k]
        first = second = u[k]
        if "input_delay" in self.memory:
            i = self.late
            first, second = first.copy(), second.copy()
            for part, more in ((first, 1), (second, 0)):
                past = k - self.delay[i] - more
                before = self.lanes.control["bias"][i]
                part[i] = np.where(past >= 0, u[np.maximum(past, 0), i], before)
        self.applied = tuple(self._through(part) for part in (first, second))
        self.push = np.zeros(len(self.side))
        for i, _, p in self.noisy:
            self.push[i] += p["gain"] * self.lanes.signal[k, i]

    def _through(self, u: Array) -> Array:
        for i, effect, p in self.inputs:
            u = u.copy()
            u[i] = effect(u[i], p)
        return u

    def highest(self, x: Array, t: float) -> Array:
        """y^(r) now."""
        now = np.full(x.shape[1], t)
        if self.any_dry:
            self._decide(x, self.applied[0], now)
        return self._rate(x, self.applied[0], now)[Y if self.lanes.tank else V]

    def sample(self, x: Array, t: float, halves: int) -> Array:
        """State one sample later."""
        begin = np.full(x.shape[1], t)
        for length, u in zip(self.parts, self.applied, strict=True):
            h = length / halves
            for _ in range(halves):
                x = self._step(x, u, begin, h)
                begin = begin + h
        return x

    def _step(self, x: Array, u: Array, t: Array, h: Array) -> Array:
        if self.any_dry:
            self._decide(x, u, t)
        half = 0.5 * h
        r1 = self._rate(x, u, t)
        r2 = self._rate(x + half * r1, u, t + half)
        r3 = self._rate(x + half * r2, u, t + half)
        r4 = self._rate(x + h * r3, u, t + h)
        new = x + (h / 6) * (r1 + 2 * (r2 + r3) + r4)
        if self.any_dry:
            turned = self.rubs & (self.side * new[V] < 0)
            if turned.any():
                self._turn(x, new, r1, u, t, h, np.flatnonzero(turned))
            stuck = self.rubs & (x[V] == 0) & (self.side == 0)
            if stuck.any():
                self._release(x, new, u, t, h, stuck)
        return new

    def _turn(
        self, x: Array, new: Array, rate: Array, u: Array, t: Array, h: Array, i: Array
    ) -> None:
        """Cut the step of lanes `i` where their velocity is zero, and go on from there."""
        v, slope = x[V, i], h[i] * rate[V, i]
        bend = new[V, i] - v - slope
        root = np.sqrt(np.maximum(slope * slope - 4 * bend * v, 0))
        # Smallest positive root of v + slope s + bend s^2, for either sign of v.
        below = -slope + self.side[i] * root
        s = np.clip(np.where(below != 0, 2 * v / np.where(below != 0, below, 1), 0), 0, 1)
        at = x.copy()
        change = h[i] * rate[:, i]
        at[:, i] += s * change + s * s * (new[:, i] - x[:, i] - change)
        at[Y, i] = x[Y, i] + h[i] * s * (v + s * (slope / 2 + s * bend / 3))
        at[V, i] = 0.0
        now = t.copy()
        now[i] += s * h[i]
        side = self.side.copy()
        side[i] = self._ways(at, u, now)[i]
        self._finish(at, new, u, now, (1 - s) * h[i], i, side)

    def _release(self, x: Array, new: Array, u: Array, t: Array, h: Array, stuck: Array) -> None:
        """Stuck lanes whose force has passed the level inside the step leave where it did."""
        before, after = self._force(x, u, t), self._force(new, u, t + h)
        way = np.sign(after)
        level = self._level(new, way)
        i = np.flatnonzero(stuck & (np.abs(after) > level))
        if not i.size:
            return
        first, last = (way * before)[i], (way * after)[i]
        s = np.clip((level[i] - first) / (last - first), 0, 1)
        at, now, side = x.copy(), t.copy(), self.side.copy()
        at[:, i] += s * (new[:, i] - x[:, i])
        now[i] += s * h[i]
        side[i] = way[i]
        self._finish(at, new, u, now, (1 - s) * h[i], i, side)

    def _finish(
        self, at: Array, new: Array, u: Array, now: Array, left: Array, i: Array, side: Array
    ) -> None:
        """From `at` to the end of the step, the time `left` later, on lanes `i`: midpoint."""
        keep, self.side = self.side, side
        rest = np.zeros_like(now)
        rest[i] = left
        middle = at + 0.5 * rest * self._rate(at, u, now)
        end = at + rest * self._rate(middle, u, now + 0.5 * rest)
        end[V] = np.where(side * end[V] < 0, 0.0, end[V])
        new[:, i] = end[:, i]
        self.side = keep

    def _force(self, x: Array, u: Array, t: Array) -> Array:
        return self._rate(x, u, t, free=True)[V]

    def _ways(self, x: Array, u: Array, t: Array) -> Array:
        """Where plants at rest go: -1 or 1, or 0 if friction holds them."""
        force = self._force(x, u, t)
        way = np.sign(force)
        return np.where(np.abs(force) > self._level(x, way), way, 0.0)

    def _decide(self, x: Array, u: Array, t: Array) -> None:
        """Side of every lane's motion at the beginning of a step."""
        still = self.rubs & (x[V] == 0)
        self.side = np.sign(x[V])
        if still.any():
            self.side = np.where(still, self._ways(x, u, t), self.side)

    def _level(self, x: Array, side: Array) -> Array:
        level = self.base["dry"].copy()
        self.point.y, self.point.v, self.point.side = x[Y], x[V], side
        for i, effect, view, p in self.dry:
            level[i] += effect(view, p)
        return level

    def _rate(self, x: Array, u: Array, t: Array, free: bool = False) -> Array:
        """dx/dt; `free` leaves dry friction out."""
        rate = np.zeros_like(x)
        y, v = x[Y], x[V]
        if "actuator_lag" in self.memory:
            i, p = self.memory["actuator_lag"]
            rate[LAG, i] = (u[i] - x[LAG, i]) / p["time"]
            u = u.copy()
            u[i] = x[LAG, i]
        force = self.base["gain"] * u + self.push
        if self.lanes.tank:
            force -= self.base["outflow"] * np.sqrt(np.maximum(y, 0))
        else:
            force -= self.base["stiffness"] * y + self.base["damping"] * v
        if self.swings:
            force -= self.base["gravity"] * np.sin(y)
        point = self.point
        point.y, point.v, point.u, point.t = y, v, self.u, t
        for i, effect, view, p in self.forces:
            force[i] += effect(view, p)
        self._remember(x, rate, force)
        if self.lanes.tank:
            rate[Y] = force
            return rate
        if self.any_dry and not free:
            force -= self.side * self._level(x, self.side)
            force[self.rubs & (self.side == 0)] = 0.0
        rate[Y], rate[V] = v, force
        return rate

    def _remember(self, x: Array, rate: Array, force: Array) -> None:
        """Internal states: hysteresis, and a hidden oscillator hung on the mass."""
        if "hysteresis" in self.memory:
            i, p = self.memory["hysteresis"]
            z, v = x[BOUC_WEN, i], x[V, i]
            rate[BOUC_WEN, i] = p["A"] * v - p["beta"] * np.abs(v) * z - p["gamma"] * v * np.abs(z)
            force[i] -= p["k"] * z
        if "outside:second_resonance" in self.memory:
            i, p = self.memory["outside:second_resonance"]
            apart, w = x[PARTNER, i] - x[Y, i], p["w"]
            rate[PARTNER, i] = x[PARTNER_RATE, i]
            rate[PARTNER_RATE, i] = -w * w * apart - 2 * p["zeta"] * w * x[PARTNER_RATE, i]
            force[i] += p["k"] * apart


def _gather(
    table: Mapping[str, object], effects: Sequence[Mapping[str, Mapping[str, float]]],
    name: bool = False,
) -> list:  # fmt: skip
    """(lanes, function or name, parameters as arrays) of every effect of `table` in use."""
    found = []
    for key, function in table.items():
        lanes = [lane for lane, present in enumerate(effects) if key in present]
        if not lanes:
            continue
        keys = effects[lanes[0]][key]
        values = {p: np.array([effects[lane][key][p] for lane in lanes]) for p in keys}
        whole = len(lanes) == lanes[-1] - lanes[0] + 1
        index = slice(lanes[0], lanes[-1] + 1) if whole else np.array(lanes)
        found.append((index, key if name else function, values))
    return found
