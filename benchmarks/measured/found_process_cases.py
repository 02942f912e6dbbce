"""Public measured sets of heat, air and water, fitted by hand before discovery saw them.

As `found_cases`, all set aside: an incubator box with a heater, a house in winter, a lung on a
ventilator, a tank with a pump.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import eoi_jax as eoi
from benchmarks.measured.campaign_cases import Rig
from benchmarks.measured.found_sets import FoundSet, Runs, quarters, records, runs, table


def incubator(folder: Path) -> Rig:
    """A box of foam with a switched heater and a fan: one heat store."""

    def box(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.heating * u[0] - p.loss * (x.y[0] - u[1])

    plant = eoi.Plant(
        box, {"heating": 0.3, "loss": 1e-3}, relative_degree=1, inputs=("heater", "room"),
        outputs=("air",), units={"heater": "1", "room": "°C", "air": "°C", "loss": "1/s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("run_1", (0, 305)),),
        (("run_2", (0, 62)),),
        (("run_2", (62, 124)),),
    )
    return Rig(
        plant, runs(plant, folder / "incubator", parts),
        {"air": (3.77, 3.77)}, {"air": (0.155, 0.155)},
        ("second_node|actuator_lag|cells_in_series", "input_delay|sensor_lag"), "K", windows=1,
        remark="the heater is a store of its own (0.236), a delay of 3.6 s or a lag of the sensor",
    )  # fmt: skip


def winter_house(folder: Path) -> Rig:
    """A house with gas heating, hour by hour: one heat store, loss and sun."""

    def house(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.heating * u[0] - p.loss * (x.y[0] - u[1]) + p.window * u[2]

    plant = eoi.Plant(
        house, {"heating": 3e-4, "loss": 0.05, "window": 1e-3}, relative_degree=1,
        inputs=("heating", "outdoor", "solar"), outputs=("indoor",),
        units={"heating": "W", "outdoor": "°C", "solar": "W/m²", "indoor": "°C", "loss": "1/h"},
    )  # fmt: skip
    columns = table(folder / "winter_house/winter_house.csv")
    return Rig(
        plant, records(plant, columns, quarters(384), time_unit=3600.0),
        {"indoor": (1.90, 2.49)}, {"indoor": (1.56, 1.66)}, ("second_node",), "K", windows=4,
        remark="the walls are a store of their own; people live in the house",
    )  # fmt: skip


def lung_ventilator(folder: Path) -> Rig:
    """Airway pressure of a test lung behind the setpoint of a ventilator: one time constant."""

    def lung(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.rest + p.gain * u - x.y[0]) / p.lag

    plant = eoi.Plant(
        lung, {"rest": 0.0, "gain": 1.0, "lag": 0.5}, relative_degree=1, inputs=("setpoint",),
        outputs=("pressure",), bounds={"lag": (1e-3, np.inf)},
        units={"setpoint": "hPa", "pressure": "hPa", "rest": "hPa", "gain": "1", "lag": "s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("run_1", (0, 594)),),
        (("run_3", (0, 304)),),
        (("run_2", (0, 307)),),
    )
    return Rig(
        plant, runs(plant, folder / "lung_ventilator", parts),
        {"pressure": (0.755, 0.732)}, {"pressure": (0.578, 0.603)},
        ("input_rate|second_node", "input_delay"), "hPa", windows=2,
        remark="the pressure jumps with the valves, then follows; in and out differ (0.29)",
    )  # fmt: skip


def pumped_tank(folder: Path) -> Rig:
    """The level of a tank that a pump fills and that drains by its outlet: Torricelli."""

    def tank(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.gain * u[0] - p.outflow * jnp.sqrt(jnp.maximum(x.y[0], 0.0))

    plant = eoi.Plant(
        tank, {"gain": 0.02, "outflow": 0.15}, relative_degree=1, inputs=("flow",),
        outputs=("level",), units={"flow": "ml/s", "level": "cm", "gain": "1/cm²"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("run_1", (0, 175)),),
        (("run_1", (175, 265)),),
        (("run_1", (265, 354)),),
    )
    return Rig(
        plant, runs(plant, folder / "pumped_tank", parts),
        {"level": (1.417, 1.417)}, {"level": (0.357, 0.357)}, ("actuator_lag",), "cm", windows=1,
        remark="the pump lags, or has play, or a dead zone (0.198, refused by the held-out part)",
    )  # fmt: skip


PROCESS: Mapping[str, FoundSet] = {
    "incubator": FoundSet(
        incubator,
        "datasets/calibration_fan_12v/random_on_off_sequences.csv and ..._2.csv (rows 0 to 123) of "
        "https://github.com/INTO-CPS-Association/example_digital-twin_incubator",
        aside=True,
    ),
    "winter_house": FoundSet(
        winter_house,
        "data/LBORO.csv, rows 0 to 383, of https://github.com/srouchier/buildingenergygeeks",
        aside=True,
    ),
    "lung_ventilator": FoundSet(
        lung_ventilator,
        "sample-data/2020-05-14-pip15-peep5-rr12-ie23.csv and ...-pip25-peep10-... of "
        "https://github.com/RespiraWorks/Ventilator",
        aside=True,
    ),
    "pumped_tank": FoundSet(
        pumped_tank,
        "labo1/data/cl-3-1_ultimate.txt, 0 to 70.6 s, of https://github.com/anpar/autolin",
        aside=True,
    ),
}
