r"""The best gains of a sweep, by a criterion that compares all of them.

The index of a lane depends on its filter: a lower cut-off passes less of the model's error, and
less noise. So it cannot compare filters or observers. Two criteria can: the index of the
*estimates* under one observer and one filter for all lanes (`common_index`: those that `identify`
would choose for the record), and the error of a free-run simulation on hold-out records. The second
is better and costs more; it is computed for the lanes that are best by the first.

Outside sliding mode the injection is not the model's error, and small changes of anything, also by
rounding, grow: lanes there scatter about the others, and among many of them some have a smaller
index by chance. So a lane in sliding mode comes before one that is not and is better by next to
nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eoi_jax._checks import check, counted, percent, warn_caller
from eoi_jax.data.record import Record
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.validate import judged_runs

_LANE_DIMENSIONS = ("lowpass", "observer", "start")


@dataclass(frozen=True)
class BestRules:
    """What counts as sliding, and as equally good.

    Attributes:
        sliding: share of the scored steps in sliding mode, of every output and record.
        margin: by which the score of a lane that slides less must be smaller: a hundredth of the
            index or of the error.
    """

    sliding: float = 0.9
    margin: float = 0.01


_RULES = BestRules()


def best(
    sweep: Any,
    plant: Plant | None = None,
    validation: Record | Sequence[Record] | None = None,
    shortlist: int = 16,
) -> Any:
    """The filter, observer and start that are best for all records of a sweep.

    Args:
        sweep: of `eoi_jax.sweep`.
        plant: that was swept; needed with `validation`.
        validation: hold-out records for free runs. Default: the common index decides.
        shortlist: number of lanes, best common index first, that are simulated.

    Returns:
        The sweep at that lane, with all records and resamples; ``score`` is the value of the
        criterion, which the attribute ``criterion`` describes.

        Of lanes whose score is within a hundredth of the smallest, one in sliding mode.

    Warns:
        RuntimeWarning: the observer of that lane is in sliding mode in less than 90 % of the scored
            steps.

    Raises:
        ValueError: no lane has an answer for every record; `validation` without a plant.
    """
    check(
        validation is None or plant is not None,
        "plant",
        "must be given with `validation`, for the free run",
        plant,
    )
    check(shortlist >= 1, "shortlist", "must be an integer ≥ 1", shortlist)
    as_measured = sweep.sel(resample=0)
    logs = np.log(as_measured["common_index"]).sum("output", skipna=False)
    logs = logs.where(as_measured["ok"])
    score = logs.mean("record", skipna=False).transpose(*_LANE_DIMENSIONS)
    count = int(np.isfinite(score).sum())
    check(
        count > 0,
        "sweep",
        "must have a lane with an answer for every record",
        f"none of {score.size}",
        "Its `status` says why: `flag_meanings` names the numbers.",
    )
    sliding = as_measured["sliding_fraction"].min(["output", "record"])
    sliding = sliding.transpose(*_LANE_DIMENSIONS).values
    order = _order(np.where(np.isfinite(score), score, np.inf).ravel(), sliding.ravel())
    lanes = [np.unravel_index(lane, score.shape) for lane in order[:count]]
    if plant is None or validation is None:
        chosen, value = lanes[0], float(score.values[lanes[0]])
        criterion = "log of the common index, summed over outputs, mean over records"
    else:
        values = [_free_run(as_measured, plant, validation, lane) for lane in lanes[:shortlist]]
        place = _order(np.array(values), np.array([sliding[lane] for lane in lanes[:shortlist]]))[0]
        chosen, value = lanes[place], values[place]
        criterion = (
            "log of the held-out free run's NRMSE, summed over outputs, mean over records; "
            f"of the {counted(len(values), 'lane')} with the smallest common index"
        )
    if sliding[chosen] < _RULES.sliding:
        warn_caller(_LEAVES.format(percent(sliding[chosen])), RuntimeWarning)
    picked = sweep.isel(dict(zip(_LANE_DIMENSIONS, (int(i) for i in chosen), strict=True)))
    return picked.assign(score=value).assign_attrs(criterion=criterion)


_LEAVES = (
    "The best lane is in sliding mode in only {} of the scored steps, and no lane that stays there "
    "is as good: its injection is not the model's error while the relay saturates, its standard "
    "errors are too small, and its estimate depends on rounding. Raise the gains of the relay"
)


def _order(score: np.ndarray, sliding: np.ndarray) -> np.ndarray:
    """Numbers of lanes, the best first; of those as good as it one in sliding mode."""
    penalty = np.where(sliding >= _RULES.sliding, 0.0, _RULES.margin)
    return np.argsort(score + penalty, kind="stable")


def _free_run(
    sweep: Any, plant: Plant, validation: Record | Sequence[Record], lane: tuple
) -> float:
    """Σ_j log NRMSE_j of one lane's estimates, mean over its records; inf if one diverges."""
    estimates: Any = sweep["parameters"].isel(
        dict(zip(_LANE_DIMENSIONS, map(int, lane), strict=True))
    )
    scores = []
    for theta in estimates.values:
        error = np.atleast_1d(judged_runs(plant.with_parameters(theta), validation).nrmse)
        scores.append(np.sum(np.log(np.where(np.isfinite(error), error, np.inf))))
    return float(np.mean(scores))
