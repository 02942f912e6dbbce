"""Closed loops by SciPy: a linear plant, stepped exactly, under a digital controller.

Shares no code with the library. `double` is y'' = a y - b y' + c (u + v): unstable for a > 0; v is
a second input that no controller drives.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

import eoi_jax as eoi

PERIOD = 0.01
TRUTH = {"a": 25.0, "b": 1.0, "c": 4.0}
WRONG = {"a": 20.0, "b": 0.6, "c": 5.0}
GAINS = {"proportional": 18.0, "integral": 10.0, "derivative": 3.0, "filter_time": 0.03}


def double(inputs=("current",), **values):
    def second_order(t, x, u, p):
        return p.a * x.y[0] - p.b * x.y[1] + p.c * sum(u[i] for i in range(len(inputs)))

    return eoi.Plant(second_order, {**TRUTH, **values}, relative_degree=2, inputs=inputs,
                     outputs=("position",), units={"position": "m", "current": "A"})  # fmt: skip


def controller(**changes):
    return eoi.Controller.pid(**{**GAINS, "period": PERIOD, **changes})


@dataclass
class Pid:
    """The controller of the simulation, step by step."""

    proportional: float = 18.0
    integral: float = 10.0
    derivative: float = 3.0
    filter_time: float = 0.03
    limit: float = np.inf
    total: float = 0.0
    before: float = 0.0
    slope: float = 0.0

    def __call__(self, error):
        change = (error - self.before) / (self.filter_time + PERIOD)
        self.slope = self.filter_time / (self.filter_time + PERIOD) * self.slope + change
        self.before = error
        u = self.proportional * error + self.derivative * self.slope + self.integral * self.total
        beyond = np.sign(u) * (abs(u) > self.limit)
        if beyond * self.integral * error <= 0:
            self.total += PERIOD * error
        return float(np.clip(u, -self.limit, self.limit))


def steps(seed, count, high=1.0, length=60):
    rng = np.random.default_rng(seed)
    return np.repeat(rng.uniform(-high, high, -(-count // length)), length)[:count]


def measured(seed=1, count=1500, noise=0.0, delay=0, law=None, push=0.0, dither=None, **values):
    """A record with the inputs current (and push, where it acts) and r, and the start x(0) = 0."""
    p = {**TRUTH, **values}
    rng = np.random.default_rng([seed, 1])
    law = Pid() if law is None else law
    r, v = steps(seed, count), push * steps([seed, 2], count, length=37)
    dither = np.zeros(count) if dither is None else dither
    system = np.array([[0.0, 1.0, 0.0], [p["a"], -p["b"], p["c"]], [0.0, 0.0, 0.0]])
    transition, x = expm(system * PERIOD), np.zeros(2)
    u, y, waiting = np.empty(count), np.empty(count), [0.0] * delay
    for k in range(count):
        y[k] = x[0] + noise * rng.standard_normal()
        waiting.append(law(r[k] - y[k]) + dither[k])
        u[k] = waiting.pop(0)
        x = (transition @ [*x, u[k] + v[k]])[:2]
    columns = [u, v, r] if push else [u, r]
    names = ("current", "push", "r") if push else ("current", "r")
    return eoi.Record(PERIOD * np.arange(count), np.stack(columns, 1), y, f"run {seed}",
                      hold="zero", input_names=names, output_names=("position",),
                      units={"current": "A", "position": "m"})  # fmt: skip
