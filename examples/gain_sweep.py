"""A thousand relays and dampings of an observer, three filters: which of them may be trusted.

    python examples/gain_sweep.py [FOLDER]

writes `gain_sweep.png`: where the relay c3 is too small to slide, the estimate is worthless; above
that neither the gains nor the filter matter much here.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np

import eoi_jax as eoi
from eoi_jax.observers import SecondOrder, gains


def main(folder: Path, relays: int = 40, dampings: int = 25) -> Any:
    """Sweep, print the best by a held-out free run, draw."""
    eoi.configure()
    from eoi_jax.report.sweep import sweep_figure

    plant = eoi.plants.pendulum()
    rig = plant.with_parameters({"a": 81.0, "b": 1.7, "c": 0.3})
    time = np.arange(0.0, 20.0, 2e-3)
    clean = eoi.simulate(rig, time, eoi.excitation.square(time, amplitude=0.2, frequency=0.2))
    noise = 1e-5 * np.random.default_rng(0).standard_normal(clean.outputs.shape)
    fit, judge = clean.with_outputs(clean.outputs + noise, "pendulum").split(0.6)
    sets = {
        "c1": np.geomspace(5.0, 100.0, dampings),
        "c2": 60.0,
        "c3": np.geomspace(0.1, 1e4, relays),
    }
    filters = [eoi.LowPass(cutoff) for cutoff in (5.0, 15.0, 45.0)]
    result = eoi.sweep(plant, fit, gains(SecondOrder, sets, grid=True), filters)
    chosen = eoi.best(result, plant, validation=judge)
    sizes = f"{result.sizes['observer']} gain sets, {result.sizes['lowpass']} filters"
    relay, cutoff = chosen["c3"].item(), chosen["cutoff"].item()
    print(f"{sizes}: best c3 {relay:.3g}, cut-off {cutoff:g} rad/s")
    sweep_figure(result).savefig(folder / "gain_sweep.png")
    return chosen


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
