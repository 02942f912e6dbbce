r"""Lags at which what a model lacks follows an input: where a grid of delays should look.

A model that lacks a delay τ leaves r(t) = b (u(t - τ) - u(t)) with b = ∂f/∂u, less what its other
parameters take of it. Far beyond the band's period no point of a coarse grid is near enough to
start a descent, but r and b u, both whitened by the power S(ω) of what is left, correlate at
the lag τ: generalised cross-correlation.

Source:
    C. H. Knapp, G. C. Carter, IEEE Trans. Acoust., Speech, Signal Process. 24 (1976) 320.
"""

from collections.abc import Iterator, Sequence
from itertools import islice
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from eoi_jax.discovery.cosine_modes import ModalRecord, Rows
from eoi_jax.discovery.thinning import averaged, thinned
from eoi_jax.models.jacobians import input_slopes
from eoi_jax.models.plant import Plant

_CLEAR = 6.0  # standard deviations of a correlation of noise, from which on it is a peak
_LONGEST = 0.25  # of a record
_PEAKS = 2


class Peak(NamedTuple):
    """One maximum: where it is, how far it stands out, and how near another would be the same."""

    place: float
    strength: float
    width: float


def strongest(peaks: Sequence[Peak]) -> Iterator[float]:
    """Places of peaks from several records, the strongest first, each once.

    Args:
        peaks: in any order, which does not count.
    """
    taken: list[Peak] = []
    for one in sorted(peaks, key=lambda one: (-one.strength, one.place)):
        if all(abs(one.place - other.place) > max(one.width, other.width) for other in taken):
            taken.append(one)
            yield one.place


def lags(
    plant: Plant, several: Sequence[ModalRecord], residual: Rows, power: Rows, channel: int
) -> Float[np.ndarray, " lags"]:
    """Where the residual of some record follows an input most clearly [s]; none where none does.

    Args:
        plant: the model.
        several: the records.
        residual: of the model, modes of one output after the other, record after record.
        power: S of each of them.
        channel: of the input.
    """
    peaks, first = [], 0
    for one in several:
        own = slice(first, first + len(plant.outputs) * len(one.omega))
        peaks += _of_record(plant, one, residual[own], power[own], channel)
        first = own.stop
    return np.asarray(list(islice(strongest(peaks), _PEAKS)))


def _of_record(
    plant: Plant, one: ModalRecord, residual: Rows, power: Rows, channel: int
) -> list[Peak]:
    """Lags [s] of one record."""
    spacing, length = len(one.kernel) * one.sample_period, len(one.highest[0])
    size = 2 ** int(np.ceil(np.log2(2 * length)))
    push = np.asarray(input_slopes(plant, one.time, one.y, one.u, channel))
    product, scale = np.zeros(size), 0.0
    for j, degree in enumerate(plant.degrees):
        driven = averaged(degree, push[:, j] * one.u[:, channel])
        driven = one.rows(thinned(driven, one.weight[j], one.kernel))
        own = slice(j * len(one.omega), (j + 1) * len(one.omega))
        late, early = (
            _signal(one, part / np.sqrt(power[own]), length) for part in (residual[own], driven)
        )
        product += np.fft.irfft(np.fft.rfft(late, size) * np.conj(np.fft.rfft(early, size)), size)
        scale += float(np.linalg.norm(late) * np.linalg.norm(early))
    if not scale > 0.0:
        return []
    # Of either sign: what an input does is hardly known beside a delay that is not in the model.
    along = np.abs(product[: max(int(_LONGEST * length), 3)]) / scale
    deviation = 1.0 / np.sqrt(len(one.omega))
    return [
        Peak(spacing * lag, height / deviation, spacing)
        for lag, height in _peaks(along, _CLEAR * deviation)
    ]


def _signal(one: ModalRecord, modes: Rows, length: int) -> Float[np.ndarray, " nodes"]:
    """The part of a signal that its low modes hold, of which none is left out."""
    from scipy.fft import idct  # only discovery needs it

    low = one.indices == np.arange(len(one.indices))
    whole = np.zeros(length)
    whole[: np.sum(low)] = modes[low]
    return np.asarray(idct(whole, norm="ortho"))


def _peaks(along: Float[np.ndarray, " lags"], least: float) -> list[tuple[float, float]]:
    """The largest maxima: places in the unit of an index, between two by a parabola; heights."""
    inner = along[1:-1]
    top = 1 + np.flatnonzero((inner > along[:-2]) & (inner >= along[2:]) & (inner > least))
    top = top[np.argsort(along[top])[::-1][:_PEAKS]]
    before, at, after = along[top - 1], along[top], along[top + 1]
    places = top + 0.5 * (before - after) / (before - 2.0 * at + after)
    return list(zip(places.tolist(), at.tolist(), strict=True))
