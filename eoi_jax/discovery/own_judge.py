"""A part of the records that judges, where none were given and those of the fit leave it open.

What explains the records of the fit may stand in for what they lack: a sinusoid in time for dry
friction. Free runs on a part that the fit does not see tell them apart: the end of each record, or
of several that are too short for that whole ones. A single short record leaves nothing to hold out:
there the declared model is refined, and judged on the record of its fit.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eoi_jax._status import Status
from eoi_jax.data.holds import with_hold
from eoi_jax.data.record import Record
from eoi_jax.data.windows import window_length
from eoi_jax.discovery.confirm import beyond_noise
from eoi_jax.discovery.doubts import is_doubtful, telling_runs
from eoi_jax.discovery.free_run_trials import refined
from eoi_jax.discovery.judge import Judge, mean_error
from eoi_jax.discovery.refined import best_refinement, refined_passes
from eoi_jax.discovery.result import Discovery
from eoi_jax.discovery.rules import RULES
from eoi_jax.estimation.holdout import check_runs, longest_start, resting_outputs
from eoi_jax.estimation.preparation import prepare_records
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.sensor_noise import sensor_noise
from eoi_jax.simulation.validate import whole_and_windows

_RULES = RULES.questions


def needs_judge(discovery: Discovery, records: Sequence[Record]) -> bool:
    """Whether records of the fit alone leave it open what is missing.

    Without an answer, with effects that may stand in for others, with such as free runs do not
    confirm, and with free runs that miss by more than noise, whole or in windows. Those of outputs
    that are functions of the states are not searched.

    Args:
        discovery: the answer so far.
        records: of the fit, as given.
    """
    if not discovery.in_sample or discovery.declared.nominal.has_algebraic:
        return False
    if discovery.status.code not in ("complete", "nothing_missing"):
        return discovery.status.code == "unexplained"
    runs = [run for run in (discovery.after, discovery.windows_after) if run is not None]
    misses = any(np.any(run.rmse > _RULES.silent * sensor_noise(run)) for run in runs)
    if misses or is_doubtful(discovery.added):
        return True
    return bool(discovery.added) and not _is_confirmed(discovery, records)


def _is_confirmed(discovery: Discovery, records: Sequence[Record]) -> bool:
    """Whether an answer lowers the errors of the declared model, refined, as confirms an effect.

    Passes whose parameters are biased leave what an effect may make up for.
    """
    declared, settled = discovery.declared, discovery.held_out[0]
    records = with_hold(tuple(records), settled.hold, settled.skew)
    judge = Judge.of(records, declared.plant)
    if judge is None:
        return True
    starts = declared.plant, declared.nominal
    bases = [refined(start, (), records, judge) for start in starts]
    errors = [base.error for base in bases if base is not None]
    limit = min(errors, default=np.inf) + np.log(RULES.answer.confirmed)
    return bool(mean_error(judge.runs(discovery.plant)) < limit)


@dataclass(frozen=True)
class Division:
    """Records of the fit in two parts.

    Attributes:
        fitted: what is fitted.
        judging: what judges.
        note: what was held out.
        in_fit: end of a sentence on what is seen in the first part alone.
    """

    fitted: tuple[Record, ...]
    judging: tuple[Record, ...]
    note: str
    in_fit: str


def divided(
    plant: Plant, records: Sequence[Record], window: float | None = None
) -> Division | None:
    """Records and what is held out of them; None where they are too short, or too few, for that.

    The end of each; of a record that comes to rest before it ends, the end of its motion and the
    rest. Where these are too short to judge, the last of several records.

    Args:
        plant: the declared model.
        records: to divide, as given.
        window: length of re-initialised free runs [s]; None: by default.
    """
    kept = 1.0 - _RULES.own_share
    try:
        parts = [record.split(kept * _share_in_motion(record)) for record in records]
    except ValueError:  # a part of fewer samples than a record has
        parts = []
    if parts:
        fitted, judging = (tuple(group) for group in zip(*parts, strict=True))
        if _can_judge(plant, fitted, judging, window):
            note = _OF_EACH.format(100.0 * _RULES.own_share)
            return Division(fitted, judging, note, _IN_FIT)
    if len(records) < 2:
        return None
    count = max(1, round(_RULES.own_share * len(records)))
    fitted, judging = tuple(records[:-count]), tuple(records[-count:])
    if not _can_judge(plant, fitted, judging, window):
        return None
    names = " and ".join(record.name for record in judging)
    return Division(fitted, judging, _WHOLE.format(names), _LOCAL)


def _can_judge(
    plant: Plant, fitted: tuple[Record, ...], judging: tuple[Record, ...], window: float | None
) -> bool:
    """Whether free runs of both parts can be scored, and those of the second one judge."""
    try:
        check_runs(plant, fitted, judging, window)
    except ValueError:  # too few valid samples
        return False
    return Judge.of(judging, plant) is not None


def _share_in_motion(record: Record, places: int = 20) -> float:
    """Share of a record after which its outputs rest, to one part in `places`."""
    for place in range(1, places):
        rest = record.part(place * len(record) // places, len(record))
        if len(resting_outputs([rest], [record])) == len(record.output_names):
            return place / places
    return 1.0


def with_own_judge(
    discovery: Discovery,
    division: Division | None,
    search: Callable[[tuple[Record, ...], tuple[Record, ...]], Discovery],
) -> Discovery:
    """The answer of a search that holds records out, where it comes to one; else as it was.

    An end in which nothing is seen does not show that nothing is missing: what dies away, as that
    of a decay, is in the records of the fit alone.

    Args:
        discovery: the answer without held-out records.
        division: of the records, as given; None: none can be held out.
        search: on records of a fit, and on others that judge.
    """
    if division is None:
        return _judged_in_sample(discovery)
    judged = search(division.fitted, division.judging)
    if judged.status.code == "no_data":
        return discovery
    judged = replace(judged, notes=(division.note, *judged.notes))
    if judged.status.code != "nothing_missing":
        return judged
    settled, plant = judged.held_out[0], judged.plant
    fitted = with_hold(division.fitted, settled.hold, settled.skew)
    window = window_length(fitted, 2 * longest_start(plant, fitted))
    long_runs, short_runs = whole_and_windows(plant, fitted, window)
    misses = beyond_noise(short_runs or long_runs, division.in_fit, plant=plant)
    return replace(judged, status=Status("unexplained", misses[0])) if misses else judged


def _judged_in_sample(discovery: Discovery) -> Discovery:
    """An answer without held-out records of which none can be held out, which says so.

    Where nothing explains what the passes leave, the declared model is refined: passes over few
    samples are biased, and what they leave is then no sign of a missing effect.

    Args:
        discovery: the answer, on the records of the fit.
    """
    noted = replace(discovery, notes=(*discovery.notes, _TOO_SHORT))
    declared, records = discovery.declared, discovery.held_out
    if discovery.status.code != "unexplained" or discovery.before is None:
        return noted
    result = best_refinement([declared.plant, declared.nominal], records)
    if not result.status.ok:
        return noted
    prepared = prepare_records(declared.nominal, records, declared.lowpass)
    answer = refined_passes(noted, result, prepared)
    misses = beyond_noise(telling_runs(answer), _REFINED_MISSES, answer.after, answer.plant)
    if misses:
        message = f"{discovery.status.message}; {misses[0]}"
        return replace(answer, status=Status("unexplained", message))
    status = Status("nothing_missing", _NOTHING_MISSING)
    return replace(answer, status=status, diagnosis=None, lead=None)


_OF_EACH = (
    "no `validation` was given, and the records alone leave open what is missing: of the motion in "
    "each the last {:.3g} % were held out, and judge. Give `validation` for others"
)
_WHOLE = (
    "no `validation` was given, and the records alone leave open what is missing: their ends are "
    "too short to judge, so that {} was held out as a whole, and judges. Give `validation` for "
    "other records"
)
_TOO_SHORT = (
    "no `validation` was given, and the records are too short, or too few, to hold any of them "
    "out: the answer is that of the records of the fit alone. Give `validation`: another record"
)
_IN_FIT = (
    " on the records of the fit, though not on the end of their motion, which was held out: what "
    "is missing dies away before. Hold out other records (`validation`)"
)
_LOCAL = (
    " on the records of the fit, though not on what was held out: what is missing is not in all "
    "records. Hold out other ones (`validation`)"
)
_REFINED_MISSES = ", also with the declared model refined"
_NOTHING_MISSING = (
    "refined, the declared model misses the records of the fit by no more than noise in free runs"
)
