"""What free runs on held-out records say of an answer: it holds, or they even confirm it."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from eoi_jax.data.record import Record
from eoi_jax.simulation.validate import FreeRuns, Validation

_CONFIRMED = 2.0 / 3.0  # error after over before, of every free run, up to which it is confirmed
_NOISE = 3.0  # error of short free runs over the noise of a sensor, from which on it is not noise
_AS_GOOD = 1.01  # error of a simpler law over that of a wider one, up to which it is preferred


def holds(before: FreeRuns, after: FreeRuns) -> bool:
    """Whether the free run is better, whole or in windows: one lightly damped drifts in phase."""
    short = after[0] if after[1] is None else after[1]
    if np.all(short.nrmse > 1.0):
        return False  # a constant would predict better
    growth = [float(np.sum(one)) for one in _growth(before, after)]
    return not growth or min(growth) < 0.0


def confirmed(before: FreeRuns, after: FreeRuns) -> bool:
    """Whether all free runs, whole and in windows, lose a good part of their error."""
    return all(bool(np.all(new.rmse < _CONFIRMED * old.rmse)) for old, new in _pairs(before, after))


def only_short(before: FreeRuns, after: FreeRuns) -> bool:
    """Whether only short free runs tell anything: whole ones drift in phase, or diverge."""
    if before[1] is None or after[1] is None or not np.all(np.isfinite(after[1].rmse)):
        return False
    if not np.all(np.isfinite(after[0].rmse)):
        return True
    whole, short = (float(np.sum(one)) for one in _growth(before, after))
    return short < 0.0 <= whole


def as_good(plain: FreeRuns, wide: FreeRuns) -> bool:
    """Whether neither whole nor short free runs of the simpler model miss by more.

    By the geometric mean over the outputs: a fit anew moves all of them a little.
    """
    return all(bool(np.mean(one) <= np.log(_AS_GOOD)) for one in _growth(wide, plain))


def beyond_noise(short: Validation | None, records: Sequence[Record]) -> list[str]:
    """A sentence for each output whose free runs in windows miss by far more than its noise.

    Of a right model they miss by the noise, and by what an initial state adds that was estimated
    from few samples. Whole runs may drift in phase, and say nothing here.
    """
    if short is None:
        return []
    noise = np.max([record.noise for record in records], axis=0)
    return [
        _DOUBT.format(name, error / sigma)
        for name, error, sigma in zip(records[0].output_names, short.rmse, noise, strict=True)
        if sigma > 0 and error > _NOISE * sigma
    ]


def _growth(before: FreeRuns, after: FreeRuns) -> list[Float[np.ndarray, " ny"]]:
    """Logarithm of error after over before, whole and in windows; none where both diverge."""
    return [
        np.log(np.maximum(new.rmse, 1e-300)) - np.log(np.maximum(old.rmse, 1e-300))
        for old, new in _pairs(before, after)
        if np.all(np.isfinite(old.rmse)) or np.all(np.isfinite(new.rmse))
    ]


def _pairs(before: FreeRuns, after: FreeRuns) -> list[tuple[Validation, Validation]]:
    """Free runs of one length, before and after, where there are both."""
    return [(old, new) for old, new in zip(before, after, strict=True) if old and new]


_DOUBT = (
    "free runs of {} in windows miss by {:.2g} times the noise of its sensor, though the injection "
    "shows nothing beyond that noise: it hides what is missing, or spoils the estimate"
)
