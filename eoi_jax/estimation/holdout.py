"""Checks of hold-out records, on which models are scored by free-run simulation."""

from collections.abc import Iterable, Sequence
from functools import partial

import numpy as np

from eoi_jax._checks import check, check_kind, check_positive, timed
from eoi_jax.data.masks import constant, hold_advice, over_samples
from eoi_jax.data.record import Record
from eoi_jax.data.windows import (
    driven_parts,
    late_starts,
    plan,
    restart_notes,
    start_samples,
    window_length,
)
from eoi_jax.data.wrapped_outputs import wrapped_notes
from eoi_jax.models.check_records import check_records
from eoi_jax.models.plant import Plant

INITIAL = 50  # samples to which the initial state of a free run is fitted; they are not scored


def held_out_records(
    plant: Plant,
    records: Sequence[Record],
    validation: Record | Iterable[Record] | None,
    field: str = "validation",
) -> tuple[Record, ...]:
    """Hold-out records as a tuple; empty for None.

    Args:
        plant: whose channels and units they must have.
        records: of the fit; the hold-out records must not contain their samples.
        validation: one record, several, or None.
        field: the argument that they are.

    Raises:
        ValueError: records that do not match the plant, or share samples with the fit.
    """
    if validation is None:
        return ()
    if not isinstance(validation, Record):
        check_kind(field, validation, Iterable, "a Record or several")
        validation = tuple(validation)
        if not validation:
            return ()
    try:
        checked = check_records(plant, validation)
    except ValueError as error:
        raise ValueError(str(error).replace("`records", f"`{field}", 1)) from error
    hashes = {record.data_hash for record in records}
    advice = "Give another record, or keep a part of this one back: `record.split(0.7)`."
    for record in checked:
        name, rule = f"{field}[{record.name}]", "must not be one of the records of the fit"
        check(record.data_hash not in hashes, name, rule, "the same data", advice)
        for fitted in records:
            shared = _count_common_samples(record, fitted)
            rule = "must not hold samples that the fit sees"
            check(
                shared == 0,
                name,
                rule,
                f"{timed(shared, record.sample_period)} of {fitted.name}",
                advice,
            )
    return checked


def _count_common_samples(candidate: Record, record: Record, tolerance: float = 1e-3) -> int:
    """Number of scored samples that another record contains: same time, inputs and outputs.

    Zero unless the records agree at all common times and the outputs move there: the beginnings of
    two runs from rest are equal without being the same data. Time stamps are equal that are within
    `tolerance` of each other [sample periods].
    """
    period = candidate.sample_period
    shift = (candidate.time[0] - record.time[0]) / period
    offset = round(shift)
    first, last = max(0, -offset), min(len(candidate), len(record) - offset)
    drift = abs(record.sample_period - period) * max(last - first, 0)
    apart = max(abs(shift - offset) * period, drift) > tolerance * period
    if apart or last <= max(first, INITIAL):
        return 0
    in_candidate, in_record = slice(first, last), slice(first + offset, last + offset)
    measured = candidate.output_valid[in_candidate] & record.output_valid[in_record]
    known = candidate.input_valid[in_candidate] & record.input_valid[in_record]
    y = candidate.outputs[in_candidate]
    is_equal = np.array_equal(y[measured], record.outputs[in_record][measured]) and np.array_equal(
        candidate.inputs[in_candidate][known], record.inputs[in_record][known]
    )
    columns = zip(y.T, measured.T, strict=True)
    is_moving = any(np.any(mask) and np.ptp(column[mask]) > 0.0 for column, mask in columns)
    shared = np.any(measured, axis=1) & known
    return int(np.sum(shared[max(INITIAL - first, 0) :])) if is_equal and is_moving else 0


def check_scored_records(
    plant: Plant, name: str, records: Sequence[Record], window: float | None = None
) -> list[str]:
    """Check, before a fit, that free runs of the records can be scored.

    Args:
        plant: whose state each run starts from.
        name: of the argument, for messages.
        records: to simulate.
        window: length of each run [s]; None for one run over each record.

    Returns:
        A note for each record with runs that start late, or not at all, for lack of valid samples.

    Raises:
        ValueError: a record that is too short, or has too few valid samples in a row.
    """
    subject = "its free run" if window is None else f"each free run of {window:.4g} s"
    notes = []
    for record in records:
        head = start_samples(record, plant.rows)
        parts = [part for _, part in driven_parts(record, head + 1)]
        runs = [plan(part, head, window, plant.rows) for part in parts]
        burn_in = f" and a burn-in of {record.burn_in:g} s" if record.burn_in else ""
        pairs = list(zip(parts, runs, strict=True))
        period = record.sample_period
        check(
            any(np.any(run.score[:, None] & part.output_valid) for part, run in pairs),
            f"{name}[{record.name}]",
            f"must have valid samples after the {timed(head, period)} that start {subject}",
            f"{timed(len(record), period)}, {_count_measured(record)} of them valid{burn_in}",
            hold_advice([record]) or "Give a longer record, or one with fewer gaps.",
        )
        notes += restart_notes(record, len(parts), head + 1)
        for part, run in pairs:
            notes += late_starts(part, run, head, window is None)
    return notes


