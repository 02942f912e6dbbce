"""Results of every kind in files, as this version of the library writes them.

    python tests/models/stored_files.py FOLDER

Those in `tests/models/stored/format_3` are of the last version that named classes by the modules
they stood in. Every later version must read them.
"""

import sys
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import control
import numpy as np

import eoi_jax as eoi
from eoi_jax.data.clipping import Saturation
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.storage import save

NOISE = 1e-4
LIBRARY = (
    "cascaded_tanks",
    "duffing_oscillator",
    "level_tank",
    "mass_spring_damper",
    "pendulum",
    "positioning_system",
    "propeller_arm",
    "three_mass_spring_damper",
)
OBSERVERS = {
    "first order": eoi.observers.FirstOrder(100.0),
    "second order": eoi.observers.SecondOrder(20.0, 100.0, 500.0),
    "high order": eoi.observers.HighOrder(100.0, 3),
    "super-twisting": eoi.observers.SuperTwisting(30.0, 500.0),
    "per output": eoi.observers.PerOutput(
        (eoi.observers.FirstOrder(100.0), eoi.observers.SecondOrder(20.0, 100.0, 500.0))
    ),
}


def written() -> Iterator[tuple[str, Any]]:
    """Names and results."""
    true, time = eoi.plants.mass_spring_damper(true=True), np.arange(500) * 4e-3
    draw, records = np.random.default_rng(0), []
    for hertz in (0.5, 0.8):
        clean = eoi.simulate(true, time, eoi.excitation.square(time, 1.0, hertz))
        noise = NOISE * draw.standard_normal(clean.outputs.shape)
        records.append(clean.with_outputs(clean.outputs + noise, f"{hertz} Hz"))
    record, held_out = records
    plant = eoi.plants.mass_spring_damper()
    found = eoi.identify(plant, record, passes=3)
    refined = eoi.refine(plant, record)
    yield "record", record.smooth(200.0).resample(2)
    yield "identification", found
    yield "instruments", eoi.identify(plant, record, instruments=True)
    yield "refinement", refined
    yield "validation", eoi.validate(plant, [record, held_out])
    yield "diagnosis", eoi.diagnose(found)
    yield "uncertainty", eoi.uncertainty(found)
    yield "profile", eoi.profile(refined, record, "alpha")
    yield "remaining", eoi.remaining(refined, validation=held_out)
    yield "discovery", _discovered()
    methods = [eoi.comparators.StateVariableFilter()]
    yield "comparison", eoi.compare(plant, record, methods=methods)
    yield "inspection", _inspected(record)
    yield "saturation", Saturation("run", "voltage", 1.0, 0.2)
    yield "observers", OBSERVERS
    yield "library", {name: getattr(eoi.plants, name)() for name in LIBRARY}
    yield "effects", [_with(effect) for effect in (*eoi.effects.standard(), *eoi.effects.rare())]
    yield "equations", _equations()
    yield (
        "linear",
        {
            "poles": eoi.plant_from_control(control.tf([2.0], [1.0, 3.0, 5.0])),
            "zeros": eoi.plant_from_control(control.tf([1.0, 2.0], [1.0, 3.0, 5.0])),
        },
    )


def _with(effect: Any) -> eoi.Plant:
    """A plant with an effect."""
    inside = isinstance(effect, eoi.effects.AbstractInternalEffect)
    base = eoi.plants.cascaded_tanks() if inside else eoi.plants.mass_spring_damper()
    placed = place(base, effect, 0)
    return augmented(base, (placed,), dict.fromkeys(placed.names, 0.1))


def _discovered() -> eoi.Discovery:
    """Dry friction that was found."""
    plant, time = eoi.plants.mass_spring_damper(), np.arange(1500) * 4e-3
    placed = place(plant, eoi.effects.CoulombFriction(), 0)
    true = augmented(plant, (placed,), dict.fromkeys(placed.names, 1.0))
    draw, records = np.random.default_rng(1), []
    for hertz in (0.5, 0.8):
        clean = eoi.simulate(true, time, eoi.excitation.square(time, 10.0, hertz), substeps=4)
        noise = 1e-5 * draw.standard_normal(clean.outputs.shape)
        records.append(clean.with_outputs(clean.outputs + noise, f"{hertz} Hz"))
    found = eoi.discover(plant, *records, effects=["coulomb_friction", "cubic_stiffness"])
    assert found.effects == ("coulomb_friction",), found.effects
    return found


def _inspected(record: eoi.Record) -> eoi.Inspection:
    """A file whose clock runs unevenly."""
    time = record.time + 1e-4 * np.random.default_rng(2).uniform(size=len(record))
    table = np.column_stack([time, record.inputs, record.outputs])
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "run.csv"
        np.savetxt(file, table, delimiter=",", header="time,voltage,angle", comments="")
        return eoi.inspect(file)


def _equations() -> eoi.Plant:
    return eoi.plant_from_text(
        {"angle": "rate", "rate": "-a*sin(angle) - d*rate + b*z", "z": "(voltage - z)/tau"},
        {"a": 60.0, "d": 2.0, "b": 40.0, "tau": 0.1, "delay": 0.02, "z0": 0.5},
        ["angle"], ["voltage"], initial={"z": "z0"}, input_delay={"voltage": "delay"},
        units={"angle": "rad", "voltage": "V"},
    )  # fmt: skip


def main() -> None:
    """Write them."""
    eoi.configure(cache=False)
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, result in written():
            save(result, folder / f"{name}.npz")


if __name__ == "__main__":
    main()
