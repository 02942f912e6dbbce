"""A mass on a spring with a gap in it, declared without the gap: found, added, judged.

    python examples/missing_effect.py [FOLDER]

writes `missing_effect.png`.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import eoi_jax as eoi


def declared(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
    """What the drawing says: mass, damper, spring."""
    (position,), (rate,) = x.y
    return u - p.damper * rate - p.spring * position


def worn(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
    """What stands in the workshop: the spring does not touch within 0.2 of the middle."""
    (position,), (rate,) = x.y
    stretched = position - jnp.clip(position, -0.2, 0.2)
    return u - p.damper * rate - p.spring * stretched


def main(folder: Path, effects: Sequence[str] | None = None) -> eoi.Discovery:
    """Discover on the first 70 % of a record, judge on the rest, draw."""
    eoi.configure()
    model = eoi.Plant(declared, {"damper": 1.0, "spring": 20.0}, relative_degree=2)
    rig = eoi.Plant(worn, {"damper": 1.5, "spring": 30.0}, relative_degree=2)
    time = np.arange(0.0, 40.0, 0.01)
    force = eoi.excitation.random_steps(time, -12.0, 12.0, 0.8, seed=1)
    clean = eoi.simulate(rig, time, force, hold="zero")
    noise = 5e-4 * np.random.default_rng(0).standard_normal(clean.outputs.shape)
    record = clean.with_outputs(clean.outputs + noise, "workshop")
    found = eoi.discover(model, record, validation=0.3, effects=effects)
    print(found)
    found.plot().savefig(folder / "missing_effect.png")
    return found


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
