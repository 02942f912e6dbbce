"""Public measured sets of mechanics and mechatronics, fitted by hand before discovery saw them.

As `found_kit_cases`, all set aside: a small satellite with a reaction wheel, a mass on a spring
with a vane, a disc between two springs that swings and that is driven, a motor that spins up at
once, a motor under a slow chirp. Whole runs count, as there.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import eoi_jax as eoi
from benchmarks.measured.campaign_cases import Rig
from benchmarks.measured.found_sets import FoundSet, Runs, records, runs, table


def _motor(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
    """A motor behind its voltage: gain and one time constant, the angle measured."""
    del t
    return (p.gain * u - x.y[1]) / p.tau


def cubesat_wheel(folder: Path) -> Rig:
    """Rate of a small satellite behind the duty of its reaction wheel: gain and damping."""

    def satellite(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.gain * u - x.y[0] / p.tau

    plant = eoi.Plant(
        satellite, {"gain": 10.0, "tau": 3.0}, relative_degree=1, inputs=("duty",),
        outputs=("speed",), bounds={"tau": (1e-2, np.inf)},
        units={"duty": "%", "speed": "mrad/s", "gain": "mrad/s²/%", "tau": "s"},
    )  # fmt: skip
    columns = table(folder / "cubesat_wheel/regulation.csv")
    parts = (((0, 711),), ((711, 1099),), ((1099, 1375),))
    return Rig(
        plant, records(plant, columns, parts),
        {"speed": (30.19, 30.19)}, {"speed": (13.24, 13.24)},
        ("coulomb_friction|stribeck_friction", "input_dead_zone"), "mrad/s", windows=1,
        remark="the wheel sticks below a duty of 7; held out 235 becomes 28; linear hold",
    )  # fmt: skip


def damped_spring(folder: Path) -> Rig:
    """Distance of a mass on a spring, with a vane: stiffness and damping."""

    def mass(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, u
        return -(p.omega**2) * (x.y[0] - p.rest) - p.damping * x.y[1]

    plant = eoi.Plant(
        mass, {"omega": 9.0, "rest": 20.0, "damping": 0.05}, relative_degree=2, inputs=(),
        outputs=("distance",), bounds={"omega": (0.1, np.inf)},
        units={"distance": "cm", "omega": "rad/s", "rest": "cm", "damping": "1/s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("run_1", (0, 156)), ("run_2", (0, 76))),
        (("run_2", (76, 152)),),
        (("run_3", (0, 152)),),
    )
    return Rig(
        plant, runs(plant, folder / "damped_spring", parts),
        {"distance": (0.01667, 0.01667)}, {"distance": (0.01667, 0.01667)}, (), "cm", windows=1,
        remark="nothing: air drag or dry friction are no better held out, worse untouched",
    )  # fmt: skip


def disc_springs(folder: Path) -> Rig:
    """Angle of a disc between two springs, its string over a pulley: stiffness and damping."""

    def disc(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, u
        return -(p.omega**2) * x.y[0] - p.damping * x.y[1]

    plant = eoi.Plant(
        disc, {"omega": 4.5, "damping": 0.2}, relative_degree=2, inputs=(), outputs=("angle",),
        bounds={"omega": (0.1, np.inf)},
        units={"angle": "rad", "omega": "rad/s", "damping": "1/s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("run_4", (4, 103)), ("run_8", (4, 103)), ("run_10", (4, 103))),
        (("run_9", (4, 103)),),
        (("run_7", (18, 103)),),
    )
    return Rig(
        plant, runs(plant, folder / "disc_springs", parts),
        {"angle": (159.2, 159.2)}, {"angle": (129.3, 129.3)}, ("constant_offset",), "mrad", 1e3,
        windows=1,
        remark="zero of the sensor; dry friction, a cubic spring are likely; rest wanders",
    )  # fmt: skip


def driven_disc(folder: Path) -> Rig:
    """Angle of the disc between springs, the end of one moved by an arm: a driven oscillator."""

    def disc(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return -(p.omega**2) * (x.y[0] - p.rest) - p.damping * x.y[1] + p.gain * u

    plant = eoi.Plant(
        disc, {"omega": 4.5, "rest": 0.8, "damping": 0.2, "gain": 10.0}, relative_degree=2,
        inputs=("driver",), outputs=("angle",), bounds={"omega": (0.1, np.inf)},
        units={"driver": "rad", "angle": "rad", "omega": "rad/s", "rest": "rad",
               "damping": "1/s", "gain": "1/s²"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("run_13", (0, 221)),),
        (("run_13", (221, 331)),),
        (("run_13", (331, 442)),),
    )
    return Rig(
        plant, runs(plant, folder / "driven_disc", parts),
        {"angle": (67.50, 67.50)}, {"angle": (28.54, 28.54)},
        ("coulomb_friction|stribeck_friction|internal_friction",), "mrad", 1e3, windows=1,
        remark="dry friction, then no viscous; elastic before it slips; dry friction alone 26.5",
    )  # fmt: skip


def spinup_motor(folder: Path) -> Rig:
    """Counts of a motor switched to 12 V once: gain and one time constant."""
    plant = eoi.Plant(
        _motor, {"gain": 1000.0, "tau": 1.0}, relative_degree=2, inputs=("voltage",),
        outputs=("counts",), bounds={"tau": (1e-3, np.inf)},
        units={"voltage": "V", "counts": "1", "gain": "1/s/V", "tau": "s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("part_1", (0, 151)), ("part_3", (0, 106))),
        (("part_2", (0, 69)),),
        (("part_2", (69, 138)),),
    )
    return Rig(
        plant, runs(plant, folder / "spinup_motor", parts),
        {"counts": (50.09, 50.09)}, {"counts": (21.78, 21.78)},
        ("current_limit|curve|quadratic_drag|power_loss",), "counts", windows=1,
        remark="constant torque to half speed; one voltage: a limit and a curve are alike",
    )  # fmt: skip


def chirp_motor(folder: Path) -> Rig:
    """Angle of a motor under a slow chirp, three stretches: gain and one time constant."""
    plant = eoi.Plant(
        _motor, {"gain": 500.0, "tau": 0.25}, relative_degree=2, inputs=("voltage",),
        outputs=("angle",), bounds={"tau": (1e-3, np.inf)},
        units={"voltage": "V", "angle": "rad", "gain": "rad/s/V", "tau": "s"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("piece_1", (0, 104)), ("piece_2", (0, 95))),
        (("piece_3", (0, 47)),),
        (("piece_3", (47, 93)),),
    )
    return Rig(
        plant, runs(plant, folder / "chirp_motor", parts),
        {"angle": (3.328, 3.328)}, {"angle": (0.8954, 0.8954)},
        ("coulomb_friction|stribeck_friction",), "rad", windows=1,
        remark="dry friction of a third of the drive; what is left is open",
    )  # fmt: skip


_OSC = "https://github.com/Sven-vandenBergh/M24-25-Lab-OSC-data"
MACHINES: Mapping[str, FoundSet] = {
    "cubesat_wheel": FoundSet(
        cubesat_wheel,
        "docs/measurements/ang_vel_regulation_input.csv, channels 3 and 2, 1375 rows from the "
        "first step on, 0.1 s a row (its firmware), of https://github.com/IvanVnucec/cubesat-adcs",
        aside=True,
    ),
    "damped_spring": FoundSet(
        damped_spring,
        "damped_point_data.txt, every fifth row of 6.10 to 13.85, 23.90 to 31.45 and 41.40 to "
        "48.95 s, of https://github.com/pankaj9um/PHY224",
        aside=True,
    ),
    "disc_springs": FoundSet(
        disc_springs,
        f"data_s1_osc.csv, channels 1+2 of runs 4, 7, 8, 9, 10, 1.1 to 6.2 s, of {_OSC}",
        aside=True,
    ),
    "driven_disc": FoundSet(
        driven_disc,
        "Set_3_ddo/data_s3/Trial_5_data.csv, run 13, channels 3+4 and 1+2, 0 to 22.05 s, of "
        f"{_OSC}",
        aside=True,
    ),
    "spinup_motor": FoundSet(
        spinup_motor,
        "ubc_motor_step_response_v15_@12V.txt, a row each 5 ms or so of 5.34 to 6.12, 6.12 to 6.83 "
        "and 7.85 to 8.39 s, of https://github.com/ericchen321/2-DOF_Robotic_Arm_Model",
        aside=True,
    ),
    "chirp_motor": FoundSet(
        chirp_motor,
        "chirp.csv, every fourth row of 0 to 0.412, 2.636 to 3.012 and 5.466 to 5.834 s, of "
        "https://github.com/chewy441014/mae277_assign2",
        aside=True,
    ),
}
