"""Inputs that are logged only when they change, or seldom: between entries they follow their hold.

An export by exception has a row wherever one of its signals moved, with empty cells for the others.
What an empty cell means is not in the file. It is told by a declared hold: a held input keeps its
last entry, a linear or smooth one goes on to the next. So it is in the rows of other channels in a
log with a row for each.
"""

import numpy as np

from eoi_jax._checks import counted
from eoi_jax._types import Inputs, Mask, TimeAxis
from eoi_jax.data.cleaning import is_slow
from eoi_jax.data.input_holds import SELDOM, HoldArgument, hold_of_each, read_hold
from eoi_jax.data.resampling import covered, hold_inputs, own_period, own_segments


def between_entries(
    stamps: TimeAxis, u: Inputs, names: tuple[str, ...], hold: HoldArgument, notes: list[str]
) -> tuple[Inputs, float]:
    """The inputs, with values between the entries of those that are logged seldom.

    These have a value in every second row or less often. One that is held keeps its last entry up
    to the last row; others have no value before their first entry, behind their last one and in a
    hole. One that has values in more rows, but not in those of other channels, follows its hold
    between two entries without a hole. Where no hold is declared nothing is filled in, and a note
    says what to declare.

    Args:
        stamps: of the rows, increasing [s].
        u: one column each; NaN where a cell is empty.
        names: of the inputs.
        hold: as in `Record`.
        notes: of the record; a sentence on each such input.

    Returns:
        The inputs, and the time without a row that is usual for all of them [s], in which they
        follow their hold; 0 where one is logged throughout.
    """
    has_value = np.isfinite(u)
    partly = [j for j, entered in enumerate(has_value.T) if has_entries(entered)]
    if not partly:
        return u, 0.0
    words, filled = hold_of_each(read_hold(hold, names), len(names)), u.copy()
    period = float(np.median(np.diff(stamps)))
    position, reach = (stamps - stamps[0]) / period, [0.0] * u.shape[1]
    for j in partly:
        entries = np.flatnonzero(np.isfinite(u[:, j]))
        text = f"`{names[j]}` has {counted(len(entries), 'value')} in {len(u)} rows: "
        if words[j] == "auto":
            notes.append(f"{text}unknown in between. {SELDOM}")
            continue
        at, values = position[entries], u[entries, j : j + 1]
        segments = own_segments(at)
        seldom = is_seldom(has_value[:, j])
        is_kept = seldom and words[j] == "zero"
        known = position >= at[0] if is_kept else covered(at, segments, position)
        filled[known, j] = hold_inputs(at, values, segments, position, words[j])[known, 0]
        reach[j] = period * own_period(at) if seldom else 0.0
        manner = "kept from each to the next" if words[j] == "zero" else f"{words[j]} in between"
        notes.append(f"{text}{manner}, as its `hold` says.")
    return filled, min(reach)


def is_seldom(entered: Mask) -> bool:
    """Whether an input has a value in every second row or less often.

    Args:
        entered: where it has one.
    """
    return is_slow(entered) and 2 * int(np.sum(entered)) <= len(entered)


def has_entries(entered: Mask, rows: float = 1.1) -> bool:
    """Whether an input has no value in the rows of other channels, or seldom one.

    Args:
        entered: where it has one.
        rows: between two values on average, without holes, at least; nearer ones are missing.
    """
    return own_period(np.flatnonzero(entered).astype(float)) >= rows
