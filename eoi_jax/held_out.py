"""Which records may be held out, and what they can judge."""

from collections.abc import Sequence

import numpy as np

from eoi_jax.checks import check
from eoi_jax.data.record import Record
from eoi_jax.plants.plant import Plant
from eoi_jax.prepare import check_records, constant

INITIAL = 50  # samples from which a free run is started; they are not scored
_CLOSE = 1e-3  # of a sample period: stamps so close together are one

# Standard deviation of an output over its noise, from which on it moves; and over that in the fit:
# of coarse samples the differences, which tell the noise, are motion too.
_MOVES, _LITTLE = 1.5, 0.5


def held_out(
    plant: Plant, records: Sequence[Record], validation: Record | Sequence[Record] | None
) -> tuple[Record, ...]:
    """Records that judge, as a tuple; none where none are given.

    Args:
        plant: whose channels and units they must have.
        records: of the fit, whose samples they must not hold.
        validation: one or several, or none.

    Raises:
        ValueError: records that do not fit the plant, or that the fit has seen.
    """
    if validation is None or (not isinstance(validation, Record) and len(validation) == 0):
        return ()
    try:
        held = check_records(plant, validation)
    except ValueError as error:
        raise ValueError(str(error).replace("`records", "`validation", 1)) from error
    hashes = {one.data_hash for one in records}
    advice = "Give another record, or a share of these such as 0.3."
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


_RESTS = (
    "{} does not move beyond its noise on the held-out record {}, which can neither confirm nor "
    "deny an effect that acts on motion. Hold out a record with motion"
)
