"""A tank, its pump's voltage and its level: nominal parameters that are far off, identified.

    python examples/first_rig.py [FOLDER]

writes `first_rig.png`. The plant is the level tank of the paper (section 5.1): the outflow goes
with the square root of the level, and both of its parameters are unknown.
"""

import sys
from pathlib import Path

import numpy as np

import eoi_jax as eoi


def records(duration: float) -> tuple[eoi.Record, eoi.Record]:
    """Two simulated days at the tank: one to fit, one to judge."""
    tank = eoi.plants.level_tank(true=True)
    time = np.arange(0.0, duration, 2e-3)
    rng = np.random.default_rng(0)
    made = []
    for seed in (1, 2):
        voltage = eoi.excitation.random_steps(time, 4.0, 9.0, 2.0, seed=seed)
        run = eoi.simulate(tank, time, voltage, initial=[0.5], hold="zero", name=f"day {seed}")
        noisy = run.outputs + 1e-4 * rng.standard_normal(run.outputs.shape)
        made.append(run.with_outputs(noisy, run.name))
    return made[0], made[1]


def main(folder: Path, duration: float = 60.0) -> eoi.Identification:
    """Identify, judge by a free run on the other day, draw."""
    eoi.configure()
    fit, judge = records(duration)
    found = eoi.identify(eoi.plants.level_tank(), fit)
    print(found)
    print(eoi.validate(found.plant, judge))
    found.plot().savefig(folder / "first_rig.png")
    return found


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
