"""Public measured sets of drives, vehicles and a structure, fitted by hand before discovery.

As `found_kit_cases`, all set aside: the speed of a robot on belts behind its battery and duty, its
heading behind its steering servo, its motor on a bench, a servo that lifts weights, a frame that
rings after a tap; a mass on a spring behind its base, a motor with a belt to its tachometer. Whole
runs count, as there.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import eoi_jax as eoi
from benchmarks.measured.campaign_cases import Rig
from benchmarks.measured.found_sets import FoundSet, Runs, records, runs, table


def belt_robot(folder: Path) -> Rig:
    """Speed of a robot on belts behind battery and duty, in steps: gain and one time constant."""

    def drive(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.gain * u[0] * u[1] / 100.0 - x.y[0]) / p.tau

    plant = eoi.Plant(
        drive, {"gain": 0.42, "tau": 0.3}, relative_degree=1, inputs=("battery", "duty"),
        outputs=("speed",), bounds={"tau": (1e-2, np.inf)},
        units={"battery": "V", "duty": "%", "speed": "m/s", "gain": "m/s/V", "tau": "s"},
    )  # fmt: skip
    columns = table(folder / "belt_robot/steps.csv")
    parts = (((0, 241),), ((241, 360),), ((360, 530),))
    return Rig(
        plant, records(plant, columns, parts),
        {"speed": (248.2, 248.2)}, {"speed": (83.8, 83.8)},
        ("coulomb_friction|constant_offset|stribeck_friction",
         "input_delay|actuator_lag|sensor_lag"), "mm/s", 1e3, windows=1,
        remark="dry friction alone 140, with a delay of 0.11 s 106; the sensor counts pulses, its "
        "lag falls with the speed (83.8, held out 28.8, declared 196); at full duty it levels off",
    )  # fmt: skip


def belt_heading(folder: Path) -> Rig:
    """Heading of the robot behind its steering servo and its speed: a yaw rate in proportion."""

    def vehicle(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, x
        return p.gain * u[0] * u[1]

    plant = eoi.Plant(
        vehicle, {"gain": 0.08}, relative_degree=1, inputs=("speed", "steer"),
        outputs=("heading",),
        units={"speed": "m/s", "steer": "µs", "heading": "°", "gain": "°/m/µs"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("run_12", (0, 190)),),
        (("run_17", (0, 60)),),
        (("run_17", (60, 120)),),
    )
    return Rig(
        plant, runs(plant, folder / "belt_heading", parts),
        {"heading": (3.946, 3.946)}, {"heading": (1.953, 1.953)},
        ("input_dead_zone", "actuator_lag|sensor_lag"), "°", windows=1,
        remark="in closed loop; the linkage is loose by 238 µs to each side, then a lag of 0.55 s: "
        "6.07, 2.38, 1.59 where it was fitted; the dead zone alone is worse held out (7.4)",
    )  # fmt: skip


def belt_motor(folder: Path) -> Rig:
    """Tachometer of the robot's motor on a bench, its supply rises slowly: one time constant."""

    def motor(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.gain * u - x.y[0]) / p.tau

    plant = eoi.Plant(
        motor, {"gain": 0.5, "tau": 0.05}, relative_degree=1, inputs=("voltage",),
        outputs=("tacho",), bounds={"tau": (1e-3, np.inf)},
        units={"voltage": "V", "tacho": "V", "gain": "1", "tau": "s"},
    )  # fmt: skip
    columns = table(folder / "belt_motor/spinup.csv")
    parts = (((0, 154),), ((154, 231),), ((231, 308),))
    return Rig(
        plant, records(plant, columns, parts),
        {"tacho": (20.15, 20.15)}, {"tacho": (13.9, 13.9)}, (), "mV", 1e3, windows=1,
        remark="nothing is certain: dry friction cannot be told from gain and time constant; a "
        "negative square, by the held-out part, is not physics (2 standard deviations)",
    )  # fmt: skip


