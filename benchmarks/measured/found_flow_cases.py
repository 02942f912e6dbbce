"""Public measured sets of processes, fitted by hand before discovery saw them.

As `found_kit_cases`, all set aside: a tank behind a valve, a river below power stations, a kiln
that warms up, aerosol in a room with an air cleaner, a lithium cell in pulses, a column of
activated carbon. Whole runs count, as there.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import eoi_jax as eoi
from benchmarks.measured.campaign_cases import Rig
from benchmarks.measured.found_sets import FoundSet, Runs, records, runs, table

_DAY = 86_400.0


def pilot_plant(folder: Path) -> Rig:
    """The level of a tank behind the signal of its valve: Torricelli's law."""

    def tank(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.inflow * (u - p.closed) - p.outflow * jnp.sqrt(jnp.maximum(x.y[0], 1e-6))

    plant = eoi.Plant(
        tank, {"inflow": 0.03, "outflow": 0.01, "closed": 3.0}, relative_degree=1,
        inputs=("valve",), outputs=("level",),
        units={"valve": "V", "level": "V", "inflow": "1/s", "outflow": "√V/s", "closed": "V"},
        kinds={"level": "level"},
    )  # fmt: skip
    columns = table(folder / "pilot_plant/pilot_plant.csv")
    parts = (((0, 273),), ((273, 410),), ((410, 547),))
    return Rig(
        plant, records(plant, columns, parts),
        {"level": (86.6, 86.6)}, {"level": (66.4, 66.4)}, (), "mV", 1e3, windows=1,
        remark="the valve has a play of 0.037 V to each side (72.2), no effect of the library; "
        "the outflow hardly grows with the level, or its zero is not that of the sensor (64.8)",
    )  # fmt: skip


def glacier_river(folder: Path) -> Rig:
    """A river below power stations, and the air over it: one heat store. Time in days."""

    def river(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.share * u[0] + p.base - x.y[0]) / p.tau

    plant = eoi.Plant(
        river, {"share": 0.25, "base": 4.5, "tau": 1.0}, relative_degree=1,
        inputs=("air", "discharge"), outputs=("water",), bounds={"tau": (0.1, np.inf)},
        units={"air": "°C", "discharge": "m³/s", "water": "°C", "share": "1", "base": "°C",
               "tau": "d"},
    )  # fmt: skip
    columns = table(folder / "glacier_river/glacier_river.csv")
    parts = (((0, 294),), ((294, 441),), ((441, 588),))
    return Rig(
        plant, records(plant, columns, parts, time_unit=_DAY),
        {"water": (1.286, 1.286)}, {"water": (0.765, 0.765)},
        ("product|parameter_dependence|input_modulation",), "K", windows=1,
        remark="the air counts less with more water, which is cold in summer (0.758, best there); "
        "the mean of the air over 12 days is better on the held-out part; weekends show",
    )  # fmt: skip


def warming_kiln(folder: Path) -> Rig:
    """A kiln that a constant power warms up: one heat store."""

    def kiln(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.gain * u - (x.y[0] - p.room) / p.tau

    plant = eoi.Plant(
        kiln, {"gain": 1e-4, "tau": 7000.0, "room": 25.0}, relative_degree=1,
        inputs=("heating",), outputs=("temperature",), fixed=("room",),
        bounds={"tau": (1.0, np.inf)},
        units={"heating": "ms", "temperature": "°C", "gain": "K/s/ms", "tau": "s", "room": "°C"},
    )  # fmt: skip
    columns = table(folder / "warming_kiln/kiln.csv")
    parts = (((0, 133),), ((133, 199),), ((199, 265),))
    return Rig(
        plant, records(plant, columns, parts),
        {"temperature": (2.334, 2.334)}, {"temperature": (1.575, 1.575)},
        ("second_node", "actuator_lag|sensor_lag|second_node"), "K", windows=1,
        remark="walls and radiation, by the held-out part (0.414, declared 1.89); walls and a lag "
        "of the element are as certain (0.167 on the estimation record, for 0.534) and reach 0.443",
    )  # fmt: skip


def smoky_room(folder: Path) -> Rig:
    """Particles in a room while an air cleaner runs: a loss in proportion."""

    def room(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, u
        return -p.rate * x.y[0]

    plant = eoi.Plant(
        room, {"rate": 0.025}, relative_degree=1, inputs=(), outputs=("particles",),
        units={"particles": "1/dl", "rate": "1/s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("run_b", (0, 108)),), (("run_a", (0, 115)),), (("run_c", (0, 98)),),
    )  # fmt: skip
    return Rig(
        plant, runs(plant, folder / "smoky_room", parts),
        {"particles": (511.5, 511.5)}, {"particles": (78.9, 78.9)},
        (("sensor_lag|second_node|actuator_lag|quadratic_drag|power_loss|product|curve|sensor_curve"
          "|saturating_loss"),), "1/dl", windows=1,
        remark="the decay starts slowly: counts that saturate, or a square in the loss (held out "
        "149, declared 478); a lag of 12 s of the sensor is nearly as good there (158), here 136",
    )  # fmt: skip


def pulsed_cell(folder: Path) -> Rig:
    """A lithium cell in pulses: a capacitor; the ohmic drop is taken off the output."""

    def cell(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, x
        return u / p.capacity

    plant = eoi.Plant(
        cell, {"capacity": 1.5}, relative_degree=1, inputs=("current",), outputs=("voltage",),
        bounds={"capacity": (1e-2, np.inf)},
        units={"current": "A", "voltage": "mV", "capacity": "kF"},
    )  # fmt: skip

    def pulses(name: str) -> eoi.Record:
        columns = table(folder / f"pulsed_cell/{name}.csv")
        less_drop = 1e3 * (columns["voltage"] - 0.0296 * columns["current"])
        return eoi.Record(
            columns["time"], columns["current"], less_drop, name, input_names=plant.inputs,
            output_names=plant.outputs, units={"current": "A", "voltage": "mV"},
        )  # fmt: skip

    return Rig(
        plant, ((pulses("cell2_2C"),), (pulses("cell2_1C"),), (pulses("cell3_2C"),)),
        {"voltage": (23.88, 23.88)}, {"voltage": (6.59, 6.59)}, ("second_node",), "mV", windows=1,
        remark="two more stores by the held-out part (0.674, one: 1.187, none: 10.7); on the "
        "other cell one is better (1.84): three initial values from the head are too many",
    )  # fmt: skip


def carbon_column(folder: Path) -> Rig:
    """Dye behind a column of sand and activated carbon, from its breakthrough on: a mixed cell."""

    def column(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return u / p.volume * (p.feed - x.y[0])

    plant = eoi.Plant(
        column, {"volume": 800.0, "feed": 50.0}, relative_degree=1, inputs=("flow",),
        outputs=("dye",), fixed=("feed",), bounds={"volume": (1.0, np.inf)},
        units={"flow": "ml/s", "dye": "mg/l", "volume": "ml", "feed": "mg/l"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("rpm_15", (40, 134)), ("rpm_45", (10, 40))), (("rpm_30", (7, 62)),),
        (("rpm_20", (24, 94)),),
    )  # fmt: skip
    return Rig(
        plant, runs(plant, folder / "carbon_column", parts),
        {"dye": (0.933, 0.933)}, {"dye": (0.273, 0.273)},
        ("cells_in_series|second_node|actuator_lag|sensor_lag",
         "leak|constant_offset|power_loss|curve"), "mg/l", windows=1,
        remark="two cells with uptake; cells alone 0.447; held out 6.33, 2.27, with uptake 0.309",
    )  # fmt: skip


FLOWS: Mapping[str, FoundSet] = {
    "pilot_plant": FoundSet(
        pilot_plant,
        "examples/pilot_plant_example/raw_data/test_set.csv, every 4th row of 0 to 2184 s, of "
        "https://github.com/antonior92/ParallelTrainingNN.jl",
        aside=True,
    ),
    "glacier_river": FoundSet(
        glacier_river,
        "Switzerland/SIO_2011_cv.txt (the Rhone at Sion), 2005-01-01 to 2006-08-11, of "
        "https://github.com/marcotoffolon/air2stream",
        aside=True,
    ),
    "warming_kiln": FoundSet(
        warming_kiln,
        "dacb_kiln.tsv, every 12th row of 18793.475 to 34636.744 s, of "
        "https://github.com/beckdac/qtkiln",
        aside=True,
    ),
    "smoky_room": FoundSet(
        smoky_room,
        "data/20220705a, 20220705b and 20220707c_Levoit400s_4_spd.csv, column >0.5, every second "
        "row from 217.05, 295.18 and 229.15 s on, of https://github.com/robwiss/analyze_cadr",
        aside=True,
    ),
    "pulsed_cell": FoundSet(
        pulsed_cell,
        "data/HPPC-for-electrothermal-neural-net/DNN02_HPPC_2C, DNN02_HPPC_1C and DNN03_HPPC_2C, "
        "_20amb_processed_scrubbed.csv, first 358 rows, one a second, of https://github.com/"
        "ARTS-Laboratory/dataset-electrothermal-deformation-characterization-for-samsung-30Q-cell",
        aside=True,
    ),
    "carbon_column": FoundSet(
        carbon_column,
        "Project/Data/8gac_90gsand_15rpm_1_layer_trial1.xls and 20rpm (every second row), 30rpm "
        "(second start) and 45rpm, from the start on, with metadata.txt, of "
        "https://github.com/jacqueline-wong/CEE4530",
        aside=True,
    ),
}
