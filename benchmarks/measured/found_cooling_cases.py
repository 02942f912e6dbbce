"""Public measured sets of cooling and a heart, fitted by hand before discovery saw them.

As `found_kit_cases`, all set aside: the heart of a runner, the processor of a small computer in a
metal case, an optical part on a Peltier element, a room with an inverter, a heater in a duct. Whole
runs count, as there.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import eoi_jax as eoi
from benchmarks.measured.campaign_cases import Rig
from benchmarks.measured.found_sets import FoundSet, Runs, records, runs, table

_HOUR = 3_600.0


def runner_heart(folder: Path) -> Rig:
    """Heart rate of a runner on a treadmill, and after it stops: one time constant to a demand."""

    def heart(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.rest + p.gain * u - x.y[0]) / p.tau

    plant = eoi.Plant(
        heart, {"rest": 70.0, "gain": 6.0, "tau": 30.0}, relative_degree=1, inputs=("speed",),
        outputs=("heart_rate",), bounds={"tau": (1.0, np.inf)},
        units={"speed": "km/h", "heart_rate": "1/min", "rest": "1/min", "gain": "h/km/min",
               "tau": "s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("run_14", (0, 195)),), (("run_13", (0, 208)),), (("run_15", (0, 194)),),
    )  # fmt: skip
    return Rig(
        plant, runs(plant, folder / "runner_heart", parts),
        {"heart_rate": (5.621, 5.621)}, {"heart_rate": (5.361, 5.361)},
        ("actuator_lag|sensor_lag|input_delay|rate_asymmetry|second_node|cells_in_series",),
        "1/min", windows=1,
        remark="a lag of 9 s or a dead time of 7 s (2.92 and 2.98 on the estimation record, "
        "declared 4.13); the rate at rest differs from run to run, which no effect mends",
    )  # fmt: skip


def pi_cooler(folder: Path) -> Rig:
    """The processor of a small computer in a metal case, idle, under load, idle: one heat store."""

    def chip(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.gain * u - (x.y[0] - p.idle) / p.tau

    plant = eoi.Plant(
        chip, {"gain": 0.5, "tau": 30.0, "idle": 37.0}, relative_degree=1, inputs=("load",),
        outputs=("temperature",), bounds={"tau": (0.5, np.inf)},
        units={"load": "1", "temperature": "°C", "gain": "K/s", "tau": "s", "idle": "°C"},
    )  # fmt: skip
    columns = table(folder / "pi_cooler/flirc.csv")
    parts = (((0, 144),), ((144, 205),), ((205, 293),))
    return Rig(
        plant, records(plant, columns, parts),
        {"temperature": (4.512, 4.512)}, {"temperature": (1.410, 1.410)}, ("second_node",), "K",
        windows=1,
        remark="the case is the second store; by the held-out part it alone loses heat, slowly "
        "(0.77; with the declared loss beside it 1.37, here 2.77; declared 2.63); the quantum is 1",
    )  # fmt: skip


def laser_cooler(folder: Path) -> Rig:
    """Temperature of an optical part on a Peltier element: the current pumps, the load heats."""

    def stage(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, x
        return p.load - p.gain * u

    plant = eoi.Plant(
        stage, {"gain": 9.0, "load": 1.2}, relative_degree=1, inputs=("current",),
        outputs=("temperature",),
        units={"current": "A", "temperature": "°C", "gain": "K/s/A", "load": "K/s"},
    )  # fmt: skip
    columns = table(folder / "laser_cooler/step.csv")
    parts = (((95, 155),), ((0, 50),), ((50, 95), (155, 200)))
    return Rig(
        plant, records(plant, columns, parts),
        {"temperature": (889.0, 889.0)}, {"temperature": (122.9, 122.9)},
        ("input_quadratic|input_asymmetry|input_curve",), "mK", 1e3, windows=1,
        remark="Joule's heat, 0.41 of the square of the current in A (held out 51, declared 906); "
        "a lag of 25 ms too is better on the estimation record (91 for 109), not held out (150); "
        "heat by the size of the current does as well (116, held out 49)",
    )  # fmt: skip


def inverter_room(folder: Path) -> Rig:
    """Air by an inverter indoors behind its power and the air outdoors: one store. In hours."""

    def room(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.gain * 1e-3 * u[1] + (u[0] - x.y[0]) / p.tau

    plant = eoi.Plant(
        room, {"gain": 0.3, "tau": 8.0}, relative_degree=1, inputs=("outdoor", "power"),
        outputs=("room",), bounds={"tau": (0.5, np.inf)},
        units={"outdoor": "°C", "power": "W", "room": "°C", "gain": "K/h/kW", "tau": "h"},
    )  # fmt: skip
    columns = table(folder / "inverter_room/room.csv")
    parts = (((0, 192),), ((192, 288),), ((288, 384),))
    return Rig(
        plant, records(plant, columns, parts, time_unit=_HOUR),
        {"room": (5621.0, 5621.0)}, {"room": (655.9, 655.9)},
        ("constant_offset", "second_node|relaxation"), "mK", 1e3, windows=1,
        remark="something else heats it by 12 K: offset alone held out 1319 for 4587, here 3231; "
        "a slow second store beside it held out 994; the sun, recorded but not in this model, does "
        "better than the power (with both 851 held out)",
    )  # fmt: skip


def duct_heater(folder: Path) -> Rig:
    """Temperature in a duct behind the duty of its heater: gain and one time constant.

    The room is at 24.4 °C, where the first run begins.
    """

    def duct(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.gain * u - (x.y[0] - 24.4) / p.tau

    plant = eoi.Plant(
        duct, {"gain": 0.35, "tau": 120.0}, relative_degree=1, inputs=("duty",),
        outputs=("temperature",), bounds={"tau": (1.0, np.inf)},
        units={"duty": "1", "temperature": "°C", "gain": "K/s", "tau": "s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("heat", (0, 160)),), (("loop", (0, 43)),), (("loop", (43, 85)),),
    )  # fmt: skip
    return Rig(
        plant, runs(plant, folder / "duct_heater", parts),
        {"temperature": (980.8, 980.8)}, {"temperature": (233.5, 233.5)},
        ("actuator_lag|sensor_lag|second_node|cells_in_series",), "mK", 1e3, windows=1,
        remark="two lags of 58 s each (held out 463 for 1325; 285 for 1199 where it was fitted); "
        "one of them and a second store do as well (134), not held out (1058); full duty where it "
        "was fitted, a third of it here; 36.5 to 36.97 °C are missing codes",
    )  # fmt: skip


COOLERS: Mapping[str, FoundSet] = {
    "runner_heart": FoundSet(
        runner_heart,
        "S1_Dataset/Exercise C + D, A + B and E + F.txt (running, then recovery from the last "
        "beat on; 14.4, 13.4 and 15.7 km/h), the first row at or after each 5 s, of "
        "https://github.com/mjhyman/be606_project (from PLoS ONE, Zakynthinaki, 2015)",
        aside=True,
    ),
    "pi_cooler": FoundSet(
        pi_cooler,
        "rpi4b-flirc.dat, all rows, load from the stressed 150 to 450 s, of "
        "https://github.com/nschloe/stressberry",
        aside=True,
    ),
    "laser_cooler": FoundSet(
        laser_cooler,
        "data/step_response.csv, all rows, of "
        "https://github.com/REDCO-Labs/FBG-interfero-controller-software",
        aside=True,
    ),
    "inverter_room": FoundSet(
        inverter_room,
        "pvanalytics/data/serf_west_15min.csv (NREL), ambient_temp__780, ac_power__773, "
        "poa_irradiance__771 and inveter_temp__784, all rows, of "
        "https://github.com/pvlib/pvanalytics (package pvanalytics 0.2.2)",
        aside=True,
    ),
    "duct_heater": FoundSet(
        duct_heater,
        "dados_ensaio_openloop.csv, every third row of 18:45:04 to 19:00:58, and "
        "dados_ensaio_variacao_sp.csv, every third row of 17:48:30 to 17:56:54, of "
        "https://github.com/rodrigotriboni1/sistema_realimentado",
        aside=True,
    ),
}
