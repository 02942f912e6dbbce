"""Public measured sets of a crane, an autoclave, a diver, a battery, a muscle, a heater.

As `found_heated_cases`, all set aside and fitted by hand before discovery saw them: the trolley
and the swinging load of a crane, the temperature of a nylon autoclave, the pressure in the tank of
a diver, the battery of an electric car on the road, the oxygen in the muscle of a cyclist, two
hydraulic cylinders, a small heater.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import eoi_jax as eoi
from benchmarks.measured.campaign_cases import Rig
from benchmarks.measured.found_sets import FoundSet, Runs, records, runs, table

_MINUTE = 60.0


def crane_trolley(folder: Path) -> Rig:
    """Position of the trolley of a gantry crane behind a noisy duty ratio: it starts and stops."""

    def trolley(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.gain * u[0] - x.y[1]) / p.tau

    plant = eoi.Plant(
        trolley, {"gain": 0.4, "tau": 0.3}, relative_degree=2, inputs=("duty", "sway"),
        outputs=("trolley",), bounds={"tau": (5e-3, 100.0)},
        units={"duty": "1", "sway": "°", "trolley": "mm", "gain": "mm/s", "tau": "s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("run_424", (0, 150)),), (("run_374", (0, 80)),), (("run_374", (80, 150)),)
    )  # fmt: skip
    return Rig(
        plant, runs(plant, folder / "crane_trolley", parts),
        {"trolley": (43.41, 43.41)}, {"trolley": (32.45, 32.45)}, (), "mm", windows=1,
        remark="the held-out part, a start, would choose a force with the position (12.6, declared "
        "18.6), which is no law: the other run starts faster. Dry friction, which stops it "
        "within 0.14 s, is 33.1 there, but 3.4 for 53.0 where it was fitted and 6.59 here, with "
        "Stribeck's law 2.5, 27.0 and 5.43, a force with the sway beside it no more",
    )  # fmt: skip


def crane_sway(folder: Path) -> Rig:
    """Sway of the load of a gantry crane behind the acceleration of its trolley, two lengths."""

    def load(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        acceleration, cable = u[0], u[1]
        drive = 57.2958 * p.gain * acceleration - 9.81 * x.y[0]
        return drive / cable - p.damping * x.y[1]

    plant = eoi.Plant(
        load, {"gain": 1.0, "damping": 0.1}, relative_degree=2,
        inputs=("acceleration", "cable"), outputs=("sway",),
        units={"acceleration": "m/s²", "cable": "m", "sway": "°", "gain": "1", "damping": "1/s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("run_424", (0, 204)),), (("run_374", (0, 80)),), (("run_374", (80, 167)),)
    )  # fmt: skip
    return Rig(
        plant, runs(plant, folder / "crane_sway", parts),
        {"sway": (2.919, 2.919)}, {"sway": (1.631, 1.631)},
        ("input_delay|sensor_lag|actuator_lag",), "°", windows=1,
        remark="the camera is late: a delay of 0.105 s held out 0.238 for 0.460, a lag 0.237 (here "
        "1.945); with a spring (the pendulum is shorter than the cable) a delay of 0.164 s, 0.245 "
        "for 0.677 where it was fitted, held out 0.294, here 1.057; an offset, drag, dry friction, "
        "a cubic spring nothing",
    )  # fmt: skip


def nylon_autoclave(folder: Path) -> Rig:
    """Temperature of a nylon autoclave in its jacket, in scaled units and samples, 12 batches."""

    def autoclave(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (u[0] - x.y[0]) / p.tau

    plant = eoi.Plant(
        autoclave, {"tau": 60.0}, relative_degree=1, inputs=("jacket", "pressure"),
        outputs=("reactor",), bounds={"tau": (1.0, np.inf)},
        units={"jacket": "1", "pressure": "1", "reactor": "1", "tau": "s"},
    )  # fmt: skip
    lengths = (114, 115, 116, 115, 116, 114, 117, 114, 117, 117, 118, 119)
    batches: Runs = tuple((f"batch_{k}", (0, rows)) for k, rows in enumerate(lengths, 1))
    parts: tuple[Runs, Runs, Runs] = (batches[:6], batches[6:9], batches[9:])
    return Rig(
        plant, runs(plant, folder / "nylon_autoclave", parts),
        {"reactor": (1.851, 1.851)}, {"reactor": (0.439, 0.439)},
        ("input_action|parameter_dependence|product", "constant_offset"), "1", windows=1,
        remark="water boils off under a pressure that is let off: pressure, pressure times "
        "temperature, rate of the pressure and an offset held out 0.486 for 1.753 (the jacket then "
        "does nothing), without the rate 0.575 (here 0.540), a transfer that grows with the "
        "pressure and an offset 0.588 (here 0.522), pressure and its rate with an offset 0.660 "
        "(here 0.711), an offset and the rate 0.803, pressure alone 1.026, an offset alone 1.325, "
        "a second store 1.284, a delay none",
    )  # fmt: skip


def scuba_tank(folder: Path) -> Rig:
    """Pressure in the tank of a diver, in minutes, behind the depth: as much as the air weighs."""

    def tank(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, x
        return -p.use * (1.0 + u / 10.0)

    plant = eoi.Plant(
        tank, {"use": 2.0}, relative_degree=1, inputs=("depth",), outputs=("pressure",),
        units={"depth": "m", "pressure": "bar", "use": "bar/min"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("dive_150", (0, 85)),), (("dive_100", (0, 69)),), (("dive_150", (85, 142)),)
    )  # fmt: skip
    return Rig(
        plant, runs(plant, folder / "scuba_tank", parts, _MINUTE),
        {"pressure": (5.158, 5.158)}, {"pressure": (5.001, 5.001)}, (), "bar", windows=1,
        remark="nothing is certain, he breathes as he likes: the square of the depth held out 2.03 "
        "for 2.95, a leak 2.41 (here 4.29), a lag 2.63, an offset 3.67, a delay 3.79; a drift, "
        "0.64 for 3.02 where it was fitted, 13.6 (here 28.6); the transmitter sticks at times",
    )  # fmt: skip


def ev_battery(folder: Path) -> Rig:
    """Voltage of the battery of an electric car on the road, less the ohmic drop."""

    def battery(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.rest - p.resistance * u[0] - x.y[0]) / p.tau

    plant = eoi.Plant(
        battery, {"rest": 417.0, "resistance": 0.05, "tau": 20.0}, relative_degree=1,
        inputs=("current",), outputs=("voltage",), bounds={"tau": (0.3, np.inf)},
        units={"current": "A", "voltage": "V", "rest": "V", "resistance": "Ohm", "tau": "s"},
    )  # fmt: skip
    columns = table(folder / "ev_battery/drive.csv")
    parts = (((0, 76),), ((76, 114),), ((114, 151),))
    return Rig(
        plant, records(plant, columns, parts),
        {"voltage": (0.3635, 0.3635)}, {"voltage": (0.1194, 0.1194)},
        ("second_node", "input_rate"), "V", windows=1,
        remark="a second store, and what is left of the ohmic drop, held out 0.259 for 0.537, the "
        "store alone 0.312 (here 0.212), a current that counts otherwise each way 0.328 (here "
        "0.275), the rate of the current alone 0.521 (here 0.399); a drift 0.678 (here 1.76), a "
        "delay, the square of the current, a bent voltage nothing",
    )  # fmt: skip


def muscle_oxygen(folder: Path) -> Rig:
    """Oxygen saturation in the muscle of a cyclist behind his power: one time constant."""

    def muscle(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.rest - p.gain * u[0] - x.y[0]) / p.tau

    plant = eoi.Plant(
        muscle, {"rest": 65.0, "gain": 0.18, "tau": 10.0}, relative_degree=1, inputs=("power",),
        outputs=("saturation",), bounds={"rest": (0.0, 200.0), "gain": (0.0, np.inf),
        "tau": (0.5, 500.0)},
        units={"power": "W", "saturation": "%", "rest": "%", "gain": "%/W", "tau": "s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("start", (0, 100)),), (("step_170", (0, 102)),), (("step_195", (0, 100)),)
    )  # fmt: skip
    return Rig(
        plant, runs(plant, folder / "muscle_oxygen", parts),
        {"saturation": (6.133, 6.133)}, {"saturation": (6.133, 6.133)}, (), "%", windows=1,
        remark="nothing by the held-out step, where the declared model, whose gain its fit makes "
        "none, is best (2.36); an overshoot of 41 s (relaxation) with a lag of 7 s is 2.47 there, "
        "but 1.15 for 2.73 where it was fitted and 2.15 here, the overshoot alone 2.49, 1.23 and "
        "3.42; a lag alone 4.16 (here 3.48), a delay 5.15, a drift 14.9, a second store 14.0",
    )  # fmt: skip


def hydraulic_cylinders(folder: Path) -> Rig:
    """Two hydraulic cylinders of one supply behind their targets, faster than the samples."""

    def cylinders(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return jnp.stack((
            (p.gain_0 * u[0] - x.y[0, 0]) / p.tau_0, (p.gain_1 * u[1] - x.y[0, 1]) / p.tau_1
        ))  # fmt: skip

    plant = eoi.Plant(
        cylinders, {"gain_0": 1.0, "tau_0": 0.1, "gain_1": 1.0, "tau_1": 0.1}, relative_degree=1,
        inputs=("target_0", "target_1"), outputs=("cylinder_0", "cylinder_1"),
        bounds={"tau_0": (0.02, np.inf), "tau_1": (0.02, np.inf)},
        units={"target_0": "V", "target_1": "V", "cylinder_0": "V", "cylinder_1": "V",
               "gain_0": "1", "gain_1": "1", "tau_0": "s", "tau_1": "s"},
    )  # fmt: skip
    columns = table(folder / "hydraulic_cylinders/steps.csv")
    parts = (((0, 210),), ((210, 310),), ((310, 423),))
    return Rig(
        plant, records(plant, columns, parts),
        {"cylinder_0": (0.1015, 0.1015), "cylinder_1": (0.2125, 0.2125)},
        {"cylinder_0": (0.1015, 0.1015), "cylinder_1": (0.2035, 0.2035)}, (), "V", windows=1,
        remark="needs nothing: an offset of the second held out 0.165 for 0.172, of the first "
        "0.143 for 0.114; coupling, second stores, a curve, a rate limit, a drift no better; moves "
        "are over within a sample or two, and the second creeps",
    )  # fmt: skip


def pid_heater(folder: Path) -> Rig:
    """Temperature of a small heater behind the output of its controller, started cold and warm."""

    def heater(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.ambient + p.gain * u - x.y[0]) / p.tau

    plant = eoi.Plant(
        heater, {"ambient": 25.0, "gain": 110.0, "tau": 30.0}, relative_degree=1,
        inputs=("drive",), outputs=("temperature",),
        bounds={"ambient": (0.0, 60.0), "gain": (0.0, np.inf), "tau": (0.5, np.inf)},
        units={"drive": "1", "temperature": "°C", "ambient": "°C", "gain": "K", "tau": "s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("cold", (0, 137)), ("warm_107", (0, 101))), (("warm_127", (0, 67)),),
        (("warm_110", (0, 44)),),
    )  # fmt: skip
    return Rig(
        plant, runs(plant, folder / "pid_heater", parts),
        {"temperature": (2.645, 2.645)}, {"temperature": (0.308, 0.308)},
        ("second_node", "sensor_lag|actuator_lag|input_delay", "input_curve|input_quadratic"), "°C",
        windows=1,
        remark="a second store, a lag and a power (2.5) of the drive held out 0.259 for 1.401, "
        "without the power 0.321 (here 0.904), two second stores 0.676 (here 0.702), a slow one "
        "and a lag 0.682 (here 0.861), a store and a drift 0.824 (here 2.47), a drift 0.820 (here "
        "3.70); a lag alone 1.80, a store alone 1.85, a delay 1.71, the power alone 1.96: no "
        "better. Parts were changed once: the cold run alone does not identify it (its fit's gain "
        "is negative)",
    )  # fmt: skip


_CRANE = (
    "of https://github.com/Cristian-Napitupulu/gantry_crane_ws (PlotJuggler/Step response 700 with "
    "random.csv, 1.20 to 8.00 s after 1717494492, and ... v1.csv, 0.67 to 6.22 s after 1717493135, "
    "on a grid of 1/30 s)"
)
FAR: Mapping[str, FoundSet] = {
    "crane_trolley": FoundSet(
        crane_trolley,
        "hoist_motor_voltage (which is the duty of the trolley), sway_angle and trolley_position, "
        f"{_CRANE}",
        aside=True,
    ),
    "crane_sway": FoundSet(
        crane_sway,
        "second derivative of trolley_position (Savitzky-Golay, 7 rows), cable_length (its mean) "
        f"and sway_angle, {_CRANE}",
        aside=True,
    ),
    "nylon_autoclave": FoundSet(
        nylon_autoclave,
        "src/process_improve/datasets/batch/nylon.csv, Tag08, Tag05 and Tag02 over 100, batches 1 "
        "to 12, of the package process-improve, https://pypi.org/project/process-improve "
        "(Kassidas, 1997)",
        aside=True,
    ),
    "scuba_tank": FoundSet(
        scuba_tank,
        "dives/150.xml and 100.xml (its first 69 samples), DEPTH and CYLPRESS, of "
        "https://github.com/subsurface/subsurface",
        aside=True,
    ),
    "ev_battery": FoundSet(
        ev_battery,
        "summary-calculation/2023-11-28_22-42-22.csv, 22:43:05 to 22:46:06, Battery DC Current and "
        "Battery DC Voltage plus 0.0973 Ohm times the current, on a grid of 1.2 s, of "
        "https://github.com/jveverka/python-examples",
        aside=True,
    ),
    "muscle_oxygen": FoundSet(
        muscle_oxygen,
        "test/rides/peripedal_3min_1.csv, SmO2 Averaged and Power, every second row of 2 to 200, "
        "408 to 610 and 614 to 812 s, of https://github.com/GoldenCheetah/GoldenCheetah",
        aside=True,
    ),
    "hydraulic_cylinders": FoundSet(
        hydraulic_cylinders,
        "data/MultivariableCylinders.csv, 0 to 42.2 s, of "
        "https://github.com/swedishembedded/control (from MataveID, D. Mårtensson)",
        aside=True,
    ),
    "pid_heater": FoundSet(
        pid_heater,
        "temperature_log.csv, its runs 1 (first 136 rows), 2, 3 and 4 (first 44 rows), the mean of "
        "the output over each grid step of 1.7 s over 1000, of "
        "https://github.com/Himsh1216/python-heater",
        aside=True,
    ),
}
