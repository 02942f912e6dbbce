"""Rigs of other kinds than the three of `undeclared_effects`, each lacking something once.

    python benchmarks/truth/other_rigs.py [--quick] [--write]

Every rig is a few lines of plain Python below, stepped by a Runge-Kutta rule of its own. All were
written down before the library was tried on them. At 30a864d it missed the motor, the heater
and the shock absorber, which was mended. For what the last three of these lack it had no name; it
has now. So it was, at 3ab58dc, with seven of the nine of `driven_rigs`, whose laws were added then.
"""

import math
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks.common import Report, arguments, table

NOISE = 1e-3  # of the rms of each output about its mean
SEEDS = (5, 6)  # of the record that is fitted, and of the held-out one
SUBSTEPS = 10
Signal = Callable[[np.ndarray, np.random.Generator], np.ndarray]
Rate = Callable[[Sequence[float], float], Sequence[float]]


@dataclass(frozen=True)
class Rig:
    """One rig.

    Attributes:
        name: what it is.
        hidden: what the declared model lacks, in words.
        effects: names that are right, equivalent ones in one entry by "|"; () where the library has
            none.
        model: the declared one.
        rate: dx/dt of the true one.
        start: its state.
        step: sample period [s].
        samples: of each record.
        drive: the input, or the reference of `control`.
        control: input from the reference and the state.
        delay: of the input [samples].
    """

    name: str
    hidden: str
    effects: tuple[str, ...]
    model: eoi.Plant
    rate: Rate
    start: tuple[float, ...]
    step: float
    samples: int
    drive: Signal
    control: Callable[[float, Sequence[float]], float] | None = None
    delay: int = 0


def record(rig: Rig, seed: int, samples: int) -> eoi.Record:
    """Simulated, with noise on the outputs."""
    draw = np.random.default_rng(seed)
    grid, inputs, outputs = noiseless(rig, draw, samples)
    noise = NOISE * np.std(outputs, axis=0) * draw.standard_normal(outputs.shape)
    return eoi.Record(grid, inputs, outputs + noise, f"seed {seed}", hold="zero")


def noiseless(rig: Rig, draw: np.random.Generator, samples: int) -> tuple[np.ndarray, ...]:
    """Time, inputs and outputs of a rig, simulated with inputs held over each sample."""
    grid = rig.step * np.arange(samples)
    wanted, h = rig.drive(grid, draw).tolist(), rig.step / SUBSTEPS
    x, states, inputs = list(rig.start), [], [0.0] * rig.delay
    for k, reference in enumerate(wanted):
        states.append(x)
        inputs.append(reference if rig.control is None else rig.control(reference, x))
        for _ in range(SUBSTEPS):
            x = _runge_kutta(rig.rate, x, inputs[k], h)
    outputs = np.asarray(states)[:, : len(rig.model.outputs)]
    return grid, np.asarray(inputs[rig.delay :])[:, None], outputs


def _runge_kutta(f: Rate, x: list[float], u: float, h: float) -> list[float]:
    def moved(slope: Sequence[float], by: float) -> list[float]:
        return [a + by * b for a, b in zip(x, slope, strict=True)]

    one = f(x, u)
    two = f(moved(one, 0.5 * h), u)
    three = f(moved(two, 0.5 * h), u)
    four = f(moved(three, h), u)
    mean = [(a + 2.0 * b + 2.0 * c + d) / 6.0
            for a, b, c, d in zip(one, two, three, four, strict=True)]  # fmt: skip
    return moved(mean, h)


def multisine(size: float, fastest: float, lines: int = 12) -> Signal:
    """Logarithmically spaced up to `fastest` [Hz], random phases."""

    def signal(grid: np.ndarray, draw: np.random.Generator) -> np.ndarray:
        cycles = np.unique(np.geomspace(1, fastest * grid[-1], lines).astype(int))
        phases = draw.uniform(0.0, 2.0 * np.pi, len(cycles))
        waves = np.cos(2.0 * np.pi * np.outer(grid / grid[-1], cycles) + phases)
        return size * np.sum(waves, axis=1) / np.sqrt(0.5 * len(cycles))

    return signal


