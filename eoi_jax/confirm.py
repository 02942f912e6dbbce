"""What free runs on held-out records say of an answer: it holds, or they even confirm it."""

import numpy as np

from eoi_jax.validate import FreeRuns

_CONFIRMED = 2.0 / 3.0  # error after over before, of every free run, up to which it is confirmed


def holds(before: FreeRuns, after: FreeRuns) -> bool:
    """Whether the free run is better, whole or in windows: one lightly damped drifts in phase."""
    short = after[0] if after[1] is None else after[1]
    if np.all(short.nrmse > 1.0):
        return False  # a constant would predict better
    pairs = [(old, new) for old, new in zip(before, after, strict=True) if old and new]
    better = [
        float(np.sum(np.log(np.maximum(new.rmse, 1e-300) / np.maximum(old.rmse, 1e-300))))
        for old, new in pairs
        if np.all(np.isfinite(old.rmse)) or np.all(np.isfinite(new.rmse))
    ]
    return not better or min(better) < 0.0


def confirmed(before: FreeRuns, after: FreeRuns) -> bool:
    """Whether all free runs, whole and in windows, lose a good part of their error."""
    pairs = [(old, new) for old, new in zip(before, after, strict=True) if old and new]
    return all(bool(np.all(new.rmse < _CONFIRMED * old.rmse)) for old, new in pairs)
