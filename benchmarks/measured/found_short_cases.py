"""Eight public measured sets of short records, fitted by hand before discovery saw them.

As `found_cases`, but windows are three a record. Four of the eight are set aside, drawn by
`random.Random(20261128).sample(sorted(SHORT), 4)`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import eoi_jax as eoi
from benchmarks.measured.campaign_cases import Parts, Rig
from benchmarks.measured.found_sets import FoundSet, Rows, quarters, records, table


def _whole(plant: eoi.Plant, folder: Path, parts: tuple[tuple[str, ...], ...]) -> Parts:
    """One record a file, all its rows."""

    def record(name: str) -> eoi.Record:
        columns = table(folder / f"{name}.csv")
        rows: tuple[tuple[Rows], ...] = (((0, len(columns["time"])),),) * 3
        return records(plant, columns, rows)[0][0]

    first, second, third = (tuple(map(record, part)) for part in parts)
    return first, second, third


def gas_furnace(folder: Path) -> Rig:
    """Rate of the gas to carbon dioxide in the exhaust, first order; Box and Jenkins, series J."""

    def furnace(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.level + p.gain * u - x.y[0]) / p.tau

    plant = eoi.Plant(
        furnace, {"level": 53.5, "gain": -1.5, "tau": 30.0}, relative_degree=1,
        inputs=("gas_rate",), outputs=("carbon_dioxide",), bounds={"tau": (1e-1, np.inf)},
        units={"gas_rate": "ft³/min", "carbon_dioxide": "%", "level": "%", "tau": "s"},
    )  # fmt: skip
    columns = table(folder / "gas_furnace/gas_furnace.csv")
    return Rig(
        plant, records(plant, columns, quarters(296)),
        {"carbon_dioxide": (2.05, 2.04)}, {"carbon_dioxide": (1.90, 1.70)}, ("input_delay",), "%",
        windows=3, remark="the end of the untouched part, rows 287 on, leaves every model",
    )  # fmt: skip


def zigzag_boat(folder: Path) -> Rig:
    """Rudder to heading of a boat of 3.6 m, Nomoto's first order; its speed is recorded too."""

    def boat(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.gain * u[0] - x.y[1]) / p.tau

    plant = eoi.Plant(
        boat, {"gain": 0.25, "tau": 2.0}, relative_degree=2, inputs=("rudder", "speed"),
        outputs=("heading",), bounds={"tau": (1e-2, np.inf)},
        units={"rudder": "deg", "speed": "m/s", "heading": "deg", "gain": "1/s", "tau": "s"},
    )  # fmt: skip
    columns = table(folder / "zigzag_boat/zigzag_boat.csv")
    return Rig(
        plant, records(plant, columns, quarters(420)),
        {"heading": (11.3, 5.89)}, {"heading": (4.20, 1.81)}, ("constant_offset",), "°", windows=3,
    )  # fmt: skip


def rc_ladder(folder: Path) -> Rig:
    """Two resistors and two capacitors, declared as one of each; random levels every 10 ms."""

    def low_pass(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.gain * u - x.y[0]) / p.tau

    plant = eoi.Plant(
        low_pass, {"gain": 1.0, "tau": 5.0}, relative_degree=1, inputs=("drive",),
        outputs=("output",), bounds={"tau": (1e-2, np.inf)},
        units={"drive": "1", "output": "1", "tau": "ms"},
    )  # fmt: skip
    columns = table(folder / "rc_ladder/rc_ladder.csv")
    return Rig(
        plant, records(plant, columns, quarters(682), 1e-3),
        {"output": (71.9, 68.1)}, {"output": (5.98, 5.53)}, ("input_delay",), "thousandths", 1e3,
        remark="time in ms; the lag of the second stage beside the delay is probable",
    )  # fmt: skip