def levels(high: float, each: int, low: float = 0.0) -> Signal:
    """Random levels from `low` to `high`, held for `each` samples."""

    def signal(grid: np.ndarray, draw: np.random.Generator) -> np.ndarray:
        return np.repeat(draw.uniform(low, high, -(-len(grid) // each)), each)[: len(grid)]

    return signal


# -- declared models --------------------------------------------------------------------------


def _spring(t: Any, x: Any, u: Any, p: Any) -> Any:
    del t
    return -p.k * x.y[0] - p.c * x.y[1] + p.b * u


def _first_order(t: Any, x: Any, u: Any, p: Any) -> Any:
    del t
    return p.gain * u - p.loss * x.y[0]


def _heated(t: Any, x: Any, u: Any, p: Any) -> Any:
    del t
    return p.gain * u - p.loss * (x.y[0] - p.ambient)


def _turning(t: Any, x: Any, u: Any, p: Any) -> Any:
    del t
    return p.gain * u - p.damping * x.y[1]


def _pushed(t: Any, x: Any, u: Any, p: Any) -> Any:
    del t, x
    return p.gain * u


def _lifted(t: Any, x: Any, u: Any, p: Any) -> Any:
    del t
    return p.gain * u - p.gravity * jnp.sin(x.y[0]) - p.damping * x.y[1]


def _drained(t: Any, x: Any, u: Any, p: Any) -> Any:
    del t
    return p.gain * u - p.outflow * jnp.sqrt(jnp.maximum(x.y[0], 1e-9))


def _levitated(t: Any, x: Any, u: Any, p: Any) -> Any:
    del t
    return p.a * x.y[0] + p.b * u - p.c * x.y[1]


def _coupled(t: Any, x: Any, u: Any, p: Any) -> Any:
    del t
    (one, two), (v1, v2) = x.y
    force = p.k * (one - two) + p.d * (v1 - v2)
    return jnp.stack([p.b * u[0] - force - p.c1 * v1, p.mu * force - p.c2 * v2 - p.k2 * two])


def _crane(t: Any, x: Any, u: Any, p: Any) -> Any:
    del t
    (_, angle), (v, w) = x.y
    s, c = jnp.sin(angle), jnp.cos(angle)
    push, fall = u[0] - p.c * v + 0.12 * w**2 * s, -9.81 * s - p.d * w
    inertia = 0.4 * p.m - 0.12 * c * c
    return jnp.stack([(0.4 * push - 0.12 * c * fall) / inertia, (p.m * fall - c * push) / inertia])


def sprung(k: float, c: float, b: float) -> eoi.Plant:
    """A mass on a spring."""
    return eoi.Plant(_spring, {"k": k, "c": c, "b": b}, 2)


# -- the rigs ---------------------------------------------------------------------------------


def _gap(stretch: float) -> float:
    return math.copysign(max(abs(stretch) - 0.01, 0.0), stretch)


def _true_coupled(x: Sequence[float], u: float) -> Sequence[float]:
    one, two, v1, v2 = x
    force = 400.0 * _gap(one - two) + 2.0 * (v1 - v2)
    return v1, v2, u - force - v1, 2.0 * (force - 0.5 * v2 - 20.0 * two)


def _true_crane(x: Sequence[float], u: float) -> Sequence[float]:
    _, angle, v, w = x
    s, c = math.sin(angle), math.cos(angle)
    push = u - 2.0 * v - 1.2 * math.tanh(v / 0.003) + 0.12 * w * w * s
    fall, inertia = -9.81 * s - 0.05 * w, 0.52 - 0.12 * c * c
    return v, w, (0.4 * push - 0.12 * c * fall) / inertia, (1.3 * fall - c * push) / inertia


def rigs() -> list[Rig]:
    """All of them."""
    motor = eoi.Plant(_first_order, {"gain": 30.0, "loss": 2.5}, 1)
    heater = eoi.Plant(_first_order, {"gain": 0.03, "loss": 0.012}, 1)
    ball = eoi.Plant(_levitated, {"a": 45.0, "b": 6.0, "c": 0.7}, 2)
    pair = {"b": 1.2, "k": 350.0, "d": 1.5, "c1": 1.2, "mu": 2.2, "c2": 1.2, "k2": 45.0}
    return [
        Rig("motor with a tachometer", "Coulomb friction 8", ("coulomb_friction",), motor,
            lambda x, u: (40.0 * u - 2.0 * x[0] - 8.0 * math.tanh(x[0] / 0.02),),
            (0.0,), 2e-3, 8000, multisine(1.0, 5.0)),
        Rig("heater in a warm room", "power with the square of the voltage, and the room 0.2",
            ("input_quadratic", "constant_offset"), heater,
            lambda x, u: (0.01 * u + 0.018 * u * u - 0.01 * (x[0] - 20.0),),
            (20.0,), 0.5, 6000, levels(5.0, 100)),
        Rig("shock absorber", "damping 6 one way, 2 the other: slope 2",
            ("asymmetric_friction",), sprung(80.0, 3.0, 1.2),
            lambda x, u: (x[1], u - 100.0 * x[0] - (6.0 if x[1] > 0 else 2.0) * x[1]),
            (0.0, 0.0), 2e-3, 8000, multisine(20.0, 6.0)),
        Rig("amplifier", "saturation at 0.8", ("input_saturation",), sprung(80.0, 3.5, 40.0),
            lambda x, u: (x[1], 50.0 * max(-0.8, min(u, 0.8)) - 100.0 * x[0] - 3.0 * x[1]),
            (0.0, 0.0), 2e-3, 8000, multisine(1.0, 6.0)),
        Rig("valve and slide", "lag of 30 ms, Coulomb friction 3",
            ("actuator_lag", "coulomb_friction"), sprung(25.0, 2.0, 45.0),
            lambda x, u: (x[1], 40.0 * x[2] - 30.0 * x[0] - 1.5 * x[1]
                             - 3.0 * math.tanh(x[1] / 0.005), (u - x[2]) / 0.03),
            (0.0, 0.0, 0.0), 2e-3, 10000, multisine(1.0, 6.0)),
        Rig("machine with an unbalance", "8 sin(27.46 t + 0.6), weight -3",
            ("constant_offset", "sinusoidal_disturbance"), sprung(170.0, 5.0, 1.2),
            lambda x, u: (x[1], u - 200.0 * x[0] - 4.0 * x[1] - 3.0 + 8.0 * x[2],
                          27.46 * x[3], -27.46 * x[2]),
            (0.0, 0.0, math.sin(0.6), math.cos(0.6)), 2e-3, 8000, multisine(30.0, 8.0)),
        Rig("levitated ball, unstable, in closed loop", "delay of 12 ms", ("input_delay",), ball,
            lambda x, u: (x[1], 60.0 * x[0] + 5.0 * u - 0.5 * x[1]),
            (0.0, 0.0), 1e-3, 8000, multisine(0.3, 6.0, 10),
            lambda wanted, x: -30.0 * (x[0] - wanted) - 4.0 * x[1], 12),
        Rig("nothing hidden", "nothing", (), sprung(170.0, 5.0, 1.2),
            lambda x, u: (x[1], u - 200.0 * x[0] - 4.0 * x[1]),
            (0.0, 0.0), 2e-3, 8000, multisine(30.0, 8.0)),
        Rig("two masses", "play of ±0.01 in the spring between them", ("free_play",),
            eoi.Plant(_coupled, pair, 2, outputs=("one", "two")), _true_coupled,
            (0.0, 0.0, 0.0, 0.0), 1e-3, 10000, multisine(6.0, 10.0, 20)),
        Rig("crane", "Coulomb friction 1.2 of the trolley, through the inertia matrix",
            ("coulomb_friction",),
            eoi.Plant(_crane, {"c": 1.5, "m": 1.6, "d": 0.08}, 2, outputs=("trolley", "angle")),
            _true_crane, (0.0, 0.0, 0.0, 0.0), 2e-3, 10000, multisine(5.0, 3.0)),
        Rig("Van der Pol", "damping with the square of the displacement", ("displacement_damping",),
            sprung(3.0, 0.3, 1.2),
            lambda x, u: (x[1], u - 4.0 * x[0] - 0.6 * x[1] * (x[0] ** 2 - 1.0)),
            (0.5, 0.0), 5e-3, 8000, multisine(1.5, 3.0)),
    ]  # fmt: skip


def driven_rigs() -> list[Rig]:
    """Of inputs that act otherwise than by a gain, and of what stands in front of a derivative."""
    first = eoi.Plant(_first_order, {"gain": 1.0, "loss": 1.0}, 1)
    tank = eoi.Plant(_drained, {"gain": 1.0, "outflow": 0.8}, 1)
    both = levels(3.0, 25, -3.0)
    return [
        Rig("motor behind an open bridge", "damping 5 |u|", ("input_damping",),
            eoi.Plant(_first_order, {"gain": 300.0, "loss": 3.0}, 1),
            lambda x, u: (510.0 * u - 2.0 * x[0] - 5.0 * abs(u) * x[0],),
            (0.0,), 0.02, 1500, levels(1.0, 25, -1.0)),
        Rig("gear under load", "friction 0.3 |u|", ("load_friction",), sprung(8.0, 1.0, 1.5),
            lambda x, u: (x[1], 2.0 * u - 10.0 * x[0] - 0.8 * x[1]
                          - 0.3 * abs(u) * math.tanh(x[1] / 0.01)),
            (0.0, 0.0), 0.02, 2000, both),
        Rig("drive that limits its current", "at 1, back-EMF 0.5", ("current_limit",), first,
            lambda x, u: (3.0 * max(-1.0, min(u - 0.5 * x[0], 1.0)) - 0.3 * x[0],),
            (0.0,), 0.02, 1500, both),
        Rig("hydraulic valve", "supply 5", ("valve_flow",), first,
            lambda x, u: (0.7 * u * math.sqrt(max(5.0 - math.copysign(x[0], u * x[0]), 0.0))
                          - x[0],),
            (0.0,), 0.02, 1500, both),
        Rig("cone", "its section, exponent 2", ("varying_capacity",), tank,
            lambda x, u: ((u - 0.8 * math.sqrt(x[0])) / x[0] ** 2,),
            (1.0,), 0.1, 1500, levels(1.3, 40, 0.5)),
        Rig("linkage", "inertia 1 + 1.5 y²", ("varying_capacity",), sprung(15.0, 0.8, 3.0),
            lambda x, u: (x[1], (4.0 * u - 20.0 * x[0] - x[1]) / (1.0 + 1.5 * x[0] ** 2)),
            (0.0, 0.0), 0.02, 2500, levels(1.5, 25, -1.5)),
        Rig("oven that is slow to cool", "0.4 of the rate", ("rate_asymmetry",), first,
            lambda x, u: ((1.0 if 2.0 * u > x[0] else 0.4) * (2.0 * u - x[0]),),
            (0.0,), 0.1, 1500, levels(1.0, 50)),
        Rig("valve with a motor", "0.5 a second at most", ("rate_limit",), first,
            lambda x, u: (2.0 * x[1] - x[0], max(-0.5, min(400.0 * (u - x[1]), 0.5))),
            (0.0, 0.0), 0.05, 2000, levels(1.0, 60, -1.0)),
        Rig("valve that sticks", "0.3 of play", ("input_play",), first,
            lambda x, u: (2.0 * x[1] - x[0],
                          400.0 * (max(u - 0.15 - x[1], 0.0) + min(u + 0.15 - x[1], 0.0))),
            (0.0, 0.0), 0.05, 2000, levels(1.0, 60, -1.0)),
        Rig("bent sensor", "y = x + 0.25 x²", ("sensor_curve",), first,
            lambda x, u: (math.sqrt(1.0 + x[0])
                          * (u - 1.4 * x[0] / (1.0 + math.sqrt(1.0 + x[0]))),),
            (0.5,), 0.05, 1500, levels(2.0, 30)),
    ]  # fmt: skip


def vehicles() -> list[Rig]:
    """Of what moves far, pushed by propellers, rudders and valves; several effects at once."""
    cart = eoi.Plant(_pushed, {"gain": 1.0}, 2)
    arm = eoi.Plant(_lifted, {"gain": 10.0, "gravity": 9.0, "damping": 1.0}, 2)
    return [
        Rig("boat", "thrust 1.2 u |u|, drag 0.25 v |v|", ("input_square", "quadratic_drag"),
            eoi.Plant(_first_order, {"gain": 1.0, "loss": 0.3}, 1),
            lambda x, u: (1.2 * u * abs(u) - 0.05 * x[0] - 0.25 * x[0] * abs(x[0]),),
            (0.0,), 0.2, 1500, levels(1.0, 40, -1.0)),
        Rig("ship's heading", "damping 2 r³, an offset", ("cubic_damping", "constant_offset"),
            eoi.Plant(_turning, {"gain": 0.05, "damping": 0.1}, 2),
            lambda x, u: (x[1], 0.05 * u - 0.1 * x[1] - 2.0 * x[1] ** 3 + 0.002),
            (0.0, 0.0), 0.5, 2400, levels(0.5, 60, -0.5)),
        Rig("arm under a propeller", "thrust 30 u |u|, friction 0.3",
            ("input_square", "coulomb_friction"), arm,
            lambda x, u: (x[1], 30.0 * u * abs(u) - 8.0 * math.sin(x[0]) - 0.8 * x[1]
                          - 0.3 * math.tanh(x[1] / 0.01)),
            (0.3, 0.0), 0.01, 4000, levels(0.6, 200, 0.1)),
        Rig("cart on a slope, controlled", "friction 0.25 and 0.6 v, an offset",
            ("viscous_friction", "coulomb_friction", "constant_offset"), cart,
            lambda x, u: (x[1], 2.0 * u - 0.6 * x[1] - 0.25 * math.tanh(x[1] / 0.01) - 0.4),
            (0.0, 0.0), 0.01, 6000, levels(0.5, 300, -0.5),
            lambda reference, x: 8.0 * (reference - x[0]) - 5.0 * x[1]),
        Rig("cylinder behind a valve", "dead zone 0.12, 0.7 of the gain one way, lag 0.025 s",
            ("input_dead_zone", "input_asymmetry|rate_asymmetry", "sensor_lag|actuator_lag"),
            eoi.Plant(_pushed, {"gain": 0.4}, 1),
            lambda x, u: (x[1], 40.0 * (0.5 * math.copysign(max(abs(u) - 0.12, 0.0), u)
                                        * (0.7 if u < 0.0 else 1.0) - x[1])),
            (0.0, 0.0), 0.02, 1500, levels(1.0, 25, -1.0)),
    ]  # fmt: skip


def machines() -> list[Rig]:
    """With what stops, bends, glows and comes near its stroke."""
    furnace = eoi.Plant(_heated, {"gain": 5.0, "loss": 0.005, "ambient": 20.0}, 1, ("power",),
                        ("temperature",), units={"temperature": "°C"})  # fmt: skip

    def in_furnace(x: Sequence[float], u: float) -> Sequence[float]:
        glow = (0.01 * x[0] + 2.7315) ** 4 - 2.9815**4
        return (8.0 * u - 0.002 * (x[0] - 25.0) - 3e-4 * glow,)

    def in_drive(x: Sequence[float], u: float) -> Sequence[float]:
        twist = 900.0 * x[2] + 0.8 * (x[0] - x[1])
        return 10.0 * u - x[0] - twist, 0.6 * twist, x[0] - x[1]

    return [
        Rig("conveyor that stops", "Coulomb friction 1.5", ("coulomb_friction",),
            eoi.Plant(_first_order, {"gain": 1.0, "loss": 1.0}, 1, units={"y": "m/s"}),
            lambda x, u: (0.9 * u - 1.1 * x[0] - 1.5 * math.tanh(x[0] / 0.01),),
            (0.0,), 0.1, 1200, levels(7.0, 35, 0.0)),
        Rig("drive behind a converter", "dead zone 0.8, Coulomb friction 2",
            ("input_dead_zone", "coulomb_friction"),
            eoi.Plant(_turning, {"gain": 15.0, "damping": 5.0}, 2),
            lambda x, u: (x[1], 20.0 * math.copysign(max(abs(u) - 0.8, 0.0), u) - 8.0 * x[1]
                          - 2.0 * math.tanh(x[1] / 0.01)),
            (0.0, 0.0), 0.004, 5000, levels(6.0, 100, -6.0)),
        Rig("motor before an elastic shaft", "inertia 1.667 behind it, 23.24 rad/s",
            ("second_mass",),
            eoi.Plant(_first_order, {"gain": 5.0, "loss": 1.0}, 1, units={"y": "rad/s"}),
            in_drive, (0.0, 0.0, 0.0), 0.002, 6000, levels(5.0, 60, -5.0)),
        Rig("furnace", "radiation 3e-4 (T/100)⁴", ("radiation",), furnace,
            in_furnace, (25.0,), 5.0, 1500, levels(1.0, 150)),
        Rig("loudspeaker", "stiffness 4800 y³, 0.06 y² less force",
            ("cubic_stiffness", "product|parameter_dependence"),
            eoi.Plant(_spring, {"k": 5e4, "c": 100.0, "b": 300.0}, 2),
            lambda x, u: (x[1], 400.0 * u * (1.0 - 0.06 * x[0] ** 2) - 120.0 * x[1]
                          - 6e4 * x[0] * (1.0 + 0.08 * x[0] ** 2)),
            (0.0, 0.0), 2e-4, 8000, multisine(100.0, 80.0)),
        Rig("engine on rubber mounts", "a spring of 1500 1/s² with a damper in series, 12 1/s",
            ("maxwell_element",), eoi.Plant(_spring, {"k": 4e3, "c": 5.0, "b": 1.0}, 2),
            lambda x, u: (x[1], u - 3e3 * x[0] - 4.0 * x[1] - 1500.0 * x[2], x[1] - 12.0 * x[2]),
            (0.0, 0.0, 0.0), 1e-3, 8000, multisine(200.0, 15.0)),
    ]  # fmt: skip


def is_right(rig: Rig, found: eoi.Discovery) -> bool:
    """Whether what is hidden is named, by one of its names, and nothing else."""
    named = set(found.effects)
    alternatives = [set(names.split("|")) for names in rig.effects]
    return len(named) == len(alternatives) and all(named & names for names in alternatives)


def main() -> None:
    """One row a rig."""
    options = arguments(__doc__)
    warnings.simplefilter("ignore")
    report = Report("Other rigs")
    report.add(
        f"Noise {NOISE:g} of the rms of each output; records of seeds {SEEDS[0]} (fitted) and "
        f"{SEEDS[1]} (held out); whole library, nothing set. *Error*: rms of held-out free runs in "
        "windows of a tenth of a record over the standard deviation of the noise, the worst "
        "output. *Right*: what is hidden is named and nothing else, or nothing is where the "
        "library has no name. Times are of first calls, with compilation."
    )
    rows = []
    for rig in [*rigs(), *driven_rigs(), *vehicles(), *machines()][:: 4 if options.quick else 1]:
        fitted, held = (record(rig, seed, rig.samples) for seed in SEEDS)
        started = time.perf_counter()
        found = eoi.discover(rig.model, fitted, held)
        seconds = time.perf_counter() - started
        sigma = NOISE * np.std(held.outputs, axis=0)
        before, after = (np.max(one.rmse / sigma) if one else math.nan
                         for one in (found.windows_before, found.windows_after))  # fmt: skip
        values = ", ".join(f"{value:.4g}" for one in found.added
                           for value in one.parameters.values())  # fmt: skip
        named = ", ".join(found.effects) or found.status.code.replace("_", " ")
        right = is_right(rig, found)
        rows.append([rig.name, rig.hidden, f"{named}: {values}" if values else named,
                     "yes" if right else "**no**", f"{before:.3g} → {after:.3g}",
                     f"{seconds:.0f} s"])  # fmt: skip
    report.add(
        table(["rig", "what its model lacks", "named", "right", "error / noise", "time"], rows)
    )
    report.close(__file__, options.write)


if __name__ == "__main__":
    main()
