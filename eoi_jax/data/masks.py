"""Which samples and steps of a record count, output by output.

A sample of an output is scored if it is valid and lies behind the transient at the start of its
record. A step lies between two samples, and is valid for an output if the inputs are known at both,
and all outputs measured that enter its equation. A step is usable where, beside that, the model
says what the measurement shows: not while dry friction holds the plant at rest.

What follows from arrays alone takes those of NumPy, or those of JAX, also traced, and returns the
same kind.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from eoi_jax.data.cleaning import channel_groups
from eoi_jax.data.record import Record
from eoi_jax.data.resampling import runs

Host = Array | np.ndarray


@dataclass(frozen=True)
class MaskSettings:
    """Steps that do not count, beside rest and behind a start."""

    certainty: float = 4.0  # standard deviations within which a velocity has no certain sign
    settling: int = 3  # steps after which an implicit observer slides: about the relative degree
    seldom: float = 0.5  # share of the samples below which known inputs are no matter of gaps


SETTINGS = MaskSettings()


def _namespace(array: Any) -> Any:
    """NumPy, or JAX's for its arrays."""
    return jnp if isinstance(array, jax.Array) else np


def transient_samples(record: Record, transient: float = 0.0) -> int:
    """Samples at the start of a record that are not scored.

    Args:
        record: whose burn-in is its own transient.
        transient: of the method [s]; the longer one counts.
    """
    return round(max(transient, record.burn_in) / record.sample_period)


def scored_samples(record: Record, unscored: int | None = None) -> Bool[np.ndarray, "time ny"]:
    """Samples of each output that were measured and lie behind the transient.

    Args:
        record: with its mask and its burn-in.
        unscored: samples at the start that are not scored; those of `transient_samples` if None.
    """
    scored = np.array(record.output_valid)
    scored[: transient_samples(record) if unscored is None else unscored] = False
    return scored


def valid_steps(
    record: Record, enters: Bool[np.ndarray, "ny ny"] | None = None
) -> Bool[np.ndarray, "steps ny"]:
    """Steps between two valid samples, for the equation of each output.

    Args:
        record: bridged, where its outputs have different rates.
        enters: whether output j enters the equation of output i, at [i, j]; None: each its own.
    """
    valid = valid_samples(record, enters)
    return valid[:-1] & valid[1:]


def valid_samples(
    record: Record, enters: Bool[np.ndarray, "ny ny"] | None = None
) -> Bool[np.ndarray, "time ny"]:
    """Samples at which all that stands in the equation of each output is known.

    Arguments are those of `valid_steps`.
    """
    measured = record.output_valid
    if enters is not None:
        measured = ~(~measured @ (enters | np.eye(len(enters), dtype=bool)).T)
    return measured & record.input_valid[:, None]


def longest_run(record: Record, output: int | None = None) -> tuple[int, int]:
    """First and last sample, plus one, of the longest run of valid samples; empty without any.

    Args:
        record: any.
        output: whose samples count; None: those that are valid in every channel.
    """
    mask = record.valid if output is None else record.output_valid[:, output]
    return max(runs(mask), key=lambda segment: segment[1] - segment[0], default=(0, 0))


def over_samples(
    record: Record, statistic: Callable[[np.ndarray], np.ndarray]
) -> Float[np.ndarray, " ny"]:
    """A statistic of each output over the samples at which it was measured; 0 without any.

    Args:
        record: any.
        statistic: of values of shape (samples, channels), one number a channel.
    """
    values = np.zeros(record.outputs.shape[1])
    for columns, mask in channel_groups(record.output_valid):
        if np.any(mask):
            values[columns] = statistic(record.outputs[mask, columns])
    return values


def direction_of_motion(
    degrees: Sequence[int],
    first: Float[Host, "*steps ny"],
    second: Float[Host, "*steps ny"],
    h: Any,
    noise: Float[Host, " ny"],
) -> Any:
    """Signs of the velocities between samples and those that follow them; 0 if not certain.

    Args:
        degrees: of the outputs; of degree one they are speeds themselves.
        first: outputs at the samples.
        second: outputs at those that follow.
        h: time between both [s].
        noise: standard deviation of that of the velocities, `defaults.velocity_noise`, shape (ny,).
    """
    xp = _namespace(first)
    is_speed = np.asarray(degrees) == 1
    velocity = xp.where(is_speed, 0.5 * (second + first), (second - first) / h)
    return xp.where(xp.abs(velocity) > SETTINGS.certainty * noise, xp.sign(velocity), 0.0)


def moving(
    degrees: Sequence[int], outputs: Float[Host, "time ny"], h: Any, noise: Float[Host, " ny"]
) -> Any:
    """Steps in which the direction of motion is certain.

    Dry friction has the value that the model gives it only there: at rest it is a reaction, and
    within a reversal it changes sign. One step on each side is left out as well, because rest can
    begin or end inside it.

    Args:
        degrees: as of `direction_of_motion`.
        outputs: on a uniform grid.
        h: its step [s].
        noise: as of `direction_of_motion`.
    """
    xp = _namespace(outputs)
    direction = direction_of_motion(degrees, outputs[:-1], outputs[1:], h, noise)
    previous = xp.concatenate([direction[:1], direction[:-1]])
    following = xp.concatenate([direction[1:], direction[-1:]])
    return (direction != 0) & (direction == previous) & (direction == following)


