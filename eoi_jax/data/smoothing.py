"""Signals of a record behind a zero-phase low-pass, segment by segment."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool

from eoi_jax._types import Inputs, Mask, OutputMask, Outputs
from eoi_jax.data.cleaning import channel_groups
from eoi_jax.data.resampling import fill, low_pass, runs, staircase_to_smooth


def smoothed_inputs(
    inputs: Inputs,
    valid: Mask,
    filtered: Sequence[bool],
    is_held: Bool[np.ndarray, " nu"],
    share: float,
) -> Inputs:
    """Inputs, some of them filtered; of held ones the signal that acts on the plant.

    Args:
        inputs: (N, nu).
        valid: where all are known.
        filtered: which are.
        is_held: which are held between their samples.
        share: of the Nyquist frequency, the cut-off.
    """
    smooth = np.array(inputs)
    for start, stop in runs(valid):
        for j in np.flatnonzero(filtered):
            levels = low_pass(smooth[start:stop, [j]], share)
            smooth[start:stop, [j]] = staircase_to_smooth(levels) if is_held[j] else levels
    return _filled(smooth, valid[:, None])


def smoothed_outputs(outputs: Outputs, measured: OutputMask, share: float) -> Outputs:
    """Outputs filtered, in their own segments.

    Args:
        outputs: (N, ny).
        measured: where each was.
        share: of the Nyquist frequency, the cut-off.
    """
    smooth = np.array(outputs)
    for columns, mask in channel_groups(measured):
        for start, stop in runs(mask):
            smooth[start:stop, columns] = low_pass(smooth[start:stop, columns], share)
    return _filled(smooth, measured)


def smoothing_note(inputs: Sequence[str] | None, cutoff: float) -> str:
    """What a record says of its filter, without a full stop.

    Args:
        inputs: that are filtered; None: all.
        cutoff: of the low-pass [rad/s].
    """
    which = "Inputs and outputs" if inputs is None else ", ".join(["Outputs", *inputs])
    return f"{which} smoothed by the same zero-phase low-pass, {cutoff:g} rad/s"


def _filled(values: np.ndarray, valid: Bool[np.ndarray, "..."]) -> np.ndarray:
    position = np.arange(len(values), dtype=float)
    return fill(position, np.where(valid, values, np.nan), position)
