"""Samples of an output that stand out alone: a dropout, a flipped bit, a tick that was missed.

What has inertia or a store cannot leave its course for one sample and be back at the next. Such a
sample is a fault of the sensor; one of them moves a fit by more than all others.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from eoi_jax._checks import counted
from eoi_jax._types import Inputs, OutputMask, Outputs

# A sample less the cubic through two neighbours on each side.
_STENCIL = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / 6.0


@dataclass(frozen=True)
class GlitchSettings:
    """When a sample is a fault of the sensor; sizes are distances from the course around it."""

    deviations: float = 20.0  # robust standard deviations of such distances, at least
    share: float = 0.1  # of the range of the signal, at least: smaller ones hardly move a fit
    contrast: float = 4.0  # times the largest distance of all samples that are none, at least
    unexplained: float = 0.2  # of its distance: what one fault leaves of those beside it, at most
    max_share: float = 0.005  # share of the samples; more often it is the signal: impacts, pulses
    fewest: int = 30  # samples from which on it is clear what is usual
    moved: float = 0.1  # of an input's range: where it moves so much the plant may answer at once


_SETTINGS = GlitchSettings()


def without_faults(
    y: Outputs, good: OutputMask, u: Inputs, names: tuple[str, ...], notes: list[str]
) -> OutputMask:
    """Samples of each output that are no faults of its sensor; a note says which are.

    Args:
        y: outputs as they were logged.
        good: where each output is finite.
        u: inputs as they were logged.
        names: of the outputs.
        notes: to which a sentence is added.
    """
    valid = good.copy()
    for channel, name in enumerate(names):
        rows = np.flatnonzero(good[:, channel])
        faulty = rows[stand_alone(y[rows, channel])].tolist()
        faulty = [row for row in faulty if not _moves(u, row)]
        if not faulty:
            continue
        valid[faulty, channel] = False
        places = ", ".join(f"{y[row, channel]:.4g} in row {row}" for row in faulty[:3])
        tail = " and others" if len(faulty) > 3 else ""
        leaves, fault = ("leaves its", "a fault") if len(faulty) == 1 else ("leave their", "faults")
        sentence = f"{counted(len(faulty), 'sample')} of `{name}` {leaves} course for one row ("
        sentence += f"{places}{tail}, counted from 0): masked as {fault} of the sensor."
        notes.append(sentence)
    return valid


def stand_alone(values: Float[np.ndarray, " samples"]) -> Int[np.ndarray, " faults"]:
    """Indices of the samples that stand out alone.

    Args:
        values: finite, in the order of time.
    """
    if len(values) < _SETTINGS.fewest:
        return np.zeros(0, dtype=np.int64)
    distance = np.convolve(values, _STENCIL, "valid")  # of sample k + 2 at k
    size = np.abs(distance)
    usual = float(np.median(size)) / 0.6745
    limit = max(_SETTINGS.deviations * usual, _SETTINGS.share * float(np.ptp(values)))
    count = max(1, int(_SETTINGS.max_share * len(values)))
    largest = np.argsort(-size)[: 5 * count]
    faults: list[int] = []
    for k in largest[size[largest] > limit].tolist():
        window = slice(max(k - 2, 0), k + 3)
        if any(abs(k - peak) < 5 for peak in faults):
            continue  # it is around one of them
        shape = _STENCIL[window.start - k + 2 :][: len(distance[window])]
        fault = float(distance[window] @ shape / (shape @ shape))
        remainder = float(np.max(np.abs(distance[window] - fault * shape)))
        if remainder <= _SETTINGS.unexplained * abs(distance[k]):
            faults.append(k)
    if not 0 < len(faults) <= count:
        return np.zeros(0, dtype=np.int64)
    normal = np.ones(len(size), dtype=bool)
    for k in faults:
        normal[max(k - 2, 0) : k + 3] = False
    if _SETTINGS.contrast * float(np.max(size[normal], initial=0.0)) > float(size[faults].min()):
        return np.zeros(0, dtype=np.int64)
    return np.sort(np.asarray(faults)) + 2


def _moves(u: Inputs, row: int) -> bool:
    """Whether an input moves at a sample or just before it."""
    levels = u[max(row - 1, 0) : row + 2]
    if not u.shape[1] or not np.all(np.isfinite(levels)):
        return bool(u.shape[1])
    spans = np.nanmax(u, axis=0) - np.nanmin(u, axis=0)
    return bool(np.any(np.ptp(levels, axis=0) > _SETTINGS.moved * spans))
