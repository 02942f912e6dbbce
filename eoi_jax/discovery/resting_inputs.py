r"""Noise in the log of an input that rests between events, as the force of a modal hammer.

Such noise did not act. What lets small values through less, as a dead zone of the input, a gain
that differs between the directions, or a play, takes that noise out of free runs, and passes for
what the model lacks; without it the gains of the model follow the noise. So an answer is searched
again with each input at its mean wherever it rests (the force window of modal testing: W. G.
Halvorsen and D. L. Brown, Sound and Vibration 11 (1977) 8), and that answer counts where its free
runs predict the same outputs better. Scatter that acted makes them worse.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy.lib.stride_tricks import sliding_window_view

from eoi_jax.data.record import Record
from eoi_jax.discovery.confirm import beyond_noise
from eoi_jax.discovery.doubts import log_error_ratio, telling_runs
from eoi_jax.discovery.input_noise import is_white, white_deviation
from eoi_jax.discovery.remarks import HoldNote
from eoi_jax.discovery.result import Discovery
from eoi_jax.discovery.rules import RULES

Records = tuple[Record, ...]


@dataclass(frozen=True)
class RestSettings:
    """When an input rests, and when it moves, in standard deviations of its noise."""

    distance: float = 5.0  # about its median: noise exceeds it once in two million samples
    moves: float = 20.0  # by which it moves elsewhere, at least; random excitation has about five
    margin: int = 4  # samples beside a motion that are left as they are: its feet are no noise
    fewest: int = 64  # samples at rest
    share: float = 0.5  # of the samples that rest, at least


_SETTINGS = RestSettings()


def with_rests(
    discovery: Discovery,
    search: Callable[[Records, Records], Discovery],
    records: Records,
    held_out: Records,
) -> Discovery:
    """The answer, or that without the noise of inputs at rest, with a note, where it predicts more.

    Args:
        discovery: the answer on the records as they are.
        search: on records to fit and records that judge.
        records: to fit, as given.
        held_out: that judge, as given.
    """
    noise = _deviations((*records, *held_out))
    if not noise or discovery.after is None or not _may_be_noise(discovery):
        return discovery
    rival = search(at_rest(records), at_rest(held_out))
    explains = ("complete", "nothing_missing")
    if discovery.status.code in explains and rival.status.code not in explains:
        return discovery
    change = log_error_ratio(rival, discovery)
    is_simpler = len(rival.added) < len(discovery.added)
    # An effect that lowers them by less would be left out elsewhere.
    if change >= (RULES.judge.min_fall if is_simpler else -RULES.judge.min_fall):
        return discovery
    units = discovery.declared.nominal.units
    levels = " and ".join(
        f"{name} by {value:.3g} {units.get(name, '')}".rstrip() for name, value in noise.items()
    )
    dropped = {item.label for item in discovery.added} - {item.label for item in rival.added}
    names = " with ".join(sorted(dropped))
    not_needed = _IN_PLACE.format(names) if is_simpler else ""
    ratio = np.exp(change)
    text = _AT_REST.format(levels, ", ".join(noise), ratio, not_needed)
    return replace(rival, notes=(HoldNote(text), *rival.notes))


def at_rest(records: Sequence[Record]) -> Records:
    """The records with each input at its mean, wherever it rests with noise."""
    return tuple(map(_at_rest, records))


def _at_rest(record: Record) -> Record:
    inputs = record.inputs.copy()
    for j in range(inputs.shape[1]):
        rests = _rests(inputs[:, j], record.input_valid)
        inputs[rests, j] = np.mean(inputs[rests, j]) if np.any(rests) else 0.0
    changed = not np.array_equal(inputs, record.inputs)
    return (
        record.with_inputs(inputs, record.input_names, record.skew, record.hold)
        if changed
        else record
    )


def _deviations(records: Sequence[Record]) -> dict[str, float]:
    """Standard deviation of the noise of each input that rests, the largest of all records."""
    noise: dict[str, float] = {}
    for record in records:
        for j, name in enumerate(record.input_names):
            rests = _rests(record.inputs[:, j], record.input_valid)
            if np.any(rests):
                deviation = float(np.std(record.inputs[rests, j]))
                noise[name] = max(deviation, noise.get(name, 0.0))
    return noise


def _may_be_noise(discovery: Discovery) -> bool:
    """Whether an answer has effects, or leaves something open: noise of an input may be that."""
    runs = telling_runs(discovery)
    return discovery.status.code != "nothing_missing" or bool(beyond_noise(runs))


def _rests(
    values: Float[np.ndarray, " time"], valid: Bool[np.ndarray, " time"]
) -> Bool[np.ndarray, " time"]:
    """Samples at which an input rests with white noise, while it moves far at others; or none."""
    empty = np.zeros(len(values), dtype=bool)
    if np.count_nonzero(valid) < _SETTINGS.fewest:
        return empty
    deviation = white_deviation(values[valid])
    distance = np.where(valid, np.abs(values - np.median(values[valid])), 0.0)
    if not 0.0 < _SETTINGS.moves * deviation < np.max(distance):
        return empty
    quiet = valid & (distance < _SETTINGS.distance * deviation)
    width = 2 * _SETTINGS.margin + 1
    rests = np.all(
        sliding_window_view(np.pad(quiet, _SETTINGS.margin, constant_values=True), width), axis=1
    )
    count = np.count_nonzero(rests)
    is_rest = count >= max(_SETTINGS.fewest, _SETTINGS.share * np.count_nonzero(valid))
    return rests if is_rest and is_white(values[rests]) else empty


_AT_REST = (
    "the log of inputs is noisy: at rest they scatter, {0} rms, and the outputs do not follow. "
    "With {1} at the mean of each rest free runs on the same outputs have {2:.2g} of the error{3}; "
    "answer, parameters and errors are those with this mean, as noise of the log biases gains, "
    "masses and their like. Other records, as those of `test`, keep it: take it out of the files"
)
_IN_PLACE = ", and {} is not needed, which let less of the noise through"
