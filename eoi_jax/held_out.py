"""What held-out records can judge."""

from collections.abc import Sequence

import numpy as np

from eoi_jax.data.record import Record
from eoi_jax.prepare import constant

# Standard deviation of an output over its noise, from which on it moves; and over that in the fit:
# of coarse samples the differences, which tell the noise, are motion too.
_MOVES, _LITTLE = 1.5, 0.5


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