def cooling_cup(folder: Path) -> Rig:
    """A mug of boiling water after Newton; fitted while hot, judged while it gets cooler."""

    def cup(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, u
        return (p.ambient - x.y[0]) / p.tau

    plant = eoi.Plant(
        cup, {"tau": 45.0, "ambient": 25.0}, relative_degree=1, inputs=(),
        outputs=("temperature",), bounds={"tau": (1e-1, np.inf)},
        units={"temperature": "°C", "ambient": "°C", "tau": "min"},
    )  # fmt: skip
    columns = table(folder / "cooling_cup/cooling_cup.csv")
    return Rig(
        plant, records(plant, columns, quarters(222)),
        {"temperature": (4.78, 2.02)}, {"temperature": (0.275, 0.101)},
        ("power_loss|second_node|curve",), "K", windows=3, remark="time in minutes",
    )  # fmt: skip


def car_coast_down(folder: Path) -> Rig:
    """A small electric car rolls out, with a constant resistance; four runs in two directions."""

    def car(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, x, u
        return -p.rolling

    plant = eoi.Plant(
        car, {"rolling": 0.15}, relative_degree=1, inputs=(), outputs=("speed",),
        units={"speed": "km/h", "rolling": "km/h/s"},
    )  # fmt: skip
    parts = (("run_A1", "run_B"), ("run_A",), ("run_B1",))
    return Rig(
        plant, _whole(plant, folder / "car_coast_down", parts),
        {"speed": (1.95, 1.78)}, {"speed": (1.40, 1.23)},
        ("leak|viscous_friction|quadratic_drag|power_loss",), "km/h", windows=3,
    )  # fmt: skip


def air_chamber(folder: Path) -> Rig:
    """Compressed air leaks from a printed chamber; judged at pressures below those of the fit."""

    def chamber(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, u
        return -p.leak * x.y[0]

    plant = eoi.Plant(
        chamber, {"leak": 0.15}, relative_degree=1, inputs=(), outputs=("pressure",),
        units={"pressure": "bar", "leak": "1/s"},
    )  # fmt: skip
    columns = table(folder / "air_chamber/air_chamber.csv")
    parts = (((7, 181),), ((181, 268),), ((268, 356),))
    return Rig(
        plant, records(plant, columns, parts),
        {"pressure": (32.8, 14.1)}, {"pressure": (6.70, 3.09)},
        ("power_loss|quadratic_drag|second_node|curve",), "mbar", 1e3, windows=3,
        remark="a power alone gives 3.0 / 3.0, but less before that",
    )  # fmt: skip


def office_air(folder: Path) -> Rig:
    """Carbon dioxide of an office, with somebody in it or nobody; parts of three days."""

    def office(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.source * u - p.exchange * (x.y[0] - 420.0)

    plant = eoi.Plant(
        office, {"source": 8.0, "exchange": 0.01}, relative_degree=1, inputs=("occupancy",),
        outputs=("carbon_dioxide",),
        units={"occupancy": "1", "carbon_dioxide": "ppm", "source": "ppm/min", "exchange": "1/min"},
    )  # fmt: skip
    parts = (("day_3",), ("day_2",), ("day_4",))
    return Rig(
        plant, _whole(plant, folder / "office_air", parts),
        {"carbon_dioxide": (59.4, 57.5)}, {"carbon_dioxide": (59.4, 57.5)}, (), "ppm", windows=3,
        remark="time in minutes; how many persons, doors and windows are not recorded",
    )  # fmt: skip


def dye_reactor(folder: Path) -> Rig:
    """Red dye is rinsed out of a stirred reactor after a pulse: first order."""

    def reactor(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, u
        return -p.dilution * x.y[0]

    plant = eoi.Plant(
        reactor, {"dilution": 0.003}, relative_degree=1, inputs=(), outputs=("dye",),
        units={"dye": "mg/l", "dilution": "1/s"},
    )  # fmt: skip
    columns = table(folder / "dye_reactor/dye_reactor.csv")
    return Rig(
        plant, records(plant, columns, quarters(145, first=1)),
        {"dye": (0.0771, 0.0793)}, {"dye": (0.0771, 0.0793)}, (), "mg/l", windows=3,
        remark="a power below one is better on the held-out part, worse on the untouched one",
    )  # fmt: skip


SHORT: Mapping[str, FoundSet] = {
    "gas_furnace": FoundSet(
        gas_furnace,
        "Box and Jenkins, Time Series Analysis (1970), series J; data/gas_furnace.csv of "
        "https://github.com/scalation/scalation2",
    ),
    "zigzag_boat": FoundSet(
        zigzag_boat,
        "data/01_raw/USV/zigzag_30_inter_xy.csv of https://github.com/martinlarsalbert/"
        "System-identification-of-Vessel-Manoeuvring-Models",
    ),
    "rc_ladder": FoundSet(
        rc_ladder,
        "csvs/ls_output_data.csv, its first 682 rows, of "
        "https://github.com/lorsi96/System-Identification-Control-for-RCRC-Circuit",
        aside=True,
    ),
    "cooling_cup": FoundSet(
        cooling_cup,
        "CoolingWater of R's mosaicData, also in https://github.com/vincentarelbundock/Rdatasets",
    ),
    "car_coast_down": FoundSet(
        car_coast_down,
        "Data/Michelin60*.csv of "
        "https://github.com/Abaiquni/Finding-Rolling-Resistance-for-Electric-Car",
    ),
    "air_chamber": FoundSet(
        air_chamber,
        "appendix_compressed-air_chamber/data/Ultimaker_020.csv, 4.5 to 40.1 s, of "
        "https://github.com/EvaZillen/3D-printed-pneumatic-actuator",
    ),
    "office_air": FoundSet(
        office_air,
        "Candanedo and Feldheim, Energy and Buildings 112 (2016) 28; parts of datatest.txt of "
        "https://github.com/ahmetaydin-aa/room-occupancy-detection",
        aside=True,
    ),
    "dye_reactor": FoundSet(
        dye_reactor,
        "Lab5-Reactor Characteristics/reactor data/1 CMFR.xls (text), from the pulse on, of "
        "https://github.com/rosiekrasnoff/CEE4530",
    ),
}
