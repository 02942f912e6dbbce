"""Whether free runs on held-out records accept an answer, or even confirm it."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from eoi_jax._checks import counted
from eoi_jax.data.holds import moves
from eoi_jax.discovery.input_noise import error_of_input_noise
from eoi_jax.discovery.rules import RULES
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.sensor_noise import sensor_noise, shows_noise
from eoi_jax.simulation.validate import FreeRuns
from eoi_jax.simulation.validation import Validation

_RULES = RULES.answer
# n times that of 1 - G/S: 4 (ρ₁² + ρ₂²), of weights -½, 1, -½, whose ρ₁ is -2/3 and ρ₂ 1/6.
_VARIANCE = 17.0 / 9.0

_HIDDEN = (
    ", though the injection shows nothing beyond that noise: it hides what is missing, or spoils "
    "the estimate"
)


def holds(prior: FreeRuns, after: FreeRuns) -> bool:
    """Whether the free run improves, whole or in windows: lightly damped plants drift in phase."""
    short = after[0] if after[1] is None else after[1]
    if np.all(short.nrmse > 1.0):
        return False  # a constant would predict better
    growth = [float(np.sum(log_ratio)) for log_ratio in _growth(prior, after)]
    return not growth or min(growth) < 0.0


def confirmed(prior: FreeRuns, after: FreeRuns) -> bool:
    """Whether the error of all free runs, whole and in windows, falls by at least a third."""
    return all(
        bool(np.all(new.rmse < _RULES.confirmed * old.rmse)) for old, new in _pairs(prior, after)
    )


def only_short(prior: FreeRuns, after: FreeRuns) -> bool:
    """Whether only short free runs improve, because the whole ones drift in phase or diverge."""
    if prior[1] is None or after[1] is None or not np.all(np.isfinite(after[1].rmse)):
        return False
    if not np.all(np.isfinite(after[0].rmse)):
        return True
    whole_growth, short_growth = (float(np.sum(log_ratio)) for log_ratio in _growth(prior, after))
    return short_growth < 0.0 <= whole_growth


def drifts(long_runs: Validation, windows: Validation) -> bool:
    """Whether long free runs leave the record where short ones stay near it, in some output.

    Their error is infinite, or larger by as much as confirms an effect.
    """
    return not bool(np.all(_RULES.confirmed * long_runs.rmse <= windows.rmse))


def as_good(plain: FreeRuns, wide: FreeRuns) -> bool:
    """Whether the errors of a simpler model are no larger, in whole and in short free runs.

    The measure is the geometric mean over the outputs: a new fit changes all of them slightly.
    """
    return all(
        bool(np.mean(log_ratio) <= np.log(_RULES.as_good)) for log_ratio in _growth(wide, plain)
    )


def beyond_noise(
    runs: Validation | None,
    conclusion: str = "",
    full_runs: Validation | None = None,
    plant: Plant | None = None,
) -> list[str]:
    """A sentence for each output whose error in free runs, in windows, far exceeds its noise.

    The error of a correct model is the noise plus the effect of an initial state that is estimated
    from few samples. Whole runs may drift in phase, and are asked where there are no others, or
    where these score few samples. Where differences show motion, and the noise is known from above
    alone, there is less room between both.

    A window starts from what all outputs show: one that is wrong spoils the windows of others,
    which are told with it where their whole runs do not miss.

    Args:
        runs: free runs in windows, or whole ones of short records; None: no sentence.
        conclusion: end of the sentence; by default what may be the cause.
        full_runs: free runs of whole records; None: not asked.
        plant: of which they are: what noise in the log of its inputs makes them miss by is expected
            as well. None: of the noise of sensors alone.
    """
    if runs is None:
        return []
    conclusion = conclusion or or_input(_HIDDEN, runs)
    times = _times_expected(runs, _expected(plant, runs))
    spoilt = np.zeros(times.shape, dtype=bool)
    if full_runs is not None and runs.window is not None:
        spoilt = (times > 0.0) & (_times_expected(full_runs, _expected(plant, full_runs)) == 0.0)
    if np.all(spoilt[times > 0.0]):
        return _sentences(runs, times, conclusion)
    misses = [f"{runs.outputs[j]} by {times[j]:.2g} times" for j in np.flatnonzero(spoilt).tolist()]
    beside = _SPOILT.format(" and ".join(misses)) if misses else ""
    return _sentences(runs, np.where(spoilt, 0.0, times), beside + conclusion)


def _expected(plant: Plant | None, runs: Validation) -> Float[np.ndarray, " ny"]:
    """The noise of sensors, and what that of inputs makes, where runs miss by more than the former.

    The draws of that noise cost as many free runs.
    """
    noise = sensor_noise(runs)
    if plant is None or not np.any(_times_expected(runs, noise)):
        return noise
    return np.hypot(noise, error_of_input_noise(plant, runs))


def explained_by_inputs(runs: Validation | None, plant: Plant) -> list[str]:
    """A sentence where noise in the log of inputs explains by how much free runs miss.

    Args:
        runs: free runs in windows, or whole ones of short records; None: no sentence.
        plant: of which they are.
    """
    if runs is None or not beyond_noise(runs) or beyond_noise(runs, plant=plant):
        return []
    times = _times_expected(runs, sensor_noise(runs))
    misses = [
        f"of {runs.outputs[j]} miss by {times[j]:.2g} times"
        for j in np.flatnonzero(times > 0.0).tolist()
    ]
    length = "" if runs.window is None else " in windows"
    return [_BY_INPUTS.format(length, ", and ".join(misses))]


def is_undecided(runs: Validation) -> Bool[np.ndarray, " ny"]:
    """Outputs that miss by far more than their noise, of which only few samples tell the size.

    Where differences of the samples show motion, what few differences of errors show as noise may
    be too small by chance: neither noise nor motion is shown.
    """
    times = runs.rmse / np.maximum(sensor_noise(runs), np.finfo(float).tiny)
    return ~shows_noise(runs) & (times > RULES.answer.noise)


def leave_noise(free_runs: Sequence[Validation]) -> bool:
    r"""Whether free runs leave white noise at the samples of each output, as far as these tell.

    What an error differs by from the straight line between its neighbours in time shows the
    variance G of white errors, whatever the spacing, and of slow errors less. Of n white errors
    with the mean square S, 1 - G/S is normal about zero with the variance 17/(9 n), as at equal
    spacings.

    Args:
        free_runs: of one model, on the records of the fit and on others.

    Source:
        T. Gasser, L. Sroka, C. Jennen-Steinmetz, Biometrika 73 (1986) 625, for G; J. von Neumann,
        Ann. Math. Statist. 12 (1941) 367, for a ratio of this kind.
    """
    from scipy.special import ndtri  # only discovery needs it

    errors = [error for run in free_runs for error in run.residual]
    times = [record.time for run in free_runs for record in run.records]
    for channels in zip(*(error.T for error in errors), strict=True):
        scored = [np.isfinite(channel) for channel in channels]
        squares = (
            np.concatenate([channel[mask] for channel, mask in zip(channels, scored, strict=True)])
            ** 2
        )
        parts = zip(times, channels, scored, strict=True)
        pseudo = np.concatenate([_off_line(time[mask], part[mask]) for time, part, mask in parts])
        if not len(pseudo):
            return False
        slow = np.mean(squares) - np.mean(pseudo**2)
        deviations = np.sqrt(len(squares) / _VARIANCE)
        if not slow * deviations <= ndtri(_RULES.by_chance) * np.mean(squares):
            return False
    return True


def _off_line(
    time: Float[np.ndarray, " samples"], errors: Float[np.ndarray, " samples"]
) -> Float[np.ndarray, " inner"]:
    """Distance of each error from the line between its neighbours, over that of unit noise."""
    share = (time[2:] - time[1:-1]) / (time[2:] - time[:-2])
    distance = errors[1:-1] - share * errors[:-2] - (1.0 - share) * errors[2:]
    return distance / np.sqrt(1.0 + share**2 + (1.0 - share) ** 2)


def excesses(runs: Validation, expected: Float[np.ndarray, " ny"]) -> list[str]:
    """A sentence for each output whose error far exceeds what is expected of a right model.

    Args:
        runs: free runs, whole or in windows.
        expected: error of a right model [unit of y].

    Returns:
        The sentences; that of the output which misses by most times its noise comes first.
    """
    return _sentences(runs, _times_expected(runs, expected), or_input(_HIDDEN, runs))


def or_input(causes: str, runs: Validation) -> str:
    """What may make free runs miss; where an input moves, it may have been logged otherwise."""
    driven = any(moves(record, j) for record in runs.records for j in range(record.inputs.shape[1]))
    return f"{causes}{_INPUT}" if driven else causes


def _times_expected(
    runs: Validation, expected: Float[np.ndarray, " ny"]
) -> Float[np.ndarray, " ny"]:
    """Error of each output over what is expected of a right model; 0 where it is not far more."""
    limits = np.maximum(_limits(runs), _by_chance(runs))
    exceeds = (expected > 0.0) & (runs.rmse > limits * expected)
    return np.where(exceeds, runs.rmse, 0.0) / np.where(exceeds, expected, 1.0)


def _limits(runs: Validation) -> Float[np.ndarray, " ny"]:
    """Error of each output over its noise, above which it is not noise, were that known."""
    return np.where(shows_noise(runs), _RULES.noise, _RULES.bounded_noise)


def _by_chance(runs: Validation) -> float:
    """The same that noise which is read off so few samples explains by chance.

    It is read off differences, of which a third are independent, about: it may come out small.
    """
    from scipy.special import fdtri  # only discovery needs it

    of_ratio = fdtri(max(runs.scored, 1), max(runs.scored / 3.0, 1.0), _RULES.by_chance)
    return float(np.sqrt(of_ratio))


def unsure_noise(runs: Validation, noise: Float[np.ndarray, " ny"]) -> str:
    """In words, where only few samples make it possible that an error is noise; or "".

    Args:
        runs: free runs, whole or in windows, which miss by no more than what they may by chance.
        noise: of each output [unit of y].
    """
    if not np.any((noise > 0.0) & (runs.rmse > _limits(runs) * noise)):
        return ""
    return _UNSURE.format(counted(runs.scored, "sample"), _by_chance(runs))


def _sentences(runs: Validation, times: Float[np.ndarray, " ny"], conclusion: str) -> list[str]:
    """A sentence for each output that misses by so many times its noise, the most first."""
    length = "" if runs.window is None else " in windows"
    return [
        _EXCESS.format(runs.outputs[j], length, times[j], conclusion)
        for j in np.argsort(-times, kind="stable").tolist()
        if times[j] > 0.0
    ]


def _growth(prior: FreeRuns, after: FreeRuns) -> list[Float[np.ndarray, " ny"]]:
    """Logarithm of the error ratio after/before, whole and in windows; no entry if both diverge."""
    return [
        np.log(np.maximum(new.rmse, 1e-300)) - np.log(np.maximum(old.rmse, 1e-300))
        for old, new in _pairs(prior, after)
        if np.all(np.isfinite(old.rmse)) or np.all(np.isfinite(new.rmse))
    ]


def _pairs(prior: FreeRuns, after: FreeRuns) -> list[tuple[Validation, Validation]]:
    """Free runs of the same length, before and after; lengths without both are left out."""
    return [(old, new) for old, new in zip(prior, after, strict=True) if old and new]


_EXCESS = "free runs of {}{} miss by {:.2g} times the noise of its sensor{}"
_UNSURE = ", which {} tell to within a factor of {:.2g} only"
_BY_INPUTS = (
    "free runs{} {} the noise of its sensor: noise in the log of the inputs, which scatters about "
    "their levels and did not act, explains as much"
)
_INPUT = ", or an input acted otherwise than its log, which may be noisy or inexact"
_SPOILT = " (and {} in windows alone, which start from what all outputs show)"
