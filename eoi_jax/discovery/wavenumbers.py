r"""Wavenumbers at which a residual repeats along the position: points for the grid of ripples.

A motor that turns often passes its magnets thousands of times, a screw its pitch. Such a ripple
a sin(κ y) fits only within 1/range of its wavenumber, and no grid is so fine. The residual, in
time, whitened by its power S(ω), is summed in bins of the position, whose Fourier transform is
large at κ.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from eoi_jax.discovery.cosine_modes import ModalRecord, Rows
from eoi_jax.discovery.lags import Peak, signal_of_low_modes, strongest
from eoi_jax.discovery.rules import RULES
from eoi_jax.models.augmented import Placed

_RULES = RULES.wavenumbers
_BINS = 4  # for each of the shortest periods
_PADDED = 4  # points of the spectrum for each period over the range


def wavenumbers(
    records: Sequence[ModalRecord], residual: Rows, power: Rows, placed: Placed
) -> Float[np.ndarray, " wavenumbers"]:
    """Wavenumbers [1/unit of y], the strongest first; may be empty.

    Args:
        records: the records.
        residual: residual of the model, concatenated over records and, within each, over outputs.
        power: S of each row of the residual.
        placed: the ripple, at its output.
    """
    positions, signals, first = [], [], 0
    for record in records:
        size, outputs = len(record.omega), record.y.shape[2]
        begin = first + placed.output * size
        rows, first = slice(begin, begin + size), first + outputs * size
        length = len(record.highest[placed.output])
        whitened = residual[rows] / np.sqrt(power[rows])
        signals.append(signal_of_low_modes(record, whitened, length))
        # A spline of the thinning is centred one block before the number of its node.
        at = np.clip((np.arange(length) - 1) * len(record.kernel), 0, len(record.time) - 1)
        positions.append(placed.coordinate(record.y[at, 0]))
    y, signal = np.concatenate(positions), np.concatenate(signals)
    reach, noise = np.ptp(y), max(float(record.state_noise[placed.output]) for record in records)
    scale = float(np.linalg.norm(signal))
    if not (reach > 0.0 and scale > 0.0):
        return np.zeros(0)
    periods = int(min(_RULES.most, reach / max(_RULES.noise * noise, np.finfo(float).tiny)))
    if periods <= _RULES.fewest:
        return np.zeros(0)
    bins = _BINS * periods
    place = np.minimum(((y - y.min()) / reach * bins).astype(int), bins - 1)
    sums = np.bincount(place, signal, bins)
    spectrum = np.abs(np.fft.rfft(sums, _PADDED * bins)) / scale
    numbers = np.arange(len(spectrum)) / _PADDED  # periods over the range
    inner = spectrum[1:-1]
    top = 1 + np.flatnonzero(
        (inner > spectrum[:-2]) & (inner >= spectrum[2:]) & (inner > _RULES.threshold)
    )
    top = top[(numbers[top] > _RULES.fewest) & (numbers[top] < periods)]
    peaks = [Peak(_refined(spectrum, i) / _PADDED, float(spectrum[i]), 1.0) for i in top.tolist()]
    numbers_found = [
        number for number, _ in zip(strongest(peaks), range(_RULES.peaks), strict=False)
    ]
    return 2.0 * np.pi / reach * np.asarray(numbers_found)


def _refined(values: Float[np.ndarray, " points"], top: int) -> float:
    """The place of a maximum, by a parabola."""
    previous, center, following = values[top - 1 : top + 2]
    return top + 0.5 * float((previous - following) / (previous - 2.0 * center + following))