def loaded_servo(folder: Path) -> Rig:
    """Angle of a servo at full speed that lifts a weight: top speed, slip and run-up."""

    def servo(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.top - p.slip * u - x.y[1]) / p.tau

    plant = eoi.Plant(
        servo, {"top": 380.0, "slip": 0.22, "tau": 0.05}, relative_degree=2, inputs=("load",),
        outputs=("position",), bounds={"tau": (1e-3, np.inf)},
        units={"load": "g", "position": "°", "top": "°/s", "slip": "°/s/g", "tau": "s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("load_0_0", (0, 176)), ("load_500_0", (0, 249))),
        (("load_300_0", (0, 214)),),
        (("load_300_2", (0, 214)),),
    )
    return Rig(
        plant, runs(plant, folder / "loaded_servo", parts),
        {"position": (1.044, 1.044)}, {"position": (1.044, 1.044)}, (), "°", windows=1,
        remark="nothing by the held-out run (0.929; a current limit 0.914); more inertia with the "
        "load and a torque that falls fit the others better (0.60 for 0.83), untouched 0.72",
    )  # fmt: skip


def tapped_frame(folder: Path) -> Rig:
    """Acceleration of a frame with a mass after a tap: stiffness and damping."""

    def frame(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, u
        return -(p.omega**2) * x.y[0] - p.damping * x.y[1]

    plant = eoi.Plant(
        frame, {"omega": 89.0, "damping": 3.0}, relative_degree=2, inputs=(),
        outputs=("acceleration",), bounds={"omega": (1.0, np.inf)},
        units={"acceleration": "g", "omega": "rad/s", "damping": "1/s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("tap_1", (0, 208)),),
        (("tap_1", (208, 312)),),
        (("tap_1", (312, 415)),),
    )
    return Rig(
        plant, runs(plant, folder / "tapped_frame", parts),
        {"acceleration": (36.94, 36.94)}, {"acceleration": (19.13, 19.13)},
        ("quadratic_drag|displacement_damping|curve",), "mg", 1e3, windows=1,
        remark="damping grows with the amplitude: with the velocity, or with the square of the "
        "displacement (22.4); held out 8.9, declared 20.2; an offset too is likely",
    )  # fmt: skip


def spring_carriage(folder: Path) -> Rig:
    """Position of a mass on a spring behind its base, moved at once or slowly: it rings."""

    def carriage(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.omega**2 * (u - x.y[0]) - p.damping * x.y[1]

    plant = eoi.Plant(
        carriage, {"omega": 6.5, "damping": 0.3}, relative_degree=2, inputs=("base",),
        outputs=("position",), bounds={"omega": (0.5, np.inf)},
        units={"base": "mm", "position": "mm", "omega": "rad/s", "damping": "1/s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("ring", (0, 124)), ("follow_1", (0, 61))),
        (("ring", (124, 224)),),
        (("ring", (224, 313)), ("follow_2", (0, 53))),
    )
    return Rig(
        plant, runs(plant, folder / "spring_carriage", parts),
        {"position": (5.208, 5.208)}, {"position": (1.303, 1.303)},
        ("coulomb_friction|stribeck_friction", "constant_offset"), "mm", windows=1,
        remark="it ends 1.4 from its base; held out 1.68, declared 4.39, friction alone 2.87, "
        "offset alone 3.81; a lag of the sensor of 31 ms too is better where it was fitted (1.02 "
        "for 1.67), not held out (2.47) nor here (2.15); the sensor is read up to 11 ms late",
    )  # fmt: skip


def tacho_belt(folder: Path) -> Rig:
    """Tachometer behind a belt of a motor, in pulses of its voltage: gain and one time constant."""

    def motor(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.gain * u - x.y[0]) / p.tau

    plant = eoi.Plant(
        motor, {"gain": 1.2, "tau": 0.2}, relative_degree=1, inputs=("voltage",),
        outputs=("tacho",), bounds={"tau": (1e-2, np.inf)},
        units={"voltage": "V", "tacho": "V", "gain": "1", "tau": "s"},
    )  # fmt: skip
    columns = table(folder / "tacho_belt/pulses.csv")
    parts = (((0, 340),), ((340, 540),), ((540, 740),))
    return Rig(
        plant, records(plant, columns, parts),
        {"tacho": (372.5, 372.5)}, {"tacho": (118.3, 118.3)},
        ("coulomb_friction|stribeck_friction|constant_offset",
         "input_damping|product|input_saturation|input_curve|input_quadratic"), "mV", 1e3,
        windows=1,
        remark="it coasts in a straight line, as friction has it, and hardly damped: the voltage "
        "damps, its drive is open between the pulses; both 136, held out 146 for 300, and 140 for "
        "366 where it was fitted; a negative square beside them (held out 108) is no physics",
    )  # fmt: skip


_ROBOT = "https://github.com/AodhAnd/eit-p5-lm-main"
ROBOTS: Mapping[str, FoundSet] = {
    "belt_robot": FoundSet(
        belt_robot,
        "CD/L - Vehicle Tests - Velocity Gain to do/Matlab/steps.csv, columns 5, 1, 2 and 3, "
        f"1.500 to 15.014 s, of {_ROBOT}",
        aside=True,
    ),
    "belt_heading": FoundSet(
        belt_heading,
        "CD/Tests/N - Vehicle Tests - Steering - Steering Gain/Matlab/stepresponse1.2-45.csv, "
        "2.362 to 12.039 s, and stepresponse1.7-45.csv, 2.515 to 8.608 s, columns 1, 2, 3 and 5, "
        f"the pulse less 1375, of {_ROBOT}",
        aside=True,
    ),
    "belt_motor": FoundSet(
        belt_motor,
        "CD/Tests/A - H - Motor Tests/matlab/data/H - Motor Tests - Time Constant and Gain .csv, "
        f"0.064 to 0.678 s, of {_ROBOT}",
        aside=True,
    ),
    "loaded_servo": FoundSet(
        loaded_servo,
        "processed/processed0-0.txt (26 to 446 ms), processed500-0 (26 to 620 ms), processed300-0 "
        "(26 to 536 ms) and processed300-2 (8 to 518 ms), until the servo brakes, of "
        "https://github.com/spfrommer/servo-experiment",
        aside=True,
    ),
    "tapped_frame": FoundSet(
        tapped_frame,
        "vibracoes/Experimental/first_experiment/massa2/test1-2/tps.txt, column 3, every second "
        "row of 0.094453 to 0.595781 s, of https://github.com/carlos-adir/UnB-Courses",
        aside=True,
    ),
    "spring_carriage": FoundSet(
        spring_carriage,
        "messung.csv, every fourth row of 0.938 to 3.575 s and 22.120 to 24.404 s, and every other "
        "new reading from 6.044 to 18.562 s, of "
        "https://github.com/alexwohlers/dynasim_public",
        aside=True,
    ),
    "tacho_belt": FoundSet(
        tacho_belt,
        "Dados-de-leitura/gerados com python/20190701-23:37:34-Fs10-N4000-Nv100.csv, the first 740 "
        "rows, 0.1 s each, of https://github.com/johnnv1/compensator_projects",
        aside=True,
    ),
}
