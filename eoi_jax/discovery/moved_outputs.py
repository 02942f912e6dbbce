"""Outputs that were logged late beside the others, as by a second logger, and what explains then.

No effect stands for a clock. What the injection makes of one that is off is an action of inputs, a
second mass, parameters of the wrong sign; free runs of the refined model show the time itself.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eoi_jax.data.late_outputs import late_outputs, without_lateness
from eoi_jax.data.record import Record
from eoi_jax.discovery.confirm import beyond_noise
from eoi_jax.discovery.doubts import log_error_ratio, telling_runs
from eoi_jax.discovery.in_free_runs import begun_search
from eoi_jax.discovery.remarks import HoldNote
from eoi_jax.discovery.result import Discovery
from eoi_jax.discovery.rules import RULES
from eoi_jax.refinement.refine import refine

Records = tuple[Record, ...]


@dataclass(frozen=True)
class MovedSettings:
    """How the time is found by which an output is moved.

    Attributes:
        steps: of least squares, at most.
        settled: change of a time that ends them [sample periods].
        rounding: distance from a whole number of samples, by which values stay as they are, that is
            none [sample periods].
    """

    steps: int = 4
    settled: float = 0.01
    rounding: float = 0.1


_SETTINGS = MovedSettings()


def with_moved_outputs(
    discovery: Discovery,
    search: Callable[[Records, Records], Discovery],
    records: Records,
    held_out: Records,
) -> Discovery | None:
    """The answer on records whose late outputs are moved; None where none seems to be late.

    Args:
        discovery: the answer of the injection on the records as they are.
        search: on records to fit and records that judge.
        records: to fit, as given.
        held_out: that judge, as given.
    """
    runs = telling_runs(discovery)
    is_open = discovery.status.code not in ("complete", "nothing_missing") or beyond_noise(runs)
    outputs = discovery.declared.nominal.outputs
    if len(outputs) < 2 or discovery.in_sample or not is_open:
        return None
    begun = begun_search(discovery, records)
    fit = None if begun is None else begun.settled_base.refinement
    late = {} if fit is None else late_outputs(fit.records, fit.residual, outputs)
    if not late:
        return None
    begun_at = {outputs.index(name): time for name, (time, _) in late.items()}
    times = _settled(discovery, records, begun_at)
    answer = search(_moved(records, times), _moved(held_out, times))
    text = ", ".join(
        f"{outputs[j]} was moved to {abs(time):.3g} s {'earlier' if time > 0.0 else 'later'}"
        for j, time in times.items()
    )
    option = ", ".join(f"{outputs[j]} = {time:.3g}" for j, time in times.items())
    return replace(answer, notes=(HoldNote(_MOVED.format(text, option)), *answer.notes))


def _moved(records: Sequence[Record], times: Mapping[int, float]) -> Records:
    """The records with outputs, by number, moved by these times [s]."""
    return tuple(
        without_lateness(record, {record.output_names[j]: time for j, time in times.items()})
        for record in records
    )


def _settled(discovery: Discovery, records: Records, times: dict[int, float]) -> dict[int, float]:
    """Times with which the refined model and the moved records agree, by steps of least squares.

    A model that was refined on records as they were logged is biased by that, and its hold, skew
    and times with it. Of a run ŷ that is late by δ the error is -δ dŷ/dt.

    Args:
        discovery: the answer of the injection.
        records: to fit, as given.
        times: by number of the output, to begin with [s].
    """
    plant, period = discovery.declared.nominal, min(record.sample_period for record in records)
    for _ in range(_SETTINGS.steps):
        fit, change = refine(plant, _moved(records, times)), 0.0
        if not fit.status.fits:
            break
        for j in times:
            slopes, errors = [], []
            for record, error in zip(fit.records, fit.residual, strict=True):
                run = record.known_outputs[:, j] - error[:, j]
                slopes.append(np.gradient(run, record.sample_period))
                errors.append(error[:, j])
            slope, error = np.concatenate(slopes), np.concatenate(errors)
            power = float(np.nansum(slope**2))
            step = -float(np.nansum(slope * error)) / power if power > 0.0 else 0.0
            times = {**times, j: times[j] + step}
            change = max(change, abs(step))
        if change < _SETTINGS.settled * period:
            break
    steps = {j: time / period for j, time in times.items()}
    return {
        j: period * (round(step) if abs(step - round(step)) < _SETTINGS.rounding else step)
        for j, step in steps.items()
    }


def is_all_that_is_missing(moved: Discovery | None) -> bool:
    """Whether the declared model leaves noise on the moved outputs."""
    if moved is None or moved.status.code != "nothing_missing":
        return False
    return not beyond_noise(telling_runs(moved), plant=moved.plant)


def better_of(moved: Discovery | None, discovery: Discovery) -> Discovery:
    """The answer on moved outputs, where it predicts them far better than the other one its own."""
    limit = np.log(RULES.answer.confirmed)
    return moved if moved is not None and log_error_ratio(moved, discovery) < limit else discovery


_MOVED = (
    "{0} beside the other outputs, by which free runs fit it best: a second logger, a clock or a "
    "filter of its own may have logged it so. The answer is that of moved records; read others "
    "with `late = {{ {1} }}`"
)
