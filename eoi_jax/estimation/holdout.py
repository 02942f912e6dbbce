"""Which records may be held out, and what they can judge."""

from collections.abc import Iterable, Sequence

import numpy as np

from eoi_jax._checks import check, check_kind, check_positive
from eoi_jax.data.masks import constant
from eoi_jax.data.record import Record
from eoi_jax.data.windows import late_starts, plan, window_length
from eoi_jax.models.check_records import check_records
from eoi_jax.models.plant import Plant

INITIAL = 50  # samples from which a free run is started; they are not scored
_CLOSE = 1e-3  # of a sample period: stamps so close together are one

# Standard deviation of an output over its noise, from which on it moves; and over that in the fit:
# of coarse samples the differences, which tell the noise, are motion too.
_MOVES, _LITTLE = 1.5, 0.5


def held_out(
    plant: Plant, records: Sequence[Record], validation: Record | Iterable[Record] | None
) -> tuple[Record, ...]:
    """Records that judge, as a tuple; none where none are given.

    Args:
        plant: whose channels and units they must have.
        records: of the fit, whose samples they must not hold.
        validation: one or several, or none.

    Raises:
        ValueError: records that do not fit the plant, or that the fit has seen.
    """
    if validation is None:
        return ()
    if not isinstance(validation, Record):
        check_kind("validation", validation, Iterable, "a Record or several")
        validation = tuple(validation)
        if not validation:
            return ()
    try:
        held = check_records(plant, validation)
    except ValueError as error:
        raise ValueError(str(error).replace("`records", "`validation", 1)) from error
    hashes = {one.data_hash for one in records}
    advice = "Give another record, or keep a part of this one back: `record.split(0.7)`."
    for one in held:
        name, rule = f"validation[{one.name}]", "must not be one of the records of the fit"
        check(one.data_hash not in hashes, name, rule, "the same data", advice)
        for other in records:
            count = _common(one, other)
            rule = "must not hold samples that the fit sees"
            check(count == 0, name, rule, f"{count} samples of {other.name}", advice)
    return held


def _common(held: Record, record: Record) -> int:
    """Samples that would be scored and are those of another record: time, inputs and outputs.

    Only if all are that both have at one time, and the outputs move: two runs from rest are alike
    at first.
    """
    period = held.sample_period
    shift = (held.time[0] - record.time[0]) / period
    back = round(shift)
    first, last = max(0, -back), min(len(held), len(record) - back)
    drift = abs(record.sample_period - period) * max(last - first, 0)
    if max(abs(shift - back) * period, drift) > _CLOSE * period or last <= max(first, INITIAL):
        return 0
    own, other = slice(first, last), slice(first + back, last + back)
    valid = held.valid[own] & record.valid[other]
    y = held.outputs[own][valid]
    same = np.array_equal(y, record.outputs[other][valid]) and np.array_equal(
        held.inputs[own][valid], record.inputs[other][valid]
    )
    moves = len(y) > 0 and bool(np.any(np.ptp(y, axis=0) > 0.0))
    return int(np.sum(valid[max(INITIAL - first, 0) :])) if same and moves else 0


def check_judges(
    plant: Plant, name: str, records: Sequence[Record], window: float | None = None
) -> list[str]:
    """Refuse records of which no free run can be scored: before a fit, not after it.

    Args:
        plant: whose state each run starts from.
        name: of the argument that they came by.
        records: that are run through.
        window: length of each run [s]; None for whole ones.

    Returns:
        A note for each record of which runs start late, or not at all, for want of valid samples.

    Raises:
        ValueError: a record that is too short, or has too few valid samples in a row.
    """
    each = "its free run" if window is None else f"each free run of {window:.4g} s"
    notes = []
    for one in records:
        runs = plan(one, INITIAL, window, plant.relative_degree)
        burn_in = f" and a burn-in of {one.burn_in:g} s" if one.burn_in else ""
        check(
            bool(np.any(runs.score & one.valid)),
            f"{name}[{one.name}]",
            f"must have valid samples after the {INITIAL} that start {each}",
            f"{len(one)} samples, {int(np.sum(one.valid))} of them valid{burn_in}",
            "Give a longer record, or one with fewer gaps.",
        )
        notes += late_starts(one, runs, INITIAL, window is None)
    return notes


def check_runs(
    plant: Plant, records: Sequence[Record], held: Sequence[Record], window: float | None
) -> list[str]:
    """Refuse records and windows of which `discover` could not make its free runs.

    Args:
        plant: the declared one.
        records: of the fit; they judge where none are held out.
        held: records that are held out.
        window: length of short runs [s], if it was asked for.

    Returns:
        A note for each judge with runs that start late for want of valid samples, or that is not
        longer than the window that was asked for.

    Raises:
        ValueError: a record or a window that is too short.
    """
    if window is not None:
        check_positive("window", window, "It is a time in seconds.")
        for one in (*records, *held):
            least = INITIAL * one.sample_period
            rule = f"must be longer than {least:g} s, the {INITIAL} samples of {one.name} that "
            rule += "start each free run"
            check(round(window / one.sample_period) > INITIAL, "window", rule, f"{window:g} s")
    judges = held or records
    notes = check_judges(plant, "validation" if held else "records", judges)
    for name, several in (("records", records), ("validation", held)):
        length = window
        if window is None and several:
            length = window_length(several, 2 * INITIAL)
        if length is not None:
            late = check_judges(plant, name, several, length)
            notes += late if several is judges else []
    return notes + [
        _WHOLE.format(window, one.name, len(one) * one.sample_period)
        for one in judges
        if window is not None and window >= (len(one) - 1) * one.sample_period
    ]


def resting(held: Sequence[Record], records: Sequence[Record]) -> list[str]:
    """A sentence for each output of a record that does not move beyond its noise.

    There a model without an effect of motion is as good as one with it, and noise decides.

    Args:
        held: records that are held out.
        records: of the fit.
    """
    usual = np.max([np.std(one.outputs[one.valid], axis=0) for one in records], axis=0)
    told = []
    for record in held:
        spread = np.std(record.outputs[record.valid], axis=0)
        rests = (spread < np.minimum(_MOVES * record.noise, _LITTLE * usual)) | constant(record)
        told += [
            _RESTS.format(name, record.name)
            for name, one in zip(record.output_names, rests, strict=True)
            if one
        ]
    return told


_WHOLE = "`window` of {:g} s is no part of {}, of {:g} s: its free run in windows is the whole one"
_RESTS = (
    "{} does not move beyond its noise on the held-out record {}, which can neither confirm nor "
    "deny an effect that acts on motion. Hold out a record with motion"
)
