"""Five more public measured rigs with motors, fitted by hand before discovery saw them.

As `found_cases`; all are set aside: an arm with a propeller, a cart on a rail, a geared motor and
its relay, a wheel of a small robot, a ball on a beam that tilts.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp

import eoi_jax as eoi
from benchmarks.measured.campaign_cases import Rig
from benchmarks.measured.found_sets import FoundSet, Runs, records, runs, table


def rotor_pendulum(folder: Path) -> Rig:
    """An arm with a propeller: thrust in proportion to the duty, weight, viscous friction."""

    def arm(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.gain * u - p.weight * jnp.sin(jnp.deg2rad(x.y[0])) - p.damping * x.y[1]

    plant = eoi.Plant(
        arm, {"gain": 10.0, "weight": 400.0, "damping": 0.5}, relative_degree=2,
        inputs=("duty",), outputs=("angle",),
        units={"duty": "1", "angle": "deg", "gain": "deg/s²", "weight": "deg/s²",
               "damping": "1/s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("run_40", (0, 307)), ("run_48", (0, 175))),
        (("run_48", (175, 300)),),
        (("run_46", (0, 300)),),
    )
    return Rig(
        plant, runs(plant, folder / "rotor_pendulum", parts),
        {"angle": (3.36, 2.92)}, {"angle": (1.37, 1.21)},
        ("input_dead_zone|constant_offset|input_quadratic", "actuator_lag|input_delay"), "°",
        windows=2, remark="each run is one step; thrust falls in the last seconds",
    )  # fmt: skip


def _damped(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
    """Acceleration in proportion to the input, less viscous friction."""
    del t
    return p.gain * u - p.damping * x.y[1]


def rail_cart(folder: Path) -> Rig:
    """A cart on a rail, current reversed by a relay: force in proportion, viscous friction."""

    plant = eoi.Plant(
        _damped, {"gain": 400.0, "damping": 2.0}, relative_degree=2,
        inputs=("current",), outputs=("position",),
        units={"current": "A", "position": "mm", "gain": "mm/s²/A", "damping": "1/s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("at_030", (0, 300)), ("at_051", (0, 150))),
        (("at_030", (300, 442)),),
        (("at_051", (150, 433)),),
    )
    return Rig(
        plant, runs(plant, folder / "rail_cart", parts),
        {"position": (6.62, 9.00)}, {"position": (0.384, 0.310)},
        ("constant_offset", "position_ripple|linear_stiffness"), "mm", windows=3,
        remark="at 0.30 m the offset is 170, at 0.51 m 63; dry friction adds nothing",
    )  # fmt: skip


def relay_motor(folder: Path) -> Rig:
    """A geared motor at full duty, reversed by a relay: gain and viscous loss."""

    plant = eoi.Plant(
        _damped, {"gain": 60000.0, "damping": 100.0}, relative_degree=2,
        inputs=("duty",), outputs=("angle",),
        units={"duty": "1", "angle": "deg", "gain": "deg/s²", "damping": "1/s"},
    )  # fmt: skip
    columns = table(folder / "relay_motor/relay_motor.csv")
    parts = (((0, 499),), ((499, 700),), ((700, 913),))
    return Rig(
        plant, records(plant, columns, parts),
        {"angle": (1.88, 1.47)}, {"angle": (1.32, 1.57)},
        ("constant_offset|input_asymmetry|asymmetric_friction",), "°", windows=2,
        remark="a count of the encoder is 3.43°, half the swing of the limit cycle",
    )  # fmt: skip


def mouse_wheel(folder: Path) -> Rig:
    """A wheel of a small robot under a speed loop that swings: gain and loss."""

    def wheel(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.gain * u - p.loss * x.y[0]

    plant = eoi.Plant(
        wheel, {"gain": 100.0, "loss": 20.0}, relative_degree=1,
        inputs=("command",), outputs=("speed",),
        units={"command": "1", "speed": "rpm", "gain": "rpm/s", "loss": "1/s"},
    )  # fmt: skip
    columns = table(folder / "mouse_wheel/mouse_wheel.csv")
    parts = (((0, 150),), ((150, 210),), ((210, 271),))
    return Rig(
        plant, records(plant, columns, parts),
        {"speed": (23.9, 15.8)}, {"speed": (13.6, 9.98)},
        ("coulomb_friction|constant_offset|input_dead_zone|rate_friction",), "rpm", windows=2,
        remark="12 of each 24 ms are missing; it stands for the first 57 ms",
    )  # fmt: skip


def tilt_ball(folder: Path) -> Rig:
    """A ball on a beam that a loop tilts: acceleration in proportion, viscous friction."""

    plant = eoi.Plant(
        _damped, {"gain": 100.0, "damping": 1.0}, relative_degree=2,
        inputs=("tilt",), outputs=("position",),
        units={"tilt": "deg", "position": "mm", "gain": "mm/s²/deg", "damping": "1/s"},
    )  # fmt: skip
    columns = table(folder / "tilt_ball/tilt_ball.csv")
    parts = (((0, 124),), ((124, 186),), ((186, 247),))
    return Rig(
        plant, records(plant, columns, parts),
        {"position": (2.87, 3.92)}, {"position": (2.26, 3.03)}, (), "mm", windows=2,
        remark="samples 8 and 32 ms apart by turns; probably a dead band of half a degree",
    )  # fmt: skip


MECHANICAL: Mapping[str, FoundSet] = {
    "rotor_pendulum": FoundSet(
        rotor_pendulum,
        "data/coletas/MALHA-ABERTA_20260917/malha_aberta_40_0917_15-36.csv, ..._46_0917_15-51 and "
        "..._48_0917_15-54, from 4.98 s, every second row, of "
        "https://github.com/FelipeEduardoMarcondes/SYSTEM-IDENTIFICATION-AERO",
        aside=True,
    ),
    "rail_cart": FoundSet(
        rail_cart,
        "parameterEstimation/data/cartTest2/0m30.csv, 0 to 2.94 s, and 0m51.csv, 11.08 to 13.96 s, "
        "of https://github.com/nielsSkov/masterThesisMatlab",
        aside=True,
    ),
    "relay_motor": FoundSet(
        relay_motor,
        "dc_motor_relay_method/data.csv, 913 rows from the step on, of "
        "https://github.com/gkeiel/dc_motor_position_control",
        aside=True,
    ),
    "mouse_wheel": FoundSet(
        mouse_wheel,
        "matlab/data/testPid8.csv, left wheel, 1776.437 to 1777.345 s, of "
        "https://github.com/opatiny/micromouse",
        aside=True,
    ),
    "tilt_ball": FoundSet(
        tilt_ball,
        "experiments/experiment_b/PID_trial_11.csv, 2.471 to 7.390 s, of "
        "https://github.com/YasiruFernando95/ball-and-beam-sim-to-real",
        aside=True,
    ),
}
