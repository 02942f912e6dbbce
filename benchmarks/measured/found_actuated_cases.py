"""Public measured sets of pendulums, an aeroplane and actuators, fitted before discovery saw them.

As `found_kit_cases`, all set aside: a pendulum filmed, an aeroplane in flight, a linear and a
cranked actuator that tilt a wheel, the speed of the linear one behind its current, an arm with a
propeller that swings freely. Whole runs count, as there.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import eoi_jax as eoi
from benchmarks.measured.campaign_cases import Rig
from benchmarks.measured.found_sets import FoundSet, Runs, records, runs, table


def dorm_pendulum(folder: Path) -> Rig:
    """Position of the bob of a pendulum of 0.6 m that swings freely by 5°, in a film."""

    def swing(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, u
        return -(p.omega**2) * x.y[0] - p.damping * x.y[1]

    plant = eoi.Plant(
        swing, {"omega": 4.1, "damping": 0.05}, relative_degree=2, inputs=(),
        outputs=("position",), bounds={"omega": (0.5, np.inf)},
        units={"position": "mm", "omega": "rad/s", "damping": "1/s"},
    )  # fmt: skip
    columns = table(folder / "dorm_pendulum/swing.csv")
    parts = (((0, 474),), ((474, 711),), ((711, 947),))
    return Rig(
        plant, records(plant, columns, parts),
        {"position": (7.747, 7.747)}, {"position": (0.8186, 0.8186)},
        ("constant_offset", "quadratic_stiffness|cubic_stiffness|sensor_curve|curve"), "mm",
        windows=1,
        remark="an offset of 6.75 alone 1.425, held out 1.068 for 7.544; a restoring force that is "
        "not straight (the film's perspective) 0.947, held out 0.706; a negative quadratic drag or "
        "dry friction beside it 0.819 or 1.042, held out 0.482 or 0.540; the unit is about a mm",
    )  # fmt: skip


def test_jet(folder: Path) -> Rig:
    """Angle of attack and pitch rate of an aeroplane behind its elevator and airspeed.

    The short-period motion, of which lift and moments grow with the measured airspeed.
    """

    def short_period(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        incidence, rate = x.y[0, 0], x.y[0, 1]
        fast = u[1] / 106.0
        moment = p.trim - p.stability * incidence - p.power * u[0]
        return jnp.stack(
            [
                rate - p.lift * fast * (incidence - p.zero) + 9.81 / u[1],
                fast**2 * moment - p.damping * fast * rate,
            ]
        )

    plant = eoi.Plant(
        short_period,
        {"lift": 0.8, "zero": -0.02, "trim": 0.3, "stability": 3.0, "damping": 1.5, "power": 5.0},
        relative_degree=1, inputs=("elevator", "airspeed"), outputs=("incidence", "pitch_rate"),
        units={"elevator": "rad", "airspeed": "m/s", "incidence": "rad", "pitch_rate": "rad/s",
               "lift": "1/s", "zero": "rad", "trim": "rad/s²", "stability": "1/s²",
               "damping": "1/s", "power": "1/s²"},
    )  # fmt: skip
    columns = table(folder / "test_jet/flight.csv")
    parts = (((0, 186),), ((186, 279),), ((279, 372),))
    return Rig(
        plant, records(plant, columns, parts),
        {"incidence": (3.032, 3.032), "pitch_rate": (1.336, 1.336)},
        {"incidence": (3.032, 3.032), "pitch_rate": (1.336, 1.336)}, (), "mrad", 1e3, windows=1,
        remark="nothing certain, the air is not calm: a lag of the incidence of 0.18 s, or lift of "
        "the elevator of the wrong sign, is better where it was fitted and, in one output or both, "
        "held out (2.38 and 3.37, 2.66 and 2.79 for 3.02 and 3.24), here in one of two outputs "
        "(1.72 and 1.94, 2.16 and 1.80)",
    )  # fmt: skip


def _servo(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
    """A position servo of second order."""
    del t
    return p.omega**2 * (u - x.y[0]) - 2.0 * p.zeta * p.omega * x.y[1]


def camber_slide(folder: Path) -> Rig:
    """Position of a linear actuator in its loop behind its target, steps and a sweep."""
    plant = eoi.Plant(
        _servo, {"omega": 40.0, "zeta": 0.7}, relative_degree=2, inputs=("target",),
        outputs=("position",), bounds={"omega": (0.1, np.inf)},
        units={"target": "mm", "position": "mm", "omega": "rad/s", "zeta": "1"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("square", (0, 200)), ("sweep", (0, 200))),
        (("square", (200, 350)), ("sweep", (200, 291))),
        (("square", (350, 450)), ("sweep", (291, 383))),
    )
    return Rig(
        plant, runs(plant, folder / "camber_slide", parts),
        {"position": (721.0, 721.0)}, {"position": (120.9, 120.9)},
        ("error_saturation|rate_limit|current_limit",), "µm", 1e3, windows=1,
        remark="its speed ends at 90 mm/s: a limit alone 328, held out 371 for 574; an integral of "
        "its controller, which forgets in 0.6 s, within the limit too 121, held out 117",
    )  # fmt: skip


def camber_crank(folder: Path) -> Rig:
    """Angle of a loaded rotary actuator in its loop behind steps of its target."""
    plant = eoi.Plant(
        _servo, {"omega": 10.0, "zeta": 0.7}, relative_degree=2, inputs=("target",),
        outputs=("angle",), bounds={"omega": (0.1, np.inf)},
        units={"target": "°", "angle": "°", "omega": "rad/s", "zeta": "1"},
    )  # fmt: skip
    parts: tuple[Runs, Runs, Runs] = (
        (("run_1", (0, 185)),), (("run_2", (0, 155)),), (("run_2", (155, 342)),),
    )  # fmt: skip
    return Rig(
        plant, runs(plant, folder / "camber_crank", parts),
        {"angle": (4.535, 4.535)}, {"angle": (1.566, 1.566)},
        ("rate_limit|error_saturation",), "°", windows=1,
        remark="its target is ramped, at 239 °/s: held out 1.46 for 4.64, here 1.53; an offset "
        "beside it is chosen held out (1.34); a limit of the error, which it is not, 2.45; it "
        "overshoots on one side, where the load pulls, as no model here does",
    )  # fmt: skip


def slide_speed(folder: Path) -> Rig:
    """Speed of a linear actuator behind the current of its motor, in steps of its loop."""

    def slide(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t
        return p.gain * u - p.damping * x.y[0]

    plant = eoi.Plant(
        slide, {"gain": 500.0, "damping": 10.0}, relative_degree=1, inputs=("current",),
        outputs=("speed",),
        units={"current": "A", "speed": "mm/s", "gain": "mm/s²/A", "damping": "1/s"},
    )  # fmt: skip
    columns = dict(table(folder / "camber_slide/square.csv"))
    columns["current"] = columns["current"] / 1e3
    parts = (((0, 225),), ((225, 337),), ((337, 450),))
    return Rig(
        plant, records(plant, columns, parts),
        {"speed": (9.167, 9.167)}, {"speed": (3.649, 3.649)},
        ("coulomb_friction|stribeck_friction|asymmetric_friction",
         "constant_offset|asymmetric_friction"), "mm/s", windows=1,
        remark="friction alone 4.93, held out 4.36 for 7.15; an offset too 2.59; the current goes "
        "straight between its samples; the set of camber_slide, its folder too",
    )  # fmt: skip


def fan_arm(folder: Path) -> Rig:
    """Angle of an arm with a propeller at rest that falls from the horizontal and swings out."""

    def arm(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
        del t, u
        degree = jnp.pi / 180.0
        return -(p.omega**2) * jnp.cos(degree * x.y[0]) / degree - p.damping * x.y[1]

    plant = eoi.Plant(
        arm, {"omega": 7.5, "damping": 0.5}, relative_degree=2, inputs=(), outputs=("angle",),
        bounds={"omega": (0.5, np.inf)},
        units={"angle": "°", "omega": "rad/s", "damping": "1/s"},
    )  # fmt: skip
    columns = table(folder / "fan_arm/swing.csv")
    parts = (((0, 242),), ((242, 398),), ((398, 576),))
    return Rig(
        plant, records(plant, columns, parts),
        {"angle": (10.64, 10.64)}, {"angle": (3.18, 3.18)},
        ("constant_offset|gravity_tilt", "coulomb_friction|stribeck_friction"), "°", windows=1,
        remark="it hangs 7.5° from the vertical: a torque is 1.70 held out for 7.22 (here 4.45), "
        "with dry friction 1.40 (here 3.18); as another zero of the angle with friction 1.83 (here "
        "1.62), without 2.38 (3.76); bursts of nine samples of 5 ms, 0.13 s apart: identify from "
        "the nominal values ends at omega's bound, refine does not",
    )  # fmt: skip


_CAMBER = "https://github.com/nicolazande/camber-control"
_BOOK = "https://github.com/josemiguelbento/UAV-OAT-controlo"
ACTUATED: Mapping[str, FoundSet] = {
    "dorm_pendulum": FoundSet(
        dorm_pendulum,
        "tracker_data.txt, all rows, of https://github.com/satvick16/pendulum-lab",
        aside=True,
    ),
    "test_jet": FoundSet(
        test_jet,
        "RVJategaonkar_codes_2ed/flt_data/hfb320_1_10.asc (HFB 320; Jategaonkar, Flight Vehicle "
        "System Identification, AIAA), columns 2, 5, 6 and 8, rows 0 to 371, 0.1 s each, of "
        f"{_BOOK}",
        aside=True,
    ),
    "camber_slide": FoundSet(
        camber_slide,
        "actuators/LinD/data/no-pp-square-wave-10mm-1Hz.txt, 0 to 4.49 s, and "
        "no-pp-sine-sweep-10mm-0.5Hz.txt, 1.5 to 5.32 s, target and actual position, of "
        f"{_CAMBER}",
        aside=True,
    ),
    "camber_crank": FoundSet(
        camber_crank,
        "actuators/EccA/data/load-square-wave-full-travel-0.5Hz.txt, 5.267 to 7.663 s and 11.830 "
        f"to 16.270 s, target and actual position, of {_CAMBER}",
        aside=True,
    ),
    "slide_speed": FoundSet(
        slide_speed,
        "actuators/LinD/data/no-pp-square-wave-10mm-1Hz.txt, 0 to 4.49 s, current and speed, of "
        f"{_CAMBER}",
        aside=True,
    ),
    "fan_arm": FoundSet(
        fan_arm,
        "data/data_pendulum.csv, 18.776 to 29.609 s, of https://github.com/cychitivav/aeropendulum",
        aside=True,
    ),
}