def usable_steps(
    record: Record,
    taps: int,
    degrees: Sequence[int],
    jumps: Bool[np.ndarray, "ny ny"],
    noise: Float[np.ndarray, " ny"],
    enters: Bool[np.ndarray, "ny ny"] | None = None,
) -> tuple[Bool[np.ndarray, "steps ny"], Bool[np.ndarray, " steps"]]:
    """Steps in which model and measurement belong together, and those at which an observer starts.

    Args:
        record: uniformly sampled.
        taps: length of the observer's moving average [steps].
        degrees: relative degrees of the outputs.
        jumps: `Plant.jumps`: which outputs' directions each acceleration jumps with.
        noise: of the velocities, as of `moving`.
        enters: as of `valid_steps`.

    Returns:
        Usable steps of each output, and the steps at which the observer starts: the first one, and
        the first one after a gap of any output or of an input. Outputs that all have relative
        degree 0 need no observer: a step is usable if the sample at its start is valid.
    """
    if not any(degrees):  # a sample stands for itself, whether the next one is valid or not
        restart = np.arange(len(record) - 1) == 0
        return valid_samples(record, enters)[:-1], restart
    return moved_steps(
        valid_steps(record, enters), record.outputs, record.sample_period,
        taps, degrees, jumps, noise, constant(record),
    )  # fmt: skip


def moved_steps(
    good: Bool[Host, "steps ny"],
    outputs: Float[Host, "time ny"],
    h: Any,
    taps: int,
    degrees: Sequence[int],
    jumps: Bool[np.ndarray, "ny ny"],
    noise: Float[Host, " ny"],
    resting: Bool[np.ndarray, " ny"] | None = None,
) -> tuple[Any, Any]:
    """`usable_steps` from arrays, where some output has an observer.

    Args:
        good: steps between two valid samples.
        outputs: on a uniform grid.
        h: its step [s].
        taps: as of `usable_steps`, and so the next ones.
        degrees: of the outputs.
        jumps: of the plant.
        noise: of the velocities.
        resting: outputs that never move; None: all do.
    """
    xp = _namespace(outputs)
    restart = xp.any(good[1:] & ~good[:-1], axis=1)
    restart = xp.concatenate([xp.ones(1, dtype=bool), restart])
    if np.any(jumps):
        slow = ~moving(degrees, outputs, h, noise)
        # Its own friction, or another's that acts on it by inertia.
        good = good & ~(slow @ jumps.T)
    if resting is not None:
        good = good & (~resting | (np.asarray(degrees) == 0))
    use = consecutive(good, taps)  # every step of the moving average must be good
    return use & beyond_starts(restart, taps + SETTINGS.settling)[:, None], restart


def consecutive(good: Bool[Host, "steps ny"], count: int) -> Any:
    """Steps that are good together with the `count` - 1 before them, as far as there are any."""
    xp, all_good = _namespace(good), good
    for lag in range(1, min(count, len(good))):
        all_good = all_good & xp.concatenate([xp.ones_like(good[:lag]), good[:-lag]])
    return all_good


def beyond_starts(starts: Bool[Host, " steps"], count: Any) -> Any:
    """All steps but the first `count` from each start on."""
    return _steps_since(starts) >= count


def constant(record: Record) -> Bool[np.ndarray, " ny"]:
    """Outputs that never move: their differences are rounding."""

    def resting(y: np.ndarray) -> np.ndarray:
        return np.ptp(y, axis=0) <= 1e-12 * np.max(np.abs(y), axis=0)

    return over_samples(record, resting) > 0


def tapered(use: Float[Host, "steps ny"], length: Any) -> Any:
    """Weights that rise smoothly (raised cosine) with the distance from a step that is out.

    Any weight that stands on both sides of the regression keeps it exact. A sharp edge, though,
    cuts second differences of the measurement noise apart that would cancel in the filter.
    """
    xp = _namespace(use)
    if xp is np and np.all(use > 0):
        return np.ones_like(use)
    columns = [
        xp.minimum(_steps_since(is_out), _steps_since(is_out[::-1])[::-1])
        for is_out in (use <= 0).T
    ]
    length = xp.maximum(length, 1.0)
    distance = xp.minimum(xp.stack(columns, axis=1), length)
    return 0.5 - 0.5 * xp.cos(np.pi * distance / length)


def _steps_since(flags: Bool[Host, " steps"]) -> Any:
    """Steps since the last flag; infinite before the first."""
    xp = _namespace(flags)
    index = xp.arange(len(flags), dtype=float)
    flagged = xp.where(flags, index, -np.inf)
    return index - (np.maximum.accumulate(flagged) if xp is np else jax.lax.cummax(flagged))


def unscored_notes(records: Sequence[Record], check_scored: Callable[[Record], None]) -> list[str]:
    """A note for each record that cannot be scored, where another one can.

    Args:
        records: of one data set.
        check_scored: raises `ValueError` for a record that cannot be scored.

    Raises:
        ValueError: that of the first one, where none can.
    """
    errors = []
    for record in records:
        try:
            check_scored(record)
        except ValueError as error:
            errors.append(error)
    if errors and len(errors) == len(records):
        raise errors[0]
    return [f"not scored: {error}" for error in errors]


def hold_advice(records: Sequence[Record]) -> str:
    """What to do where the inputs of a record are known at few of its samples; "" elsewhere.

    Args:
        records: as given.
    """
    for record in records:
        count = int(np.sum(record.input_valid))
        if count < SETTINGS.seldom * len(record):
            return _DECLARE_HOLD.format(record.name, count)
    return ""


_DECLARE_HOLD = (
    "In {} all inputs are known together at {} samples alone: of an input that is logged "
    'seldom say what it does in between, with `hold`: "linear" or "zero" for each input, in '
    "`read_record`, in `Record`, or in `[data]` of a config."
)
