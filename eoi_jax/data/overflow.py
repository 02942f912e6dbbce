"""Numbers that instruments write in place of a value: 9.9E37 for an overflow, 9.91E37 for none.

A file has them as numbers. A single one is larger than all that a channel measured.

Source: SCPI-1999, volume 1, section 7.2.1 (infinity 9.9E37, not a number 9.91E37).
"""

import numpy as np

from eoi_jax._checks import counted, is_or_are
from eoi_jax._types import Signals


def without_codes(
    signals: Signals,
    names: tuple[str, ...],
    notes: list[str],
    smallest: float = 1e30,
    contrast: float = 1e6,
) -> Signals:
    """Signals with NaN in place of such numbers; a note says of which, and how many.

    Args:
        signals: as they were logged.
        names: of the channels.
        notes: to which sentences are added.
        smallest: size of a code; the largest prefix of the SI, beyond what is measured in any unit.
        contrast: size of a code over that of all other samples: a channel may be in odd units.
    """
    size = np.abs(signals)
    is_code = np.isfinite(signals) & (size >= smallest)
    if not is_code.any():
        return signals
    least = np.min(np.where(is_code, size, np.inf), axis=0)
    largest = np.max(np.where(size < smallest, size, 0.0), axis=0)
    is_code &= np.any(size < smallest, axis=0) & (least > contrast * largest)
    for name, column, codes in zip(names, signals.T, is_code.T, strict=True):
        if codes.any():
            count, value = int(codes.sum()), float(column[codes][0])
            samples, verb = counted(count, "sample"), is_or_are(count)
            notes.append(_CODES.format(samples, name, verb, value))
    return np.where(is_code, np.nan, signals)


_CODES = (
    "{} of `{}` {} a code that instruments write where a value overflows or is missing ({:.4g}): "
    "read as NaN."
)
