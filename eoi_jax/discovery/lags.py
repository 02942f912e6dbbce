r"""Lags at which a model's residual follows an input: points for the grid of delays.

A model that lacks a delay τ has the residual r(t) = b (u(t - τ) - u(t)) with b = ∂f/∂u, less the
part that its other parameters absorb. For delays far beyond the band's period no point of a coarse
grid is near enough to start a descent, but r and b u, both whitened by the residual's power S(ω),
correlate at the lag τ: generalised cross-correlation.

Source:
    C. H. Knapp, G. C. Carter, IEEE Trans. Acoust., Speech, Signal Process. 24 (1976) 320.
"""

from collections.abc import Iterator, Sequence
from itertools import islice
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from eoi_jax.discovery.cosine_modes import ModalRecord, Rows
from eoi_jax.discovery.rules import RULES
from eoi_jax.discovery.thinning import averaged, thinned
from eoi_jax.models.jacobians import input_slopes
from eoi_jax.models.plant import Plant

_RULES = RULES.lags


class Peak(NamedTuple):
    """A maximum: its place, its strength, and the distance within which peaks are the same."""

    place: float
    strength: float
    width: float


def strongest(peaks: Sequence[Peak]) -> Iterator[float]:
    """Places of distinct peaks from several records, the strongest first.

    Args:
        peaks: the peaks, in any order.
    """
    selected: list[Peak] = []
    for peak in sorted(peaks, key=lambda peak: (-peak.strength, peak.place)):
        if all(
            abs(peak.place - stronger.place) > max(peak.width, stronger.width)
            for stronger in selected
        ):
            selected.append(peak)
            yield peak.place


def lags(
    plant: Plant, records: Sequence[ModalRecord], residual: Rows, power: Rows, channel: int
) -> Float[np.ndarray, " lags"]:
    """Lags [s] at which the residual of a record follows an input most clearly; may be empty.

    Args:
        plant: the model.
        records: the records.
        residual: residual of the model, concatenated over records and, within each, over outputs.
        power: S of each row of the residual.
        channel: index of the input.
    """
    peaks, first = [], 0
    for record in records:
        rows = slice(first, first + len(plant.outputs) * len(record.omega))
        peaks += _record_lags(plant, record, residual[rows], power[rows], channel)
        first = rows.stop
    return np.asarray(list(islice(strongest(peaks), _RULES.peaks)))


def _record_lags(
    plant: Plant, record: ModalRecord, residual: Rows, power: Rows, channel: int
) -> list[Peak]:
    """Lags [s] of one record."""
    spacing, length = len(record.kernel) * record.sample_period, len(record.highest[0])
    size = 2 ** int(np.ceil(np.log2(2 * length)))
    push = {
        at_start: np.asarray(input_slopes(plant, *record.at(int(not at_start)), channel))
        for at_start in {degree == 0 for degree in plant.degrees}
    }
    product, scale = np.zeros(size), 0.0
    for j, degree in enumerate(plant.degrees):
        u = record.at(degree)[2][:, channel]
        driven = averaged(degree, push[degree == 0][:, j] * u)
        driven = record.rows(thinned(driven, record.weight[j], record.kernel), j)
        rows = slice(j * len(record.omega), (j + 1) * len(record.omega))
        late, early = (
            signal_of_low_modes(record, part / np.sqrt(power[rows]), length)
            for part in (residual[rows], driven)
        )
        product += np.fft.irfft(np.fft.rfft(late, size) * np.conj(np.fft.rfft(early, size)), size)
        scale += float(np.linalg.norm(late) * np.linalg.norm(early))
    if not scale > 0.0:
        return []
    # Either sign: without the delay in the model, the gain of the input is poorly known.
    correlation = np.abs(product[: max(int(_RULES.longest * length), 3)]) / scale
    deviation = 1.0 / np.sqrt(len(record.omega))
    return [
        Peak(spacing * lag, height / deviation, spacing)
        for lag, height in _peaks(correlation, _RULES.threshold * deviation)
    ]


def signal_of_low_modes(
    record: ModalRecord, modes: Rows, length: int
) -> Float[np.ndarray, " nodes"]:
    """The signal of the low modes, up to the first mode that is left out."""
    from scipy.fft import idct  # only discovery needs it

    is_low = record.indices == np.arange(len(record.indices))
    low_modes = np.zeros(length)
    low_modes[: np.sum(is_low)] = modes[is_low]
    return np.asarray(idct(low_modes, norm="ortho"))


def _peaks(correlation: Float[np.ndarray, " lags"], threshold: float) -> list[tuple[float, float]]:
    """Places and heights of the largest maxima; places in samples, interpolated by a parabola."""
    inner = correlation[1:-1]
    top = 1 + np.flatnonzero(
        (inner > correlation[:-2]) & (inner >= correlation[2:]) & (inner > threshold)
    )
    top = top[np.argsort(correlation[top])[::-1][: _RULES.peaks]]
    previous, center, following = correlation[top - 1], correlation[top], correlation[top + 1]
    places = top + 0.5 * (previous - following) / (previous - 2.0 * center + following)
    return list(zip(places.tolist(), center.tolist(), strict=True))
