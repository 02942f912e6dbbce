"""Measured records with the effects declared in the model, for `refine_speed`, `random_starts`."""

from pathlib import Path
from typing import Any

import eoi_jax as eoi
from benchmarks.measured import measured_cases
from eoi_jax import effects
from eoi_jax.models.augmented import augmented, place


def hardening_circuit(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
    """The silverbox, with a spring that hardens, and more so to one side."""
    del t
    y, rate = x.y
    spring = p.stiffness * y + p.quadratic_stiffness * y**2 + p.cubic_stiffness * y**3
    return p.gain * u - p.damping * rate - spring + p.offset


def silverbox(folder: Path) -> tuple[eoi.Plant, eoi.Record]:
    """The first 5000 samples of the estimation part; a linear guess, effects from zero."""
    one = measured_cases.silverbox(folder)
    values = dict(one.plant.parameters)
    values |= dict.fromkeys(("quadratic_stiffness", "cubic_stiffness", "offset"), 0.0)
    plant = eoi.Plant(
        hardening_circuit, values, 2, inputs=one.plant.inputs, outputs=one.plant.outputs,
        name="silverbox",
    )  # fmt: skip
    return plant, one.records[0][:5000]


def emps(folder: Path) -> tuple[eoi.Plant, eoi.Record]:
    """The whole estimation file; Coulomb friction and offset declared, values 40 % off."""
    return eoi.plants.positioning_system(), measured_cases.emps(folder).records[0]


def bare_tanks(folder: Path) -> tuple[eoi.Plant, eoi.Record]:
    """The plant of the library, square roots only."""
    case = measured_cases.cascaded_tanks(folder)
    return case.plant, case.records[0]


def cascaded_tanks(folder: Path) -> tuple[eoi.Plant, eoi.Record]:
    """Overflow of both tanks, what the upper one spills partly caught, and a constant offset."""
    base, record = bare_tanks(folder)
    placed = [
        place(base, effects.Overflow(), 0),
        place(base, effects.InternalOverflow(), 0),
        place(base, effects.ConstantOffset(), 0),
    ]
    values = {name: 0.0 for one in placed for name in one.names}
    values |= {"overflow_level": 9.0, "overflow_level_z": 9.0}
    return augmented(base, placed, values), record
