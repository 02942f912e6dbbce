"""Public measured sets of gliders in the sea, craft in the air, heat, nerve and brain.

As `found_heated_cases`, all set aside and fitted by hand before discovery saw them: depth and
heading of an underwater glider, pitch of a quadrotor, heading of a hovercraft, a dryer for
mushrooms, the membrane of a nerve cell, the blood oxygen of a brain area, the heat of cement, a
calorimeter that settles.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp

import eoi_jax as eoi
from benchmarks.measured.campaign_cases import Rig
from benchmarks.measured.found_sets import FoundSet, Runs, records, runs, table

_HOUR = 3600.0
_MINUTE = 60.0
_MILLISECOND = 1e-3


def glider_depth(folder: Path) -> Rig:
    """Depth of an underwater glider that dives and climbs by its ballast: buoyancy and drag."""

    def glider(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return -p.lift * u[0] / 100.0 - x.y[1] / p.tau

    plant = eoi.Plant(
        glider, {"lift": 0.005, "tau": 15.0}, relative_degree=2, inputs=("ballast", "pitch"),
        outputs=("depth",), bounds={"tau": (1.0, 500.0)},
        units={"ballast": "cm³", "pitch": "rad", "depth": "m", "lift": "m/s²", "tau": "s"},
    )  # fmt: skip
    columns = table(folder / "glider_depth/sebastian.csv")
    parts = (((8, 365),), ((365, 495),), ((495, 706),))
    return Rig(
        plant, records(plant, columns, parts),
        {"depth": (7.244, 5.414)}, {"depth": (1.328, 0.829)},
        ("constant_offset", "linear_stiffness|quadratic_stiffness|cubic_stiffness|curve"), "m",
        windows=4,
        remark="it is heavier than water at the zero of its ballast: an offset, held out 2.14 and "
        "1.25 for 8.72 and 5.76; and lighter water in the upper 5 m, as a tanh of the depth 1.32 "
        "and 0.59, as a spring 1.65 and 1.20 (here 2.38 and 0.61), with a square 1.60 and 0.62 "
        "(here 1.81 and 0.81), as a spring and a part of the pitch 1.26 and 1.11 (here 1.29 and "
        "0.62); quadratic drag instead of the linear one is no better (2.68 and 1.54)",
    )  # fmt: skip


def glider_heading(folder: Path) -> Rig:
    """Heading of two underwater gliders behind their fins, after Nomoto."""

    def turn(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return -p.gain * u[0] - x.y[1] / p.tau

    plant = eoi.Plant(
        turn, {"gain": -0.002, "tau": 20.0}, relative_degree=2, inputs=("fin", "pitch", "roll"),
        outputs=("heading",), bounds={"tau": (1.0, 500.0)},
        units={"fin": "rad", "pitch": "rad", "roll": "rad", "heading": "rad", "gain": "1/s²",
               "tau": "s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("sebastian", (10, 370)), ("amadeus", (0, 320))),
        (("sebastian", (370, 540)),),
        (("sebastian", (540, 700)),),
    )
    return Rig(
        plant, runs(plant, folder / "glider_heading", parts),
        {"heading": (0.2676, 0.2959)}, {"heading": (0.2118, 0.1786)},
        ("product|parameter_dependence",), "rad", windows=4,
        remark="in its loop, and the sea turns it too: a constant would do as well as the declared "
        "one; the fin works with the pitch, hardly on a dive, twice on a climb: held out 0.208 and "
        "0.344 for 0.275 and 0.298, where it was fitted 0.279 and 0.259 for 0.375 and 0.360; a "
        "delay of 18 s and an offset 0.257 and 0.299 (here 0.265 and 0.204), a part of the pitch "
        "0.218 and 0.349 (here 0.207 and 0.356); quadratic damping, roll and a lag no better",
    )  # fmt: skip


def quad_pitch(folder: Path) -> Rig:
    """Pitch of a quadrotor that hangs in a frame, behind the commands of its four motors."""

    def frame(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        thrust = u[1] + u[3] - u[0] - u[2]
        weight = p.stiffness * jnp.sin(jnp.pi / 180.0 * x.y[0])
        return p.gain * thrust - p.damping * x.y[1] - weight

    plant = eoi.Plant(
        frame, {"gain": 1.0, "damping": 1.0, "stiffness": 2500.0}, relative_degree=2,
        inputs=("m1", "m2", "m3", "m4"), outputs=("pitch",),
        bounds={"stiffness": (1.0, 1e5)},
        units={"m1": "1", "m2": "1", "m3": "1", "m4": "1", "pitch": "°", "gain": "°/s²",
               "damping": "1/s", "stiffness": "°/s²"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("random_24", (0, 199)), ("random_11", (0, 188)), ("random_38", (0, 178)),
         ("step_384", (0, 118)), ("sine_640", (0, 100))),
        (("random_6", (0, 164)),),
        (("random_30", (0, 188)),),
    )  # fmt: skip
    return Rig(
        plant, runs(plant, folder / "quad_pitch", parts),
        {"pitch": (4.561, 3.869)}, {"pitch": (4.561, 3.869)},
        ("constant_offset", "actuator_lag|input_delay"), "°",
        remark="held out an offset 0.84 and 0.71 for 2.80 and 1.77, with a lag of the motors of "
        "0.10 s 0.94 and 0.61, with dry friction too 0.95 and 0.57, with a bent spring 0.76 and "
        "0.56, with squares of the commands in place of the lag 0.60 and 0.59 (where it was fitted "
        "2.17 for 1.38); an offset with a lag 5.37 and 3.42 here, worse than declared: the "
        "untouched run rests at 18° where all of them say 23°, as the motors differ: gains of "
        "their own 5.53 and 3.61, held out 2.93 and 1.54",
    )  # fmt: skip


def mushroom_dryer(folder: Path) -> Rig:
    """Air in a heated cabinet for mushrooms, in minutes, with its heater on or off."""

    def cabinet(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.heating * u[0] - (x.y[0] - 22.0) / p.tau

    plant = eoi.Plant(
        cabinet, {"heating": 2.5, "tau": 30.0}, relative_degree=1, inputs=("heater",),
        outputs=("temperature",), bounds={"tau": (1.0, 1e4)},
        units={"heater": "1", "temperature": "°C", "heating": "K/min", "tau": "min"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("february_1", (0, 184)), ("march_1", (0, 182))),
        (("february_2", (0, 62)), ("march_2", (0, 59))),
        (("march_3", (0, 60)), ("march_4", (0, 94))),
    )
    return Rig(
        plant, runs(plant, folder / "mushroom_dryer", parts, _MINUTE),
        {"temperature": (0.6077, 0.6077)}, {"temperature": (0.0660, 0.0660)},
        ("actuator_lag|second_node|sensor_lag", "sensor_lag|input_delay|actuator_lag"), "K",
        windows=1,
        remark="two slow stores in a row of 24 min each and a lag of 1.5 min; held out 0.147, a "
        "slow lag of the heater alone 0.236 (here 0.244), with a delay of 0.6 min 0.173 (here "
        "0.190), a delay alone 1.91, an air of 59 °C 0.330 (here 0.227), declared 0.989; the room "
        "is taken for 22 °C, the sensor shows tenths",
    )  # fmt: skip


def neuron_membrane(folder: Path) -> Rig:
    """Membrane of a nerve cell of the hippocampus at steps of current inwards, in ms."""

    def membrane(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.resistance * u[0] - x.y[0]) / p.tau

    plant = eoi.Plant(
        membrane, {"resistance": 90.0, "tau": 20.0}, relative_degree=1, inputs=("current",),
        outputs=("voltage",), bounds={"tau": (0.5, 500.0)},
        units={"current": "nA", "voltage": "mV", "resistance": "mV/nA", "tau": "ms"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("step_7", (0, 896)), ("step_10", (20, 896))),
        (("step_9", (0, 896)),),
        (("step_8", (0, 896)),),
    )
    return Rig(
        plant, runs(plant, folder / "neuron_membrane", parts, _MILLISECOND),
        {"voltage": (5.132, 4.935)}, {"voltage": (2.390, 2.343)},
        ("second_node|relaxation",
         "input_quadratic|input_curve|power_loss|quadratic_stiffness|curve|cubic_stiffness"),
        "mV",
        remark="its resistance grows with the step (64 to 97 mV/nA), and it creeps: a cube of the "
        "current and a slow store, held out 2.65 and 2.56 for 7.65 and 7.53; a square of it and a "
        "slow store 3.25 and 3.18 (here 2.86 and 2.85), alone 5.60 (here 3.87), a conductance that "
        "falls with the cube of the voltage and a slow store 4.40 (here 1.73 and 1.93), a slow "
        "store alone 7.74, a lag 7.65, an offset 8.13; its rest drifts by some mV",
    )  # fmt: skip


def brain_bold(folder: Path) -> Rig:
    """Blood oxygen signal of a brain area after short stimuli, twelve runs of one person."""

    def response(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.gain * u[0] - x.y[0]) / p.tau

    plant = eoi.Plant(
        response, {"gain": 1.0, "tau": 6.0}, relative_degree=1, inputs=("stimulus",),
        outputs=("bold",), bounds={"tau": (0.5, 200.0)},
        units={"stimulus": "1", "bold": "1", "gain": "1", "tau": "s"},
    )  # fmt: skip
    columns = table(folder / "brain_bold/runs.csv")
    parts = tuple(
        tuple((280 * run, 280 * (run + 1)) for run in range(*span))
        for span in ((0, 6), (6, 9), (9, 12))
    )
    return Rig(
        plant, records(plant, columns, parts),
        {"bold": (0.7375, 0.7239)}, {"bold": (0.6648, 0.6666)},
        ("constant_offset|relaxation|input_rate", "actuator_lag|sensor_lag|input_delay"), "1",
        windows=4,
        remark="mostly noise, of 0.7; a second lag and a part that undershoots later, held out "
        "0.520 and 0.487 for 0.612 and 0.540; an offset and a lag 0.544 and 0.508 (here 0.697 and "
        "0.692), with a delay of 1.2 s in its place 0.549 and 0.511, an offset alone 0.562 and "
        "0.519, a lag alone 0.606 and 0.535",
    )  # fmt: skip


def cement_heat(folder: Path) -> Rig:
    """Heat of a cement that hardens, from 2 h on, four portions of one kind, in hours."""

    def cement(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, u
        return p.rate * (x.y[0] + p.seed) * (1.0 - x.y[0] / p.total)

    plant = eoi.Plant(
        cement, {"rate": 0.2, "seed": 20.0, "total": 1000.0}, relative_degree=1, inputs=(),
        outputs=("heat",), bounds={"seed": (1e-3, 1e3), "total": (100.0, 5000.0)},
        units={"heat": "J", "rate": "1/h", "seed": "J", "total": "J"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("channel_3", (0, 277)), ("channel_4", (0, 277))),
        (("channel_5", (0, 277)),),
        (("channel_6", (0, 277)),),
    )
    return Rig(
        plant, runs(plant, folder / "cement_heat", parts, _HOUR),
        {"heat": (23.88, 35.71)}, {"heat": (19.63, 10.74)},
        ("power_loss|curve|saturating_loss|quadratic_stiffness|varying_capacity|rate_asymmetry",),
        "J", windows=4,
        remark="growth that saturates, and a power of 3.1 of what is left, held out 6.4 and 6.5 "
        "for 17.7 and 34.9; a power of 4.9 of what is left alone 6.8 and 7.0 (here 19.2 and "
        "11.2), of the heat as well 6.3 and 6.9, the rate as a polynomial of the heat of degree 4 "
        "7.5 and 8.3 (here 18.6 and 12.4), of degree 3 9.2 and 11.6, growth that saturates alone "
        "7.5 and 19.0, a drift 6.5 and 11.8; the untouched portion gave 4 % less heat",
    )  # fmt: skip


def calorimeter_settling(folder: Path) -> Rig:
    """Heat flow of a calorimeter whose six channels settle after a warm sample came in."""

    def channel(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, u
        return -x.y[0] / p.tau

    plant = eoi.Plant(
        channel, {"tau": 330.0}, relative_degree=1, inputs=(), outputs=("flow",),
        bounds={"tau": (10.0, 5000.0)}, units={"flow": "mW", "tau": "s"},
    )  # fmt: skip
    whole = (0, 270)
    parts: tuple[Runs, Runs, Runs] = (
        (("channel_1", whole), ("channel_3", whole), ("channel_5", whole)),
        (("channel_4", whole),),
        (("channel_2", whole), ("channel_6", whole)),
    )
    return Rig(
        plant, runs(plant, folder / "calorimeter_settling", parts),
        {"flow": (1.784, 1.421)}, {"flow": (0.2398, 0.2072)},
        ("second_node", "constant_offset"), "mW", windows=4,
        remark="the sample reacts on: an offset of 1.2 and a slow store, held out 0.045 and 0.066 "
        "for 1.74 and 1.36; a slow store alone 0.088 and 0.105 (here 0.262 and 0.235), an offset "
        "alone 0.298 and 0.276 (here 0.379 and 0.334), an offset with a drift 0.116 and 0.117, a "
        "power of 1.6 0.762",
    )  # fmt: skip


def hovercraft_yaw(folder: Path) -> Rig:
    """Heading of a small hovercraft whose two thrusters switch at random."""

    def hovercraft(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.gain * (u[0] - u[1]) - p.damping * x.y[1]

    plant = eoi.Plant(
        hovercraft, {"gain": 25.0, "damping": 0.3}, relative_degree=2, inputs=("left", "right"),
        outputs=("yaw",), bounds={"damping": (0.0, 30.0)},
        units={"left": "1", "right": "1", "yaw": "rad", "gain": "rad/s²", "damping": "1/s"},
    )  # fmt: skip
    columns = table(folder / "hovercraft_yaw/prbs.csv")
    parts = (((0, 122),), ((122, 183),), ((183, 244),))
    return Rig(
        plant, records(plant, columns, parts),
        {"yaw": (0.2548, 0.2548)}, {"yaw": (0.2548, 0.2548)}, (), "rad", windows=1,
        remark="five seconds, nothing certain: an offset and a lag held out 0.074 for 0.500, here "
        "0.825; a delay of 48 ms 0.384 (here 0.418, where it was fitted 0.111 for 0.190), dry "
        "friction 0.410 (here 0.147), both 0.281 (here 0.237), unequal thrusters with a delay "
        "0.240 (here 0.796), quadratic drag with a lag 0.420 (here 0.427)",
    )  # fmt: skip


_DBD = "package dbdreader 0.6.3, https://pypi.org/project/dbdreader"
_CALO = (
    "calocem/DATA/gen1_calofile.csv (TAM Air, 8 channels, 10 s), of the package calocem 0.4.0, "
    "https://pypi.org/project/calocem"
)
FIELD: Mapping[str, FoundSet] = {
    "glider_depth": FoundSet(
        glider_depth,
        "dbdreader/data/sebastian-2014-204-05-000.dbd, m_ballast_pumped, m_pitch and m_depth, on "
        f"a grid of 4.42 s from 580 to 3700 s, of the source of the {_DBD}",
        aside=True,
    ),
    "glider_heading": FoundSet(
        glider_heading,
        "dbdreader/data/sebastian- and amadeus-2014-204-05-000.dbd, m_fin, m_pitch, m_roll and "
        "m_heading (unwrapped), on grids of 4.42 and 4.49 s from 580 to 3700 s and 640 to 3440 s, "
        f"of the source of the {_DBD}",
        aside=True,
    ),
    "quad_pitch": FoundSet(
        quad_pitch,
        "Decoupled 3-DoF/Pitch/Exp 2/random_6, 11, 24, 30, 38, step_384 and sine_640.csv, first "
        "200 to 400 rows (without the first row of the random ones), every second, 10 ms a row "
        "(its script), of https://github.com/prakharsethi17/Attitude-Control-of-Quadcopter",
        aside=True,
    ),
    "mushroom_dryer": FoundSet(
        mushroom_dryer,
        "results/heater/202602111639.csv (00:30 to 31:01, 31:21 to 41:31) and 202603031656.csv "
        "(00:50 to 31:00, 31:50 to 41:30, 42:20 to 52:10, 53:00 to 68:31), of "
        "https://github.com/jesnyder/mycoReactor",
        aside=True,
    ),
    "neuron_membrane": FoundSet(
        neuron_membrane,
        "tests/exp_data/hippocampus-portal/99111002.nwb, steps 7 to 10, medians of 8 samples, "
        "less the rest before the step, of the source of the package bluepyefe 2.3.63, "
        "https://pypi.org/project/bluepyefe (Hippocampus Hub, CNR and EPFL)",
        aside=True,
    ),
    "brain_bold": FoundSet(
        brain_bold,
        "nitime/data/event_related_fmri.csv, all rows, 2 s a row, all kinds of events as one, of "
        "the package nitime 0.12.1, https://pypi.org/project/nitime",
        aside=True,
    ),
    "cement_heat": FoundSet(
        cement_heat,
        f"channels 3 to 6 of {_CALO}, integrated from 7200 s on, every 600 s",
        aside=True,
    ),
    "calorimeter_settling": FoundSet(
        calorimeter_settling, f"channels 1 to 6 of {_CALO}, 610 to 5990 s, every 20 s", aside=True
    ),
    "hovercraft_yaw": FoundSet(
        hovercraft_yaw,
        "data_id/controls_ and pose_2019-04-16-12-29-28.csv, field.point.x and y, and z "
        "(unwrapped), of 223 frames on a grid of 20 ms, the first 4.86 s, of "
        "https://github.com/MauroPfister/hovercraft-ros",
        aside=True,
    ),
}
