"""Five public measured sets, fitted by hand before discovery saw them; all five are set aside.

As `found_cases`: a distillation column, a motor that is switched through its dead zone, a servo
with a weight, its arm let fall, a beam between two propellers.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import eoi_jax as eoi
from benchmarks.measured.campaign_cases import Rig
from benchmarks.measured.found_sets import FoundSet, Runs, records, runs, table


def distillation_tray(folder: Path) -> Rig:
    """Reflux of a distillation column to a tray's level: one time constant. Time in minutes."""

    def tray(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.rest + p.gain * (u - 20.4) - x.y[0]) / p.tau

    plant = eoi.Plant(
        tray, {"rest": 215.2, "gain": -8.0, "tau": 45.0}, relative_degree=1, inputs=("reflux",),
        outputs=("level",), bounds={"tau": (1.0, np.inf)},
        units={"reflux": "m³/h", "level": "cm", "rest": "cm", "tau": "min"},
    )  # fmt: skip
    columns = table(folder / "distillation_tray/distillation_tray.csv")
    parts = (((0, 116),), ((116, 155),), ((155, 194),))
    return Rig(
        plant, records(plant, columns, parts, time_unit=60.0),
        {"level": (0.0629, 0.0629)}, {"level": (0.0629, 0.0629)}, (), "cm", windows=1,
        remark="one step of the reflux; nothing is missing that the records tell",
    )  # fmt: skip


def pwm_motor(folder: Path) -> Rig:
    """A motor behind a switched driver: duty to speed, with viscous friction."""

    def motor(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.gain * u - p.damping * x.y[0]

    plant = eoi.Plant(
        motor, {"gain": 50.0, "damping": 8.0}, relative_degree=1, inputs=("command",),
        outputs=("speed",),
        units={"command": "1", "speed": "rpm", "gain": "rpm/s", "damping": "1/s"},
    )  # fmt: skip
    columns = table(folder / "pwm_motor/pwm_motor.csv")
    parts = (((0, 500),), ((500, 724),), ((724, 948),))
    return Rig(
        plant, records(plant, columns, parts),
        {"speed": (86.5, 74.4)}, {"speed": (35.5, 32.7)},
        ("product", "coulomb_friction|stribeck_friction|input_dead_zone"), "rpm", windows=3,
        remark="the driver brakes in proportion to the duty, and dry friction; a lag is probable",
    )  # fmt: skip


def weighted_servo(folder: Path) -> Rig:
    """A servo turns an arm with a weight: commanded to measured angle, an oscillator."""

    def servo(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.stiffness * (u - x.y[0]) - p.damping * x.y[1]

    plant = eoi.Plant(
        servo, {"stiffness": 200.0, "damping": 20.0}, relative_degree=2, inputs=("command",),
        outputs=("angle",),
        units={"command": "deg", "angle": "deg", "stiffness": "1/s²", "damping": "1/s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("chirp", (0, 150)),),
        (("step_minus_055", (0, 50)), ("step_055", (0, 50))),
        (("step_minus_06", (0, 50)), ("step_06", (0, 50))),
    )
    return Rig(
        plant, runs(plant, folder / "weighted_servo", parts),
        {"angle": (11.1, 11.1)}, {"angle": (2.19, 2.19)},
        ("error_saturation", "constant_offset|position_ripple|curve", "input_delay|actuator_lag"),
        "deg", windows=1,
        remark="the weight pulls with the cosine of the angle; 4.1 with an offset in its place",
    )  # fmt: skip


def servo_arm(folder: Path) -> Rig:
    """An arm with a weight is let go and turns the gears of a servo: gravity and damping."""

    def arm(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, u
        return -p.gravity * jnp.cos(jnp.pi / 180.0 * x.y[0]) - p.damping * x.y[1]

    plant = eoi.Plant(
        arm, {"gravity": 600.0, "damping": 3.0}, relative_degree=2, inputs=(), outputs=("angle",),
        units={"angle": "deg", "gravity": "deg/s²", "damping": "1/s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("drop_1", (0, 60)),),
        (("drop_3", (0, 56)),),
        (("drop_4", (0, 55)),),
    )
    return Rig(
        plant, runs(plant, folder / "servo_arm", parts),
        {"angle": (1.92, 1.92)}, {"angle": (0.29, 0.29)},
        ("coulomb_friction|stribeck_friction|asymmetric_friction",), "deg", windows=1,
    )  # fmt: skip


def bicopter(folder: Path) -> Rig:
    """A beam between two propellers: difference of the drives to angle, under control."""

    def beam(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.gain * u - p.damping * x.y[1]

    plant = eoi.Plant(
        beam, {"gain": 5.0, "damping": 3.0}, relative_degree=2, inputs=("drive",),
        outputs=("angle",),
        units={"drive": "%", "angle": "deg", "gain": "deg/s²/%", "damping": "1/s"},
    )  # fmt: skip
    columns = table(folder / "bicopter/bicopter.csv")
    parts = (((30, 130),), ((130, 185),), ((185, 241),))
    return Rig(
        plant, records(plant, columns, parts),
        {"angle": (1.37, 1.37)}, {"angle": (0.622, 0.622)}, (), "deg", windows=1,
        remark="lag of the propellers and an offset are probable; one swing tells little",
    )  # fmt: skip


_SHIELD = "https://github.com/gergelytakacs/AutomationShield"
_SERVO = "https://github.com/mauicv/servo-sysid"
FRESH: Mapping[str, FoundSet] = {
    "distillation_tray": FoundSet(
        distillation_tray,
        "Oil refinery, refinery of the R package fda, https://cran.r-project.org/package=fda",
        aside=True,
    ),
    "pwm_motor": FoundSet(
        pwm_motor,
        "LAB3/MotorRPM12.csv, 2 to 21 s, on a grid of 20 ms, of "
        "https://github.com/tieubinhco/Lesson_Motor_Control",
        aside=True,
    ),
    "weighted_servo": FoundSet(
        weighted_servo,
        f"response.json (chirp, large steps) of {_SERVO}",
        aside=True,
    ),
    "servo_arm": FoundSet(
        servo_arm,
        f"drop-response-1.json, -3 and -4 of {_SERVO}",
        aside=True,
    ),
    "bicopter": FoundSet(
        bicopter,
        f"BicopShield_PID/pid1.csv, rows 0 to 240, of {_SHIELD}",
        aside=True,
    ),
}
