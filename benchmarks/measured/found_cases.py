"""Public measured sets, fitted by hand before discovery saw them: models, errors.

The files are not part of the repository (`found_sets`). Figures are those of `campaign_cases`: root
mean squares of whole free runs and of runs that start again ten times a record, on the part that
chose nothing. Eight more, of short records, stand in `found_short_cases`, eight of driven and
swinging rigs in `found_driven_cases`, eight that are all set aside in `found_late_cases`, eleven
more in `found_fresh_cases`, seven in `found_newest_cases`, four in `found_latest_cases`, five
with motors in `found_mechanical_cases`, and four in `found_process_cases`.

Six of the first thirteen cases are set aside (`aside`), to be opened once, at the end. They were
drawn by `random.Random(20261127).sample(sorted(FIRST), 6)`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.signal import savgol_filter

import eoi_jax as eoi
from benchmarks.measured.campaign_cases import Rig
from benchmarks.measured.found_actuated_cases import ACTUATED
from benchmarks.measured.found_assorted_cases import ASSORTED
from benchmarks.measured.found_blind_cases import BLIND
from benchmarks.measured.found_cooling_cases import COOLERS
from benchmarks.measured.found_driven_cases import DRIVEN
from benchmarks.measured.found_far_cases import FAR
from benchmarks.measured.found_field_cases import FIELD
from benchmarks.measured.found_flow_cases import FLOWS
from benchmarks.measured.found_fresh_cases import FRESH
from benchmarks.measured.found_heated_cases import HEATED
from benchmarks.measured.found_joint_cases import JOINTS
from benchmarks.measured.found_kit_cases import KITS
from benchmarks.measured.found_late_cases import LATE
from benchmarks.measured.found_latest_cases import LATEST
from benchmarks.measured.found_machine_cases import MACHINES
from benchmarks.measured.found_mechanical_cases import MECHANICAL
from benchmarks.measured.found_mixed_cases import MIXED
from benchmarks.measured.found_motion_cases import MOTIONS
from benchmarks.measured.found_newest_cases import NEWEST
from benchmarks.measured.found_process_cases import PROCESS
from benchmarks.measured.found_robot_cases import ROBOTS
from benchmarks.measured.found_sets import FoundSet, quarters, records, table
from benchmarks.measured.found_short_cases import SHORT
from benchmarks.measured.found_wide_cases import WIDE


def motor_generator(folder: Path) -> Rig:
    """Two coupled DC motors: first order from the voltage to the speed. Every 50th sample."""
    columns = table(folder / "motor_generator/motor_generator.csv")
    columns = {"time": columns["sample"], "voltage": columns["voltage"], "speed": columns["speed"]}
    columns = {name: column[::50] for name, column in columns.items()}

    def motor(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.gain * u - x.y[0]) / p.tau

    plant = eoi.Plant(
        motor, {"gain": 1000.0, "tau": 2.0}, relative_degree=1, inputs=("voltage",),
        outputs=("speed",), bounds={"tau": (1e-2, np.inf)},
        units={"voltage": "V", "speed": "1/min", "gain": "1/min/V"},
    )  # fmt: skip
    return Rig(
        plant, records(plant, columns, quarters(10000), 1000.0),
        {"speed": (1138.0, 906.0)}, {"speed": (77.0, 75.6)},
        ("product", "actuator_lag", "coulomb_friction"), "1/min",
        remark="time in thousands of samples: the sampling rate is not published",
    )  # fmt: skip


def building_hourly(folder: Path) -> Rig:
    """One heat store, losses to the outdoor air; a month of hours."""
    columns = table(folder / "building_hourly/building_hourly.csv")

    def building(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (u[1] - x.y[0]) / p.tau + p.heat * u[0]

    plant = eoi.Plant(
        building, {"tau": 60.0, "heat": 0.01}, relative_degree=1, inputs=("heating", "ambient"),
        outputs=("indoor",), bounds={"tau": (1e-2, np.inf)},
        units={"heating": "kW", "ambient": "K", "indoor": "K", "tau": "h", "heat": "K/h/kW"},
    )  # fmt: skip
    return Rig(
        plant, records(plant, columns, quarters(792), 3600.0),
        {"indoor": (0.710, 0.700)}, {"indoor": (0.254, 0.594)}, ("second_node",), "K",
        remark="time in hours",
    )  # fmt: skip


def _collectors(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
    del t
    irradiance, flow, inlet, ambient = u
    return (
        p.gain * irradiance
        - p.exchange * flow * (x.y[0] - inlet)
        - p.loss * (x.y[0] - ambient)
    )  # fmt: skip


def _collector_plant(nominal: Mapping[str, float], flow: str, temperature: str) -> eoi.Plant:
    return eoi.Plant(
        _collectors, nominal, relative_degree=1,
        inputs=("irradiance", "flow", "inlet", "ambient"), outputs=("outlet",),
        units={"irradiance": "W/m²", "flow": flow, "inlet": temperature, "ambient": temperature,
               "outlet": temperature},
    )  # fmt: skip


def solar_array_graz(folder: Path) -> Rig:
    """Flat collectors as one well mixed volume, while the pump runs; eight days of May."""
    columns = dict(table(folder / "solar_array_graz/solar_array_graz.csv"))
    columns["flow"] = 1000.0 * columns["flow"]
    plant = _collector_plant({"gain": 0.008, "exchange": 0.08, "loss": 0.03}, "l/s", "K")
    parts = (
        ((1893, 2415), (10598, 11081), (16305, 16828)),
        ((26343, 26964), (30666, 31279)),
        ((36480, 37043), (39298, 39926), (40746, 41368)),
    )
    return Rig(
        plant, records(plant, columns, parts, 60.0),
        {"outlet": (1.61, 2.24)}, {"outlet": (1.61, 2.24)}, (), "K",
        remark="time in minutes; cells in series improve the estimation part only",
    )  # fmt: skip


def solar_field_condat(folder: Path) -> Rig:
    """Tracking collectors as one well mixed volume, while the pump runs; eight days of May."""
    columns = table(folder / "solar_field_condat/solar_field_condat.csv")
    plant = _collector_plant({"gain": 0.003, "exchange": 0.001, "loss": 0.008}, "m³/h", "°C")
    parts = (
        ((20556, 21302), (24859, 25437), (30567, 31402)),
        ((34840, 35723), (39159, 39903)),
        ((40598, 41345), (42037, 42918), (43474, 44232)),
    )
    return Rig(
        plant, records(plant, columns, parts, 60.0),
        {"outlet": (6.86, 7.96)}, {"outlet": (5.99, 6.69)}, (), "K",
        remark="time in minutes; cells in series and a pipe behind them are doubtful",
    )  # fmt: skip


def catchment_fulda(folder: Path) -> Rig:
    """A linear reservoir from the rain to the discharge; ten years of days."""
    columns = table(folder / "catchment_fulda/catchment_fulda.csv")

    def reservoir(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.runoff * u[0] + p.base - x.y[0]) / p.tau

    plant = eoi.Plant(
        reservoir, {"runoff": 10.0, "tau": 4.0, "base": 10.0}, relative_degree=1,
        inputs=("rain", "temperature"), outputs=("discharge",), bounds={"tau": (1e-2, np.inf)},
        units={"rain": "mm/d", "temperature": "°C", "discharge": "m³/s", "tau": "d"},
    )  # fmt: skip
    return Rig(
        plant, records(plant, columns, quarters(3653)),
        {"discharge": (28.6, 29.4)}, {"discharge": (13.4, 13.4)},
        ("moisture of the soil times rain|product", "snow"), "m³/s", remark="time in days",
    )  # fmt: skip


def catchment_small(folder: Path) -> Rig:
    """A linear reservoir from rain less evaporation to the discharge; four years of days."""
    columns = table(folder / "catchment_small/catchment_small.csv")

    def reservoir(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.runoff * (u[0] - u[1]) + p.base - x.y[0]) / p.tau

    plant = eoi.Plant(
        reservoir, {"runoff": 5.0, "tau": 5.0, "base": 5.0}, relative_degree=1,
        inputs=("rain", "evaporation"), outputs=("discharge",), bounds={"tau": (1e-2, np.inf)},
        units={"rain": "mm/d", "evaporation": "mm/d", "discharge": "l/s", "tau": "d"},
    )  # fmt: skip
    return Rig(
        plant, records(plant, columns, quarters(1827, first=366)),
        {"discharge": (10.7, 11.2)}, {"discharge": (6.55, 7.53)},
        ("moisture of the soil times rain|product",), "l/s", remark="time in days",
    )  # fmt: skip


def soil_moisture(folder: Path) -> Rig:
    """Water in the upper 10 cm: rain in, drainage and evaporation out; three years of hours."""
    columns = dict(table(folder / "soil_moisture/soil_moisture.csv"))
    columns["moisture"] = 100.0 * columns["moisture_10cm"]

    def soil(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        rain, radiation = u
        return p.wetting * rain - p.drainage * (x.y[0] - p.rest) - p.evaporation * radiation / 1e3

    plant = eoi.Plant(
        soil, {"wetting": 1e-3, "drainage": 1e-3, "rest": 24.0, "evaporation": 0.05},
        relative_degree=1, inputs=("rain", "radiation"), outputs=("moisture",),
        units={"rain": "mm/d", "radiation": "W/m²", "moisture": "%", "rest": "%"},
    )  # fmt: skip
    return Rig(
        plant, records(plant, columns, quarters(26304)),
        {"moisture": (2.08, 1.89)}, {"moisture": (1.85, 1.56)}, (), "%",
        remark="time in hours; that full soil takes no more rain is doubtful",
    )  # fmt: skip


def cycling_ride_heart(folder: Path) -> Rig:
    """Heart rate of a rider, first order from the power at the pedals."""
    columns = table(folder / "cycling_ride/cycling_ride.csv")

    def heart(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.rest + p.gain * u - x.y[0]) / p.tau

    plant = eoi.Plant(
        heart, {"rest": 100.0, "gain": 0.3, "tau": 60.0}, relative_degree=1, inputs=("power",),
        outputs=("heart_rate",), bounds={"tau": (1e-1, np.inf)},
        units={"power": "W", "heart_rate": "1/min", "tau": "s", "rest": "1/min"},
    )  # fmt: skip
    return Rig(
        plant, records(plant, columns, quarters(8357)),
        {"heart_rate": (7.17, 6.47)}, {"heart_rate": (5.30, 4.55)}, (), "1/min",
        remark="faster up than down, with a curve of the power: likely, not certain",
    )  # fmt: skip


def cycling_ride_speed(folder: Path) -> Rig:
    """Speed of a bicycle from power and slope, with rolling resistance; where the rider pedals."""
    columns = dict(table(folder / "cycling_ride/cycling_ride.csv"))
    climb, way = (savgol_filter(columns[name], 31, 2, deriv=1) for name in ("altitude", "distance"))
    columns["slope"] = np.clip(np.asarray(climb) / np.maximum(np.asarray(way), 1.0), -0.15, 0.15)

    def bicycle(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        power, slope = u
        return power / (p.mass * jnp.maximum(x.y[0], 1.5)) - 9.81 * slope - p.rolling

    plant = eoi.Plant(
        bicycle, {"mass": 80.0, "rolling": 0.1}, relative_degree=1, inputs=("power", "slope"),
        outputs=("speed",), bounds={"mass": (1.0, np.inf)},
        units={"power": "W", "slope": "1", "speed": "m/s", "mass": "kg", "rolling": "m/s²"},
    )  # fmt: skip
    parts = (((257, 2121), (2870, 4209)), ((4550, 5987),), ((6341, 7138), (7527, 8107)))
    return Rig(
        plant, records(plant, columns, parts),
        {"speed": (0.681, 0.728)}, {"speed": (0.469, 0.524)},
        ("quadratic_drag|viscous_friction",), "m/s",
    )  # fmt: skip


def global_temperature(folder: Path) -> Rig:
    """Energy balance of the Earth with one heat capacity; 139 years."""
    columns = table(folder / "global_temperature/global_temperature.csv")

    def earth(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (u - p.feedback * (x.y[0] - p.zero)) / p.capacity

    plant = eoi.Plant(
        earth, {"capacity": 10.0, "feedback": 1.5, "zero": -0.3}, relative_degree=1,
        inputs=("forcing",), outputs=("temperature",), bounds={"capacity": (0.1, np.inf)},
        units={"forcing": "W/m²", "temperature": "K", "capacity": "W a/m²/K",
               "feedback": "W/m²/K", "zero": "K"},
    )  # fmt: skip
    return Rig(
        plant, records(plant, columns, (((0, 90),), ((90, 115),), ((115, 139),))),
        {"temperature": (0.0875, 0.0875)}, {"temperature": (0.0875, 0.0875)}, (), "K", windows=1,
        remark="time in years; too short for windows",
    )  # fmt: skip


def indomethacin(folder: Path) -> Rig:
    """Concentration in the blood after an injection: one compartment; six persons."""

    def body(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, u
        return -p.elimination * x.y[0]

    plant = eoi.Plant(
        body, {"elimination": 1.0}, relative_degree=1, inputs=(), outputs=("concentration",),
        units={"concentration": "mg/l", "elimination": "1/h"},
    )  # fmt: skip

    def person(number: int) -> eoi.Record:
        columns = table(folder / f"indomethacin/subject_{number}.csv")
        places = np.rint(columns["time"] / 0.25).astype(int) - 1
        concentration = np.full(places[-1] + 1, np.nan)
        concentration[places] = columns["concentration"]
        time = 0.25 * np.arange(1, len(concentration) + 1)
        return eoi.Record(
            time, np.zeros((len(time), 0)), concentration, f"person {number}",
            output_names=plant.outputs, units={"concentration": "mg/l"},
        )  # fmt: skip

    persons = tuple(person(number) for number in range(1, 7))
    return Rig(
        plant, (persons[:3], persons[3:4], persons[4:]),
        {"concentration": (0.114, 0.114)}, {"concentration": (0.0363, 0.0363)},
        ("second_node|quadratic_drag|constant_offset",), "mg/l", windows=1,
        remark="time in hours; too short for windows",
    )  # fmt: skip


def fork_pendulum(folder: Path) -> Rig:
    """A bicycle's fork swings as a pendulum; the output is that of a rate gyro."""
    columns = table(folder / "fork_pendulum/fork_pendulum.csv")

    def fork(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, u
        return -p.stiffness * (x.y[0] - p.zero) - p.damping * x.y[1]

    plant = eoi.Plant(
        fork, {"stiffness": 20.0, "damping": 0.05, "zero": 1.4}, relative_degree=2, inputs=(),
        outputs=("rate",),
        units={"rate": "V", "stiffness": "1/s²", "damping": "1/s", "zero": "V"},
    )  # fmt: skip
    return Rig(
        plant, records(plant, columns, quarters(30000)),
        {"rate": (29.1, 22.0)}, {"rate": (29.1, 22.0)}, (), "mV", 1e3,
        remark="a softer spring helps one part, another damping the other: nothing is certain",
    )  # fmt: skip


def coin_cell(folder: Path) -> Rig:
    """A lithium coin cell in pulses: a capacitor; the ohmic drop is taken off the output."""
    columns = table(folder / "coin_cell/coin_cell.csv")

    def cell(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, x
        return u / p.capacity

    plant = eoi.Plant(
        cell, {"capacity": 5.0}, relative_degree=1, inputs=("current",), outputs=("voltage",),
        bounds={"capacity": (1e-3, np.inf)},
        units={"current": "mA", "voltage": "mV", "capacity": "F"},
    )  # fmt: skip

    def pulses(number: int) -> eoi.Record:
        """Pulses of a cycle, every 0.1 s; of two samples 1 ms apart, at a jump, the later one."""
        rows = slice(830 + 1674 * number, 2036 + 1674 * number)
        time, current, voltage = (columns[name][rows] for name in ("time", "current", "voltage"))
        kept = np.append(np.diff(time) > 0.05, True)
        current = current[kept]
        less_drop = 1e3 * (voltage[kept] - 0.018 * current)
        return eoi.Record(
            0.1 * np.arange(len(current)), current, less_drop, f"cycle {number}",
            input_names=plant.inputs, output_names=plant.outputs,
            units={"current": "mA", "voltage": "mV"},
        )  # fmt: skip

    parts = tuple(tuple(map(pulses, part)) for part in ((0, 2, 4, 6), (1, 5), (3, 7)))
    return Rig(
        plant, (parts[0], parts[1], parts[2]),
        {"voltage": (15.8, 4.96)}, {"voltage": (7.99, 5.00)}, ("second_node",), "mV",
    )  # fmt: skip


_SPOTPY = "Copied from the examples of spotpy: https://github.com/thouska/spotpy"
_SUNPEEK = "Sample of SunPeek, https://gitlab.com/sunpeek/sunpeek"
_RIDE = "Ride 4078723797 of the examples of sweat: https://github.com/GoldenCheetah/sweatpy"

FIRST: Mapping[str, FoundSet] = {
    "motor_generator": FoundSet(
        motor_generator,
        "Lacerda and others, identification of a DC motor and generator (in Portuguese), "
        "x_cc.csv and y_cc.csv of https://github.com/wilsonrljr/sysidentpy (examples/datasets)",
        aside=True,
    ),
    "building_hourly": FoundSet(
        building_hourly,
        "Demo data of a real building: https://github.com/czagoni/darkgreybox "
        "(docs/tutorials/data/demo_data.csv)",
    ),
    "solar_array_graz": FoundSet(
        solar_array_graz,
        f"Array Arcon South, district heating of Graz: https://zenodo.org/records/7741084; "
        f"{_SUNPEEK}",
    ),
    "solar_field_condat": FoundSet(
        solar_field_condat,
        f"Solar plant of a paper mill at Condat: https://zenodo.org/records/18800051; {_SUNPEEK}",
    ),
    "catchment_fulda": FoundSet(
        catchment_fulda, f"River Fulda, weather and discharge 1979 to 1988. {_SPOTPY}"
    ),
    "catchment_small": FoundSet(
        catchment_small,
        f"A catchment of 1.783 km², 2013 to 2016. {_SPOTPY}",
    ),
    "soil_moisture": FoundSet(
        soil_moisture,
        f"Site 24, Vollnkirchener Bach, University of Giessen, 2014 to 2016. {_SPOTPY}",
        aside=True,
    ),
    "cycling_ride, heart": FoundSet(cycling_ride_heart, _RIDE),
    "cycling_ride, speed": FoundSet(cycling_ride_speed, _RIDE),
    "global_temperature": FoundSet(
        global_temperature,
        "Temperature: NOAA, as temp_carbon of https://github.com/rafalab/dslabs; forcing: RCP6 "
        "with volcanoes, as in https://github.com/OMS-NetZero/FAIR (version 1.6.4)",
    ),
    "indomethacin": FoundSet(
        indomethacin,
        "Kwan and others, J. Pharmacokin. Biopharm. 4 (1976) 255; Indometh of R's datasets, also "
        "in https://github.com/vincentarelbundock/Rdatasets",
        aside=True,
    ),
    "coin_cell": FoundSet(
        coin_cell,
        "Pulse test hppc_discharge.csv of https://github.com/NatLabRockies/ampworks (datasets)",
    ),
    "fork_pendulum": FoundSet(
        fork_pendulum,
        "BrowserForkCompoundFirst1.mat of https://github.com/moorepants/BicycleParameters (tests)",
    ),
}
FOUND: Mapping[str, FoundSet] = {
    **FIRST,
    **SHORT,
    **DRIVEN,
    **LATE,
    **FRESH,
    **NEWEST,
    **LATEST,
    **MECHANICAL,
    **PROCESS,
    **BLIND,
    **MIXED,
    **KITS,
    **MACHINES,
    **FLOWS,
    **ROBOTS,
    **MOTIONS,
    **COOLERS,
    **ACTUATED,
    **HEATED,
    **FIELD,
    **JOINTS,
    **FAR,
    **WIDE,
    **ASSORTED,
}
