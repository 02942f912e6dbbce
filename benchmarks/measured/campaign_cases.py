"""Measured sets fitted by hand before discovery saw them: models, splits, reference errors.

Models, nominal values, splits and the errors of hand fits are those of the README beside each set.
Nothing is set: no hold, no cut-off, no window. Errors are root mean squares, of whole free runs and
of runs that start again ten times a record; the *untouched* part chose nothing.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.signal import savgol_filter

import eoi_jax as eoi

Errors = tuple[float, float]  # of whole runs, in windows
Records = tuple[eoi.Record, ...]
Parts = tuple[Records, Records, Records]


@dataclass(frozen=True)
class Rig:
    """A declared model with the records of a set, and what a hand fit reached.

    Attributes:
        plant: the declared model at its nominal values.
        parts: records of the estimation, held-out ones, untouched ones; without an untouched part
            the held-out one counts.
        declared, expert: errors of the hand fit of the declared and of the best model, on the part
            that counts, by output, in `unit`.
        added: what the hand fit added and calls certain; alternatives in one entry by "|".
        scale, unit: of the errors.
        windows: free runs in a record, as in the hand fits; 1 where records are too short.
    """

    plant: eoi.Plant
    parts: Parts
    declared: Mapping[str, Errors]
    expert: Mapping[str, Errors]
    added: tuple[str, ...]
    unit: str
    scale: float = 1.0
    remark: str = ""
    windows: int = 10

    @property
    def estimation(self) -> tuple[eoi.Record, ...]:
        """Records to fit."""
        return self.parts[0]

    @property
    def held_out(self) -> tuple[eoi.Record, ...]:
        """Records that judge."""
        return self.parts[1]

    @property
    def untouched(self) -> tuple[eoi.Record, ...]:
        """Records that choose nothing."""
        return self.parts[2]


def _stamps(count: int, period: float) -> np.ndarray:
    return period * np.arange(count)


def _record(plant: eoi.Plant, name: str, time: Any, inputs: Any, outputs: Any) -> eoi.Record:
    """With the channels of the plant and their units; nothing else is said of it."""
    channels = (*plant.inputs, *plant.outputs)
    units = {key: unit for key, unit in plant.units.items() if key in channels}
    return eoi.Record(
        time, inputs, outputs, name, input_names=plant.inputs, output_names=plant.outputs,
        units=units,
    )  # fmt: skip


def _parts(
    read: Callable[[str], eoi.Record],
    estimation: Sequence[str],
    held_out: Sequence[str],
    untouched: Sequence[str],
) -> Parts:
    first, second, third = (
        tuple(read(name) for name in part) for part in (estimation, held_out, untouched)
    )
    return first, second, third


def throttle_valve(folder: Path) -> Rig:
    """Motor, viscous friction, return spring with preload."""
    data = np.load(folder / "throttle_valve/throttle_valve.npz")

    def valve(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.gain * u - p.damping * x.y[1] - p.spring * x.y[0] - p.preload

    plant = eoi.Plant(
        valve, {"gain": 60.0, "damping": 60.0, "spring": 250.0, "preload": 50.0},
        relative_degree=2, inputs=("voltage",), outputs=("position",),
        units={"voltage": "V", "position": "rad", "gain": "rad/s²/V", "damping": "1/s",
               "spring": "1/s²", "preload": "rad/s²"},
    )  # fmt: skip

    def read(name: str) -> eoi.Record:
        keys = ("time", "voltage", "position")
        return _record(plant, name, *(data[f"{name}_{key}"] for key in keys))

    return Rig(
        plant, _parts(read, ["run1"], ["run2"], ["run3"]),
        {"position": (71.2, 69.6)}, {"position": (30.2, 29.8)}, ("coulomb_friction",), "mrad", 1e3,
    )  # fmt: skip


def shaking_table(folder: Path) -> Rig:
    """Motor and screw: an integrator."""
    data = np.load(folder / "shaking_table/shaking_table.npz")

    def table(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.gain * u - p.damping * x.y[1]

    plant = eoi.Plant(
        table, {"gain": 1200.0, "damping": 30.0}, relative_degree=2, inputs=("voltage",),
        outputs=("position",),
        units={"voltage": "V", "position": "mm", "gain": "mm/s²/V", "damping": "1/s"},
    )  # fmt: skip

    def read(name: str) -> eoi.Record:
        keys = ("time", "voltage", "position")
        return _record(plant, name, *(data[f"{name}_{key}"] for key in keys))

    return Rig(
        plant,
        _parts(
            read, ["est_chirpFi03Ff5", "est_RandomA4F1", "est_SquareA4F3"],
            ["held_chirpFi1Ff3", "held_RandomA7F3", "held_SawtoothA2F1"],
            ["untouched_chirpFi05Ff1", "untouched_SineA1F1", "untouched_RandomA1F05"],
        ),
        {"position": (16.0, 1.80)}, {"position": (1.67, 0.441)},
        ("constant_offset|asymmetric_friction", "coulomb_friction|asymmetric_friction"), "mm",
    )  # fmt: skip


def levitator_coil(folder: Path) -> Rig:
    """A coil taken for a resistor with an inductance."""
    data = np.load(folder / "levitator_coil/levitator_coil.npz")

    def coil(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (u - p.resistance * x.y[0]) / p.inductance

    plant = eoi.Plant(
        coil, {"resistance": 12.0, "inductance": 0.12}, relative_degree=1, inputs=("voltage",),
        outputs=("current",), bounds={"inductance": (1e-4, np.inf)},
        units={"voltage": "V", "current": "A", "resistance": "Ohm", "inductance": "H"},
    )  # fmt: skip

    def read(name: str) -> eoi.Record:
        keys = ("time", "voltage", "current")
        return _record(plant, name, *(data[f"{name}_{key}"] for key in keys))

    return Rig(
        plant, _parts(read, ["est_chirp", "est_escalon"], ["held_multiescalon"],
        ["untouched_senoidal", "untouched_constante"]),
        {"current": (59.0, 59.5)}, {"current": (5.79, 5.59)},
        ("input_quadratic", "actuator_lag|input_delay"), "mA", 1e3,
    )  # fmt: skip


def mr_damper(folder: Path) -> Rig:
    """A Maxwell element, its motion prescribed; velocity by a Savitzky-Golay derivative."""
    data = np.load(folder / "mr_damper/mr_damper.npz")

    def maxwell(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.stiffness * u - p.rate * (x.y[0] - p.accumulator)

    plant = eoi.Plant(
        maxwell, {"stiffness": 60.0, "rate": 30.0, "accumulator": 120.0}, relative_degree=1,
        inputs=("velocity",), outputs=("force",),
        units={"velocity": "mm/s", "force": "N", "stiffness": "N/mm", "rate": "1/s",
               "accumulator": "N"},
    )  # fmt: skip

    def read(name: str) -> eoi.Record:
        (key,) = (k[: -len("_time")] for k in data if k.endswith(f"_{name.replace('.', '_')}_time"))
        place, stamps = data[f"{key}_displacement"], data[f"{key}_time"]
        velocity = savgol_filter(place, 7, 3, deriv=1, delta=float(np.mean(np.diff(stamps))))
        moves = np.flatnonzero(np.abs(place - np.median(place[:100])) > 0.1)[0]
        part = slice(max(int(moves) - 20, 0), None)
        return _record(plant, name, stamps[part], velocity[part], data[f"{key}_force"][part])

    return Rig(
        plant, _parts(read, ["1.1", "4.1", "7.1"], ["3.1", "8.1"], ["5.1", "10.1"]),
        {"force": (26.6, 26.7)}, {"force": (10.1, 10.2)}, ("input_saturation|input_yield",), "N",
    )  # fmt: skip


def _hydraulic(folder: Path, output: str, plant: eoi.Plant) -> Parts:
    data = np.load(folder / "hydraulic_arm/hydraulic_arm.npz")

    def read(name: str) -> eoi.Record:
        valve = data[f"{name}_valve"]
        return _record(plant, name, _stamps(len(valve), 1.0), valve, data[f"{name}_{output}"])

    return _parts(read, ["est"], ["held"], ["untouched"])


def hydraulic_arm_position(folder: Path) -> Rig:
    """The flow through the valve moves the arm; an integrator."""

    def arm(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, x
        return -p.k * u

    plant = eoi.Plant(arm, {"k": 0.03}, relative_degree=1, inputs=("valve",), outputs=("position",))
    return Rig(
        plant, _hydraulic(folder, "position", plant),
        {"position": (0.5051, 0.1156)}, {"position": (0.08337, 0.02834)},
        ("input_saturation|input_quadratic", "input_delay|actuator_lag"), "1",
    )  # fmt: skip


def hydraulic_arm_pressure(folder: Path) -> Rig:
    """Oil column and arm, weakly damped."""

    def column(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return -p.stiffness * x.y[0] - p.damping * x.y[1] - p.k * u

    plant = eoi.Plant(
        column, {"stiffness": 0.05, "damping": 0.05, "k": 0.1}, relative_degree=2,
        inputs=("valve",), outputs=("pressure",),
    )  # fmt: skip
    return Rig(
        plant, _hydraulic(folder, "pressure", plant),
        {"pressure": (1.041, 1.092)}, {"pressure": (0.4659, 0.419)},
        ("input_saturation|input_quadratic", "input_rate"), "1",
    )  # fmt: skip


def hair_dryer(folder: Path) -> Rig:
    """First order from the heater to the outlet."""
    data = np.load(folder / "hair_dryer/hair_dryer.npz")

    def tube(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.gain * u + p.inlet - x.y[0]) / p.tau

    plant = eoi.Plant(
        tube, {"gain": 0.8, "inlet": 0.5, "tau": 0.5}, relative_degree=1, inputs=("power",),
        outputs=("temperature",), bounds={"tau": (1e-3, np.inf)},
        units={"power": "W", "temperature": "V", "tau": "s", "inlet": "V", "gain": "V/W"},
    )  # fmt: skip

    def read(name: str) -> eoi.Record:
        power = data[f"{name}_power"]
        return _record(plant, name, _stamps(len(power), 0.08), power, data[f"{name}_temperature"])

    return Rig(
        plant, _parts(read, ["est"], ["held"], ["untouched"]),
        {"temperature": (0.4325, 0.4627)}, {"temperature": (0.1262, 0.1139)},
        ("input_delay", "actuator_lag|sensor_lag"), "V",
    )  # fmt: skip


def lamp_and_plate(folder: Path) -> Rig:
    """One heat store."""
    data = np.load(folder / "lamp_and_plate/lamp_and_plate.npz")

    def plate(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.k * u - (x.y[0] - p.ambient) / p.tau

    plant = eoi.Plant(
        plate, {"k": 0.2, "ambient": 25.0, "tau": 150.0}, relative_degree=1, inputs=("voltage",),
        outputs=("temperature",), bounds={"tau": (1e-2, np.inf)},
        units={"voltage": "V", "temperature": "K", "tau": "s", "ambient": "K", "k": "K/s/V"},
    )  # fmt: skip

    def read(name: str) -> eoi.Record:
        voltage = data[f"{name}_voltage"]
        stamps = _stamps(len(voltage), 2.0)
        return _record(plant, name, stamps, voltage, data[f"{name}_temperature"])

    return Rig(
        plant, _parts(read, ["est"], ["held"], ["untouched"]),
        {"temperature": (9.365, 2.794)}, {"temperature": (4.634, 2.219)}, ("second_node",), "K",
    )  # fmt: skip


def steam_exchanger(folder: Path) -> Rig:
    """A well mixed volume, heated by condensing steam."""
    data = np.load(folder / "steam_exchanger/steam_exchanger.npz")

    def volume(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.a * u * (p.inlet - x.y[0]) + p.b * (p.steam - x.y[0])

    plant = eoi.Plant(
        volume, {"a": 0.2, "inlet": 85.0, "b": 0.2, "steam": 105.0}, relative_degree=1,
        inputs=("flow",), outputs=("temperature",), units={"temperature": "K"},
    )  # fmt: skip

    def read(name: str) -> eoi.Record:
        flow = data[f"{name}_flow"]
        return _record(plant, name, _stamps(len(flow), 1.0), flow, data[f"{name}_temperature"])

    return Rig(
        plant, _parts(read, ["est"], ["held"], ["untouched"]),
        {"temperature": (0.6781, 0.6731)}, {"temperature": (0.3874, 0.3875)},
        ("cells_in_series",), "K",
    )  # fmt: skip


def leaf_cell(folder: Path) -> Rig:
    """A big capacitor; the ohmic drop is taken off the output."""
    data = np.load(folder / "leaf_cell/leaf_cell.npz")

    def cell(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, x
        return u / p.capacity

    plant = eoi.Plant(
        cell, {"capacity": 1.5e5}, relative_degree=1, inputs=("current",), outputs=("voltage",),
        bounds={"capacity": (1.0, np.inf)},
        units={"current": "A", "voltage": "V", "capacity": "F"},
    )  # fmt: skip

    def read(name: str) -> eoi.Record:
        current = data[f"{name}_current"]
        stamps = _stamps(len(current), 5.0)
        return _record(plant, name, stamps, current, data[f"{name}_voltage_less_r0"])

    return Rig(
        plant,
        _parts(read, ["est1", "est2", "est3", "est4"], ["held1", "held2"],
                ["untouched1", "untouched2"]),
        {"voltage": (22.51, 6.432)}, {"voltage": (20.14, 3.253)}, ("second_node",), "mV", 1e3,
    )  # fmt: skip


def buck_converter(folder: Path) -> Rig:
    """A switched converter taken for a linear oscillator; time in ms."""

    def converter(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.gain * u - p.damping * x.y[1] - p.stiffness * x.y[0]

    plant = eoi.Plant(
        converter, {"gain": -100.0, "damping": 4.0, "stiffness": 30.0}, relative_degree=2,
        inputs=("control",), outputs=("output",),
        units={"control": "V", "output": "V"},
    )  # fmt: skip

    def read(name: str) -> eoi.Record:
        data = np.loadtxt(folder / f"buck_converter/buck_{name}.csv", delimiter=",", skiprows=1)
        return _record(plant, name, 1e3 * data[:, 0], data[:, 1], data[:, 2])

    return Rig(
        plant, _parts(read, ["id"], ["valid"], []),
        {"output": (11.7, 2.93)}, {"output": (0.303, 0.303)},
        ("constant_offset", "product"), "V",
        remark="declared: by a pass; the windows of the best model are not given, its whole run is",
    )  # fmt: skip


def tclab(folder: Path) -> Rig:
    """Two heaters' sensors on a board, one heated."""
    data = np.loadtxt(folder / "tclab/tclab.csv", delimiter=",", skiprows=1)

    def board(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        first, second = x.y[0]
        flow = p.couple * (first - second)
        return jnp.stack([
            p.heat * u[0] / 100.0 - p.loss * (first - 22.0) - flow,
            flow - p.loss * (second - 22.0),
        ])  # fmt: skip

    plant = eoi.Plant(
        board, {"heat": 0.3, "loss": 0.005, "couple": 0.005}, relative_degree=1,
        inputs=("heater",), outputs=("first", "second"),
        units={"heater": "%", "first": "K", "second": "K", "heat": "K/s", "loss": "1/s",
               "couple": "1/s"},
    )  # fmt: skip

    def part(first: int, stop: int, name: str) -> eoi.Record:
        rows = data[first:stop]
        return _record(plant, name, rows[:, 1], rows[:, 2], rows[:, 3:5])

    return Rig(
        plant, ((part(0, 700, "first"),), (part(700, 1002, "rest"),), ()),
        {"first": (1.66, 1.66), "second": (0.605, 0.605)},
        {"first": (0.624, 0.624), "second": (0.515, 0.515)}, ("sensor_lag", "constant_offset"), "K",
        remark="hand fits: free runs from 0 s, scored over the held-out rows",
    )  # fmt: skip


def servo_pendulum(folder: Path) -> Rig:
    """A position servo with a pendulum; its supply saturates."""
    data = np.load(folder / "servo_pendulum_sts3250/servo_pendulum_sts3250.npz")

    def servo(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        angle, rate = x.y
        volts = 12.0 * jnp.clip(0.166 * 32.0 * (u - angle), -1.0, 1.0)
        weight = 1.13 * 9.81 * 0.12 * jnp.sin(angle)
        return (p.torque * volts - p.damping * rate - weight) / (1.13 * 0.12**2 + p.armature)

    plant = eoi.Plant(
        servo, {"torque": 0.4, "damping": 0.3, "armature": 0.004}, relative_degree=2,
        inputs=("goal",), outputs=("angle",), bounds={"armature": (0.0, np.inf)},
        units={"goal": "rad", "angle": "rad", "torque": "N m/V", "damping": "N m s",
               "armature": "kg m²"},
    )  # fmt: skip

    def read(name: str) -> eoi.Record:
        keys = ("timestamp", "goal_position", "position")
        return _record(plant, name, *(data[f"{name}_{key}"] for key in keys))

    return Rig(
        plant, _parts(read, ["est"], ["held"], []),
        {"angle": (1.06, 1.06)}, {"angle": (1.06, 1.06)}, (), "°", 180.0 / np.pi,
    )  # fmt: skip


RIGS: Mapping[str, Callable[[Path], Rig]] = {
    "throttle_valve": throttle_valve,
    "shaking_table": shaking_table,
    "levitator_coil": levitator_coil,
    "mr_damper": mr_damper,
    "hydraulic_arm, position": hydraulic_arm_position,
    "hydraulic_arm, pressure": hydraulic_arm_pressure,
    "hair_dryer": hair_dryer,
    "lamp_and_plate": lamp_and_plate,
    "steam_exchanger": steam_exchanger,
    "leaf_cell": leaf_cell,
    "buck_converter": buck_converter,
    "tclab": tclab,
    "servo_pendulum_sts3250": servo_pendulum,
}
