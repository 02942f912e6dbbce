"""A part of the records that judges, where none were given and those of the fit leave it open.

What explains the records of the fit may stand in for what they lack: a sinusoid in time for dry
friction. Free runs on a part that the fit does not see tell them apart.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eoi_jax._status import Status
from eoi_jax.data.holds import with_hold
from eoi_jax.data.record import Record
from eoi_jax.data.windows import window_length
from eoi_jax.discovery.confirm import beyond_noise
from eoi_jax.discovery.doubts import is_doubtful
from eoi_jax.discovery.free_run_trials import refined
from eoi_jax.discovery.judge import Judge, mean_error
from eoi_jax.discovery.result import Discovery
from eoi_jax.discovery.rules import RULES
from eoi_jax.estimation.holdout import check_runs, longest_start, resting_outputs
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


def with_share(
    plant: Plant, records: Sequence[Record], window: float | None = None
) -> tuple[tuple[Record, ...], tuple[Record, ...]] | None:
    """Records without their ends, and these ends; None where they are too short to judge.

    Of a record that comes to rest before it ends, the end of its motion and the rest.

    Args:
        plant: the declared model.
        records: to divide, as given.
        window: length of re-initialised free runs [s]; None: by default.
    """
    kept = 1.0 - _RULES.own_share
    try:
        parts = [record.split(kept * _share_in_motion(record)) for record in records]
        fitted, judging = (tuple(group) for group in zip(*parts, strict=True))
        check_runs(plant, fitted, judging, window)
    except ValueError:  # too few valid samples for two records
        return None
    return None if Judge.of(judging, plant) is None else (fitted, judging)


def _share_in_motion(record: Record, places: int = 20) -> float:
    """Share of a record after which its outputs rest, to one part in `places`."""
    for place in range(1, places):
        rest = record.part(place * len(record) // places, len(record))
        if len(resting_outputs([rest], [record])) == len(record.output_names):
            return place / places
    return 1.0


def with_own_judge(
    discovery: Discovery, judged: Discovery, fitted: tuple[Record, ...]
) -> Discovery:
    """The answer of a search that held records out, where it came to one; else as it was.

    An end in which nothing is seen does not show that nothing is missing: what dies away, as that
    of a decay, is in the records of the fit alone.

    Args:
        discovery: the answer without held-out records.
        judged: that with them.
        fitted: records that it was fitted to, as given.
    """
    if judged.status.code == "no_data":
        return discovery
    note = _NOTE.format(100.0 * _RULES.own_share)
    judged = replace(judged, notes=(note, *judged.notes))
    if judged.status.code != "nothing_missing":
        return judged
    settled, plant = judged.held_out[0], judged.plant
    fitted = with_hold(fitted, settled.hold, settled.skew)
    window = window_length(fitted, 2 * longest_start(plant, fitted))
    long_runs, short_runs = whole_and_windows(plant, fitted, window)
    misses = beyond_noise(short_runs or long_runs, _IN_FIT)
    return replace(judged, status=Status("unexplained", misses[0])) if misses else judged


_NOTE = (
    "no `validation` was given, and the records alone leave open what is missing: of the motion in "
    "each the last {:.3g} % were held out, and judge. Give `validation` for others"
)
_IN_FIT = (
    " on the records of the fit, though not on the end of their motion, which was held out: what "
    "is missing dies away before. Hold out other records (`validation`)"
)
