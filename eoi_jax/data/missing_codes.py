"""Numbers that loggers write where they have none, such as -999: a guess, from form and place.

Nothing but a declaration makes such a number a missing value; a guess is said, so that somebody who
knows the file declares it.
"""

import re

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import counted
from eoi_jax._types import Inputs, OutputMask, Outputs

# Nines, as of weather services and well logs (-99.9, -999.25), and the ends of whole numbers.
_CODE = re.compile(
    r"-99+(\.(25|9+))?|999+(\.(25|9+))?"
    r"|-?32767|-32768|65535|-?2147483647|-2147483648|4294967295"
)
DECLARE = "declare it by `missing`"  # of `read_record` and of [data]


def likely_codes(values: Float[np.ndarray, " n"], fewest: int = 8) -> tuple[float, ...]:
    """Values that look like codes for a missing value: by their digits, and far outside the others.

    That is farther from the other values than these are from each other, or negative where these
    are not.

    Args:
        values: NaN where nothing was measured.
        fewest: values besides the codes; from fewer the range is not known.

    Returns:
        The codes in increasing order; mostly none.
    """
    ordinary, codes = values[np.isfinite(values)], list[float]()
    while len(ordinary) >= fewest:
        ends = {float(np.min(ordinary)), float(np.max(ordinary))}
        ends = [end for end in ends if _CODE.fullmatch(f"{end:.12g}")]
        if not ends:
            break
        codes += ends
        ordinary = ordinary[~np.isin(ordinary, ends)]
    if not codes or len(ordinary) < fewest:
        return ()
    low, high = float(np.min(ordinary)), float(np.max(ordinary))
    if np.all((ordinary == low) | (ordinary == high)):  # a switch: nothing tells how far it reaches
        return ()
    far = [code for code in codes if max(low - code, code - high) > high - low or code < 0.0 <= low]
    return tuple(sorted(far))


def code_text(name: str, values: Float[np.ndarray, " n"], code: float) -> str:
    """How often a channel is a code, and where its other values lie.

    Args:
        name: of the channel.
        values: of the channel.
        code: one of its `likely_codes`.
    """
    ordinary = values[np.isfinite(values) & ~np.isin(values, likely_codes(values))]
    count = counted(int(np.sum(values == code)), "sample")
    return (
        f"`{name}` is {code:.12g} in {count}, outside of all others ({np.min(ordinary):.4g} to "
        f"{np.max(ordinary):.4g})"
    )


def input_code_notes(u: Inputs, names: tuple[str, ...], notes: list[str]) -> None:
    """Say which inputs hold what looks like a code; they are used as they are.

    Args:
        u: as they were logged.
        names: of the inputs.
        notes: to which a sentence on each code is added.
    """
    for name, column in zip(names, u.T, strict=True):
        notes += [_taken(name, column, code) for code in likely_codes(column)]


def without_output_codes(
    y: Outputs, good: OutputMask, mask_faults: bool, names: tuple[str, ...], notes: list[str]
) -> OutputMask:
    """Samples of each output that do not look like a code; a note says which do.

    Args:
        y: as they were logged.
        good: where each output is finite.
        mask_faults: whether such samples are masked, or only said.
        names: of the outputs.
        notes: to which a sentence on each code is added.
    """
    valid = good.copy()
    for name, column, mask in zip(names, y.T, valid.T, strict=True):
        for code in likely_codes(column):
            if not mask_faults:
                notes.append(_taken(name, column, code))
                continue
            at_code = column == code
            mask &= ~at_code
            notes.append(
                f"{code_text(name, column, code)}, like a code for a missing value: masked. If "
                f"{'it was' if at_code.sum() == 1 else 'they were'} measured, give "
                "`mask_faults=False`."
            )
    return valid


def _taken(name: str, values: Float[np.ndarray, " n"], code: float) -> str:
    is_single = int(np.sum(values == code)) == 1
    return (
        f"{code_text(name, values, code)}: likely a code for a missing value, and used as if "
        f"measured. If {'it is' if is_single else 'they are'} none, {DECLARE} = [{code:.12g}], or "
        "write NaN."
    )
