"""Public measured sets of drives, a beam and a car, fitted by hand before discovery saw them.

As `found_kit_cases`, all set aside: a motor in random steps of voltage, a toy motor behind its
duty, a ball on a beam behind a servo, a head that pans, a model car that steers. Whole runs count,
as there.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import eoi_jax as eoi
from benchmarks.measured.campaign_cases import Rig
from benchmarks.measured.found_sets import FoundSet, Runs, runs


def random_motor(folder: Path) -> Rig:
    """Speed of a motor in random steps of its voltage: gain and one time constant.

    The source has neither stamps nor a unit of speed: time is in samples, rad/s a guess.
    """

    def motor(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.gain * u - x.y[0]) / p.tau

    plant = eoi.Plant(
        motor, {"gain": 28.0, "tau": 10.0}, relative_degree=1, inputs=("voltage",),
        outputs=("speed",), bounds={"tau": (0.5, np.inf)},
        units={"voltage": "V", "speed": "rad/s", "gain": "rad/s/V", "tau": "s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("steps_a", (0, 432)),),
        (("steps_b", (0, 109)), ("steps_c", (0, 146))),
        (("steps_d", (0, 124)), ("steps_e", (0, 115))),
    )
    return Rig(
        plant, runs(plant, folder / "random_motor", parts),
        {"speed": (14.31, 14.31)}, {"speed": (7.639, 7.639)},
        ("coulomb_friction|constant_offset|stribeck_friction",), "rad/s", windows=1,
        remark="friction alone 7.66, held out 6.85 for 13.1; with a delay of a sample and a fall "
        "twice as fast as the rise 5.08 there, and 4.1 for 5.6 where it was fitted, but not better "
        "here: the same steps end 3 to 5 higher, the motor drifts; the speed scatters by 4",
    )  # fmt: skip


def lego_motor(folder: Path) -> Rig:
    """Angle of a toy motor behind the duty of its drive, in steps: torque and damping."""

    def motor(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.gain * u - p.damping * x.y[1]

    plant = eoi.Plant(
        motor, {"gain": 25.0, "damping": 1.5}, relative_degree=2, inputs=("duty",),
        outputs=("angle",), bounds={"damping": (0.0, np.inf)},
        units={"duty": "1", "angle": "rad", "gain": "rad/s²", "damping": "1/s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("duty_05", (0, 165)), ("duty_08", (0, 165)), ("duty_10", (0, 165))),
        (("duty_06", (0, 165)),),
        (("duty_07", (0, 165)),),
    )
    return Rig(
        plant, runs(plant, folder / "lego_motor", parts),
        {"angle": (9.335, 9.335)}, {"angle": (0.413, 0.413)},
        ("input_damping|input_quadratic|input_curve|input_saturation",), "rad", windows=1,
        remark="the speed hardly grows with the duty, the drive is open between its pulses: so "
        "poor is the declared model that its fit starts at full speed; held out 0.236, with dry "
        "friction too 0.272 and here 0.175; a quadratic in the duty 0.439 and 0.289",
    )  # fmt: skip


def rail_ball(folder: Path) -> Rig:
    """Position of a ball on a beam behind its servo, a random binary sequence: it only rolls."""

    def ball(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, x
        return p.gain * (u - p.neutral)

    plant = eoi.Plant(
        ball, {"gain": 12.0, "neutral": 100.0}, relative_degree=2, inputs=("servo",),
        outputs=("distance",),
        units={"servo": "°", "distance": "mm", "gain": "mm/s²/°", "neutral": "°"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("prbs2", (0, 305)),),
        (("prbs", (0, 76)), ("prbs", (76, 152))),
        (("prbs", (152, 228)), ("prbs", (228, 305))),
    )
    return Rig(
        plant, runs(plant, folder / "rail_ball", parts),
        {"distance": (14.11, 14.11)}, {"distance": (13.13, 13.13)}, (), "mm", windows=1,
        remark="nothing is certain: a dead time of 0.2 s, to be seen by eye, and a beam that sags "
        "(held out 5.4, declared 10.5), each alone is worse held out; the ball sticks at times",
    )  # fmt: skip


def pan_head(folder: Path) -> Rig:
    """Angle of a head that pans, behind the effort of its controller: gain, one time constant."""

    def head(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return (p.gain * u - x.y[1]) / p.tau

    plant = eoi.Plant(
        head, {"gain": 40.0, "tau": 0.1}, relative_degree=2, inputs=("effort",),
        outputs=("angle",), bounds={"tau": (1e-3, np.inf)},
        units={"effort": "V", "angle": "°", "gain": "°/s/V", "tau": "s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("step_105", (0, 50)), ("step_180", (0, 60)), ("step_225", (0, 60))),
        (("step_150", (0, 55)),),
        (("step_195", (0, 60)),),
    )
    return Rig(
        plant, runs(plant, folder / "pan_head", parts),
        {"angle": (7.775, 7.775)}, {"angle": (1.579, 1.579)},
        ("input_saturation|input_curve|current_limit",
         "coulomb_friction|stribeck_friction|input_dead_zone"), "°", windows=1,
        remark="a drive that saturates, softly by the held-out run (0.84; sharply at 4.3 V 1.27, "
        "here 1.29), and dry friction (0.79 for 2.2 where it was fitted); a limit of the torque "
        "instead 1.08 and here 0.66; in closed loop",
    )  # fmt: skip


def steered_car(folder: Path) -> Rig:
    """Heading of a model car behind its speed and its steering command: its turn in proportion."""

    def car(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, x
        return p.gain * u[0] * u[1]

    plant = eoi.Plant(
        car, {"gain": 3.0}, relative_degree=1, inputs=("steer", "speed"), outputs=("heading",),
        units={"steer": "rad", "speed": "m/s", "heading": "rad", "gain": "1/m"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("run_30", (0, 120)), ("run_33", (0, 120))),
        (("run_25", (0, 120)),),
        (("run_20", (0, 120)),),
    )
    return Rig(
        plant, runs(plant, folder / "steered_car", parts),
        {"heading": (50.12, 50.12)}, {"heading": (30.91, 30.91)},
        ("actuator_lag|sensor_lag|input_delay|rate_limit",), "mrad", 1e3, windows=1,
        remark="a lag of 0.25 s (held out 4.1, declared 13.5); the wheels are not straight at "
        "zero in three of the runs (4.7 for 8.9 where it was fitted, here 6.7), but they are in "
        "the held-out one (34)",
    )  # fmt: skip


MOTIONS: Mapping[str, FoundSet] = {
    "random_motor": FoundSet(
        random_motor,
        "motor_data.csv, five stretches about steps of the voltage (137.31 at 2 V to 193.63 at "
        "7 V, 6.3 to 5.2, 2 to 7, 4.2 to 2 and 7 to 5.8 V), all rows, of "
        "https://github.com/adinovitarini/Dataset_Case_Study",
        aside=True,
    ),
    "lego_motor": FoundSet(
        lego_motor,
        "step_response_from_duty_0.5, 0.6, 0.7, 0.8 and 1.0_to_velo_on_114_7.csv, every fourth row "
        "from 20 of them before the step to 4.64 s, of "
        "https://github.com/wattai/control-engineering-for-inverted-pendulum",
        aside=True,
    ),
    "rail_ball": FoundSet(
        rail_ball,
        "data/old-recordings/dane-dla-roznych-wychylen/prbs2.csv and prbs.csv, columns time, "
        "control and distance, from 1.02 s on, of "
        "https://github.com/Piotr-Bednarek/TeamPiesProjekt",
        aside=True,
    ),
    "pan_head": FoundSet(
        pan_head,
        "logs/pan_step_closed_loop_new/105.0_deg_2, 150.0_deg_1, 180.0_deg_1, 195.0_deg_2 and "
        "225.0_deg_3_controlled_step 2024-03-14 21_36_07.csv, the first 50, 55 and 60 rows, of "
        "https://github.com/Telepresence-UFABC/Controller",
        aside=True,
    ),
    "steered_car": FoundSet(
        steered_car,
        "autoKoopman_codeocean/data/F1tenthCar/measurement_20, 25, 30 and 33 (input.csv, columns "
        "3 and 4 of trajectory.csv, 25 ms a row), of https://github.com/nikhilushinde/AutoKoopman "
        "(from Kochdumper and Bak, 2022)",
        aside=True,
    ),
}