def _count_measured(record: Record) -> int:
    """Samples with known inputs at which an output was measured."""
    return int(np.sum(record.input_valid & np.any(record.output_valid, axis=1)))


def check_runs(
    plant: Plant, records: Sequence[Record], validation: Sequence[Record], window: float | None
) -> list[str]:
    """Check that `discover` can simulate records, in windows too.

    Args:
        plant: the declared model.
        records: of the fit; scored where no records are held out.
        validation: hold-out records.
        window: length of short runs [s]; None for the default.

    Returns:
        A note for each output of the fit that wraps, and for each scored record with runs that
        start late for lack of valid samples, or that is not longer than `window`.

    Raises:
        ValueError: a record that is too short.
    """
    scored = validation or records
    notes = wrapped_notes(records)
    notes += check_scored_records(plant, "validation" if validation else "records", scored)
    for name, group in (("records", records), ("validation", validation)):
        length = window
        if window is None and group:
            length = _usual_window(plant, group)
        if length is not None:
            late_notes = check_scored_records(plant, name, group, length)
            notes += late_notes if group is scored else []
    return [*dict.fromkeys(notes)] + [
        _WINDOW_TOO_LONG.format(window, record.name, len(record) * record.sample_period)
        for record in scored
        if window is not None and window >= (len(record) - 1) * record.sample_period
    ]


def _check_window(window: float | None, records: Sequence[Record]) -> None:
    """Check that runs of this length [s] are longer than their starts; None: nothing is asked for.

    Raises:
        ValueError: they are not.
    """
    if window is None:
        return
    check_positive("window", window, "It is a time in seconds.")
    for record in records:
        shortest = INITIAL * record.sample_period
        rule = f"must be longer than {shortest:g} s, the {INITIAL} samples of {record.name} that "
        rule += "start each free run"
        check(round(window / record.sample_period) > INITIAL, "window", rule, f"{window:g} s")


def scorable_records(
    plant: Plant, name: str, records: tuple[Record, ...], window: float | None, whole: bool
) -> tuple[tuple[Record, ...], list[str]]:
    """Records of which free runs can be scored, and a note on each that is left out.

    Args:
        plant: that is simulated.
        name: of the argument, for messages.
        records: of one data set; where none can be scored, all are returned.
        window: length of short runs [s]; None for the default.
        whole: whether runs over whole records are scored, too.

    Raises:
        ValueError: a window that is no longer than the start of a run.
    """
    _check_window(window, records)
    if not records:
        return records, []
    length = _usual_window(plant, records) if window is None else window
    lengths = [None] * whole + [length] * (length is not None)
    usable, notes = [], []
    for record in records:
        try:
            for asked in lengths:
                check_scored_records(plant, name, [record], asked)
            usable.append(record)
        except ValueError as error:
            notes.append(f"left out: {error}")
    return (tuple(usable), notes) if usable else (records, [])


def _usual_window(plant: Plant, records: Sequence[Record]) -> float | None:
    return window_length(records, 2 * longest_start(plant, records))


def longest_start(plant: Plant, records: Sequence[Record]) -> int:
    """Samples from which the state of a free run is estimated, of the record that takes most.

    Args:
        plant: whose state it is.
        records: of one data set.
    """
    return max(start_samples(record, plant.rows) for record in records)


def resting_outputs(
    validation: Sequence[Record],
    records: Sequence[Record],
    noise_ratio: float = 1.5,
    motion_ratio: float = 0.5,
) -> list[str]:
    """One sentence for each output of a hold-out record that does not move beyond its noise.

    Models with and without an effect of motion are equally good there.

    Args:
        validation: hold-out records.
        records: of the fit.
        noise_ratio: standard deviation of a resting output over its noise, at most.
        motion_ratio: the same over its standard deviation in the fit, at most: the noise estimate
            of a coarse record contains motion.
    """

    def spread_of(record: Record) -> np.ndarray:
        return over_samples(record, partial(np.std, axis=0))

    fit_spread = np.max([spread_of(record) for record in records], axis=0)
    sentences = []
    for record in validation:
        spread = spread_of(record)
        highest = np.minimum(noise_ratio * record.noise, motion_ratio * fit_spread)
        resting = (spread < highest) | constant(record)
        sentences += [
            _RESTING.format(name, record.name)
            for name, is_resting in zip(record.output_names, resting, strict=True)
            if is_resting
        ]
    return sentences


_WINDOW_TOO_LONG = (
    "`window` of {:g} s is no part of {}, of {:g} s: its free run in windows is the whole one"
)
_RESTING = (
    "{} does not move beyond its noise on the held-out record {}, which can neither confirm nor "
    "deny an effect that acts on motion. Hold out a record with motion"
)
