"""Eleven public measured sets, fitted by hand before discovery saw them; all are set aside.

As `found_cases`: a distillation column, a motor that is switched through its dead zone, a servo
with a weight, its arm let fall, a beam between two propellers; then a motor with an encoder, a
filter of two stages, the middle one of three tanks, a test house, a wheel on a rod, an oven.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import eoi_jax as eoi
from benchmarks.measured.campaign_cases import Rig
from benchmarks.measured.found_sets import FoundSet, Runs, quarters, records, runs, table


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


def encoder_motor(folder: Path) -> Rig:
    """A motor that is reversed every quarter of a second: voltage to angle, viscous friction."""

    def motor(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.gain * u - p.damping * x.y[1]

    plant = eoi.Plant(
        motor, {"gain": 1.5e5, "damping": 100.0}, relative_degree=2, inputs=("voltage",),
        outputs=("angle",),
        units={"voltage": "V", "angle": "deg", "gain": "deg/s²/V", "damping": "1/s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("square", (0, 250)),),
        (("square", (250, 375)),),
        (("square", (375, 500)), ("pulses", (5, 209))),
    )
    return Rig(
        plant, runs(plant, folder / "encoder_motor", parts),
        {"angle": (21.6, 21.6)}, {"angle": (14.3, 14.3)},
        ("constant_offset|input_quadratic|asymmetric_friction",), "deg", windows=1,
        remark="the two directions differ; the second record drives a little less",
    )  # fmt: skip


def filter_circuit(folder: Path) -> Rig:
    """A filter of two stages behind a converter, taken for one resistor and capacitor."""

    def stage(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (u - x.y[0]) / p.tau

    plant = eoi.Plant(
        stage, {"tau": 0.04}, relative_degree=1, inputs=("drive",), outputs=("voltage",),
        bounds={"tau": (1e-3, np.inf)}, units={"drive": "V", "voltage": "V", "tau": "s"},
    )  # fmt: skip
    columns = table(folder / "filter_circuit/filter_circuit.csv")
    parts = (((0, 450),), ((450, 675),), ((675, 899),))
    return Rig(
        plant, records(plant, columns, parts),
        {"voltage": (24.9, 35.6)}, {"voltage": (9.38, 9.64)},
        ("input_delay|actuator_lag", "constant_offset"), "mV", 1e3, windows=3,
        remark="what remains is a ripple of 11 mV that keeps no phase",
    )  # fmt: skip


def three_tanks(folder: Path) -> Rig:
    """The middle one of three tanks: level above to level, both outflows by Torricelli's law."""

    def tank(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        above = jnp.sqrt(jnp.maximum(u + 8.0, 0.0))  # its sensor reads -8 cm when it is empty
        return p.inflow * above - p.outflow * jnp.sqrt(jnp.maximum(x.y[0], 0.0))

    plant = eoi.Plant(
        tank, {"inflow": 0.3, "outflow": 0.3}, relative_degree=1, inputs=("upper",),
        outputs=("middle",), units={"upper": "cm", "middle": "cm"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("run_1", (0, 136)),),
        (("run_2", (0, 40)),),
        (("run_2", (40, 136)),),
    )
    return Rig(
        plant, runs(plant, folder / "three_tanks", parts),
        {"middle": (1.66, 2.00)}, {"middle": (1.44, 1.40)},
        ("curve|product|constant_offset|power_loss|quadratic_drag|input_curve",), "mm", 10.0,
        windows=2, remark="the section of the tank grows with the level; noise is 1.6 mm",
    )  # fmt: skip


def armadillo_house(folder: Path) -> Rig:
    """A test house: outside temperature, heating and sun to the room, one heat store."""

    def house(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        outside, heating, sun = u
        loss = p.loss * (outside - x.y[0])
        return loss + p.heat * heating / 1000.0 + p.gain * sun / 1000.0

    plant = eoi.Plant(
        house, {"loss": 0.02, "heat": 0.3, "gain": 0.2}, relative_degree=1,
        inputs=("outside", "heating", "sun"), outputs=("inside",),
        units={"outside": "°C", "heating": "W", "sun": "W/m²", "inside": "°C", "loss": "1/h"},
    )  # fmt: skip
    columns = table(folder / "armadillo_house/armadillo_house.csv")
    parts = (((0, 116),), ((116, 174),), ((174, 233),))
    return Rig(
        plant, records(plant, columns, parts, time_unit=3600.0),
        {"inside": (1.15, 1.15)}, {"inside": (0.417, 0.417)}, ("second_node",), "K", windows=1,
        remark="the room loses its heat through the wall: 1.02 with the store beside the room",
    )  # fmt: skip


def wheel_swing(folder: Path) -> Rig:
    """A wheel twists a rod to and fro: an oscillator, seen by a gyroscope."""

    def wheel(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, u
        return -p.stiffness * x.y[0] - p.damping * x.y[1]

    plant = eoi.Plant(
        wheel, {"stiffness": 200.0, "damping": 0.5}, relative_degree=2, inputs=(),
        outputs=("rate",), units={"rate": "rad/s", "stiffness": "1/s²", "damping": "1/s"},
    )  # fmt: skip
    columns = table(folder / "wheel_swing/wheel_swing.csv")
    return Rig(
        plant, records(plant, columns, quarters(271)),
        {"rate": (36.1, 36.1)}, {"rate": (11.3, 11.3)},
        ("constant_offset", "curve|displacement_damping|product"), "mrad/s", 1e3, windows=1,
        remark="the gyroscope's bias; dry friction, of which the rate shows the derivative",
    )  # fmt: skip


def reflow_oven(folder: Path) -> Rig:
    """An oven is switched on: temperature of the board, constant power and a loss."""

    def oven(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, u
        return p.power - p.loss * (x.y[0] - 25.0)

    plant = eoi.Plant(
        oven, {"power": 1.0, "loss": 0.003}, relative_degree=1, inputs=(),
        outputs=("temperature",), units={"temperature": "°C", "power": "K/s", "loss": "1/s"},
    )  # fmt: skip
    columns = table(folder / "reflow_oven/reflow_oven.csv")
    parts = (((0, 200),), ((200, 300),), ((300, 401),))
    return Rig(
        plant, records(plant, columns, parts),
        {"temperature": (86.9, 86.9)}, {"temperature": (7.48, 7.48)}, ("second_node",), "K",
        windows=1, remark="the element gets hot first; its loss shows behind the first half",
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
    "encoder_motor": FoundSet(
        encoder_motor,
        "Scripts/ExperimentData.csv and ValidationData.csv, voltages from main.cpp, of "
        "https://github.com/parzival2/DC-Motor-Parameter-Estimation",
        aside=True,
    ),
    "filter_circuit": FoundSet(
        filter_circuit,
        "step_response.csv of https://github.com/LukeXII/Control_Digital",
        aside=True,
    ),
    "three_tanks": FoundSet(
        three_tanks,
        "data/raw/data_600, 11:31 and 12:35, every 2 s from 2 to 272 s, of "
        "https://github.com/KAIR-ISZ/stancon2020_watertanks",
        aside=True,
    ),
    "armadillo_house": FoundSet(
        armadillo_house,
        "data/armadillo/armadillo_data_H2.csv of https://github.com/locie/pySIP",
        aside=True,
    ),
    "wheel_swing": FoundSet(
        wheel_swing,
        "notebooks/03/bicycle-wheel-radial-inertia-rate-gyro-measurement.csv, every 4 ms to "
        "1.08 s, of https://github.com/moorepants/resonance",
        aside=True,
    ),
    "reflow_oven": FoundSet(
        reflow_oven, "step_data.csv of https://github.com/yoshi-take/reflow", aside=True
    ),
}
