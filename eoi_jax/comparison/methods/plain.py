"""The method of the paper: `identify` without instrumental variables, either observer form."""

from collections.abc import Sequence

import numpy as np

from eoi_jax.comparison.methods.comparator import (
    AbstractComparator,
    Estimate,
    algebraic_answer,
    not_applicable,
)
from eoi_jax.data.record import Record
from eoi_jax.estimation.identify import Identification, identify
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.observers import FirstOrder, HighOrder, PerOutput, SecondOrder
from eoi_jax.estimation.observers.observer import AbstractObserver
from eoi_jax.models.plant import Plant


class PlainImplicit(AbstractComparator):
    """`identify` with the default implicit observer, filter and sub-steps."""

    name = "plain_implicit"
    description = "the paper's passes, observer in implicit form, gains and filter by default"

    def estimate(self, plant: Plant, records: Sequence[Record]) -> Estimate:
        """`identify` with its defaults."""
        return answer(plain(plant, records))


class PlainExplicit(AbstractComparator):
    """`identify` with the observer discretised by Euler's rule, as published.

    In this form a large relay adds chatter. It is set to twice the largest filtered injection of a
    first pass of the implicit form at the nominal parameters; for an output of relative degree one,
    to twice the fastest change of that injection. The sampled relay of degree two has a limit cycle
    at √(c₁/h), with c₁ equal to 1.4 cut-offs; the cut-off is at most a quarter of that frequency.
    """

    name = "plain_explicit"
    description = "the paper's passes, observer in explicit (Euler) form as published"

    def estimate(self, plant: Plant, records: Sequence[Record]) -> Estimate:
        """A first pass sets the gains, then `identify`."""
        refused = algebraic_answer(plant)
        if refused is not None:
            return refused
        first = plain(plant, records, passes=1)
        period = max(record.sample_period for record in records)
        cutoff = _highest_cutoff(period)
        if plant.relative_degree > 1 and first.lowpass.cutoff > cutoff:
            first = plain(plant, records, None, LowPass(cutoff, first.lowpass.order), passes=1)
        if not first.status.ok:
            return answer(first)
        observer = explicit_form(first)
        if observer is None:
            degrees = ", ".join(str(degree) for degree in plant.degrees)
            reason = "there is no explicit observer for outputs of relative degree three or more"
            return not_applicable(f"{reason}, and the plant has {degrees}")
        return answer(plain(plant, records, observer, first.lowpass))


def plain(
    plant: Plant,
    records: Sequence[Record],
    observer: AbstractObserver | None = None,
    lowpass: LowPass | None = None,
    passes: int = 10,
) -> Identification:
    """`identify` as in the paper, without later additions.

    Args:
        plant: with its nominal parameters.
        records: of the estimate.
        observer: chosen by default.
        lowpass: F; chosen by default.
        passes: largest number of iterations.
    """
    return identify(plant, records, observer, lowpass, passes, instruments=False)


def answer(result: Identification) -> Estimate:
    """An identification as a comparator's answer."""
    if not result.status.ok:
        return Estimate(None, None, result.status)
    return Estimate(result.parameters, result.standard_errors, result.status)


def _highest_cutoff(period: float, ratio: float = 4.0) -> float:
    """Cut-off of F [rad/s] below the relay's limit cycle by this ratio; 4.6 in the paper."""
    return 1.4 / (ratio**2 * period)


def explicit_form(first: Identification, relay_ratio: float = 2.0) -> AbstractObserver | None:
    """The observer of a first pass in explicit form; None if one of its parts has none.

    Its relays have gains of `relay_ratio` times the largest injection, or its largest rate.
    """
    size, speed = _largest(first)

    def convert(part: AbstractObserver, outputs: slice) -> AbstractObserver | None:
        if isinstance(part, FirstOrder):
            return FirstOrder(relay_ratio * speed[outputs], part.leak, "explicit")
        if isinstance(part, SecondOrder):
            return SecondOrder(part.c1, part.c2, relay_ratio * size[outputs], "explicit")
        assert isinstance(part, HighOrder)
        return None

    observer = first.observer
    if not isinstance(observer, PerOutput):
        return convert(observer, slice(None))
    parts = [convert(part, slice(j, j + 1)) for j, part in enumerate(observer.observers)]
    converted = [part for part in parts if part is not None]
    return PerOutput(tuple(converted)) if len(converted) == len(parts) else None


def _largest(first: Identification) -> tuple[np.ndarray, np.ndarray]:
    """Largest filtered injection of each output, and its fastest change [per s], both positive."""
    floor = np.finfo(float).tiny ** 0.5
    sizes, speeds = [], []
    for record, injection in zip(first.records, first.first_injection, strict=True):
        sizes.append(np.nanmax(np.abs(injection), axis=0, initial=floor))
        change = np.abs(np.diff(injection, axis=0)) / record.sample_period
        speeds.append(np.nanmax(change, axis=0, initial=floor))
    return np.max(sizes, axis=0), np.max(speeds, axis=0)
