"""Runs of a refinement: whole records, or windows of them, between the gaps of inputs."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from eoi_jax.data.masks import scored_samples
from eoi_jax.data.record import Record

FEWEST_STEPS = 8  # steps of a run, at least


@dataclass(frozen=True)
class Span:
    """One run: samples `first` to `first + count` of a record, and which of them it scores.

    All inputs are known in the segment (start, stop) of the record in which it lies.
    """

    record: int
    first: int
    count: int
    use: Bool[np.ndarray, "time ny"]
    segment: tuple[int, int]


def starts_record(records: Sequence[Record], span: Span) -> bool:
    """Whether a run begins where its record does, and that is no later part of another one."""
    return span.first == 0 and not records[span.record].continues


def spans_of(
    records: Sequence[Record], window: float | None, min_samples: int = FEWEST_STEPS
) -> list[Span]:
    """Records cut into runs of about `window` seconds, of equal length within a record.

    A run has at least `min_samples` sample periods, unless its record is shorter. Where an input is
    unknown, a run ends before and another one starts behind; parts that are shorter have none.
    """
    spans = []
    for i, record in enumerate(records):
        scored = scored_samples(record)
        for segment in driven_segments(record, min_samples):
            start, steps = segment[0], segment[1] - segment[0] - 1
            pieces = 1 if window is None else max(round(steps * record.sample_period / window), 1)
            pieces = min(pieces, max(steps // min_samples, 1))
            edges = start + np.round(np.linspace(0, steps, pieces + 1)).astype(int)
            for first, last in itertools.pairwise(edges):
                use = scored[first : last + 1].copy()
                use[-1] &= last == edges[-1]  # else it is the first one of the next run
                spans.append(Span(i, int(first), int(last - first), use, segment))
    return spans


def driven_segments(record: Record, min_samples: int) -> list[tuple[int, int]]:
    """Runs (start, stop) of samples with known inputs, of so many steps at least."""
    segments = record.input_segments()
    if len(segments) == 1:
        return segments
    return [segment for segment in segments if segment[1] - segment[0] > min_samples]


def used_window(
    records: Sequence[Record], spans: Sequence[Span], window: float | None
) -> float | None:
    """Length of runs [s] that cuts these records into these runs; None for whole records.

    The mean length where that does. What was asked for stays where runs are as long to a sample.
    """
    pieces = [sum(span.record == i for span in spans) for i in range(len(records))]
    if window is None or max(pieces) == 1:
        return None
    lengths = [(len(record) - 1) * record.sample_period for record in records]
    lengths_used = [length / count for length, count in zip(lengths, pieces, strict=True)]
    if all(
        abs(length - window) <= r.sample_period
        for length, r in zip(lengths_used, records, strict=True)
    ):
        return window
    cuts = [(span.record, span.first) for span in spans]
    for length in (sum(lengths) / len(spans), min(lengths_used), max(lengths_used)):
        if [(span.record, span.first) for span in spans_of(records, length)] == cuts:
            return length
    return window
