"""Passes of one lane over several records: one estimate, as `identify` runs it.

Compiled for scalars where that can be, with a record on each core; else a scan over all of them.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from eoi_jax.engines.compiled import Compiled, cores, together, translated
from eoi_jax.engines.engine import Lanes
from eoi_jax.engines.lane_program import Pass
from eoi_jax.engines.native import PassRun, pass_of, rows_of
from eoi_jax.engines.scalars import Untranslatable
from eoi_jax.lowpass import DiscreteFilter
from eoi_jax.observers.observer import AbstractObserver
from eoi_jax.passes import Steps, Sums, Trace, run_pass
from eoi_jax.plants.plant import Plant

_CHUNK_BYTES = 500_000  # of what is shared of the record, at a time: it stays in the cache

Theta = Float[np.ndarray, " np"]
OnePass = Callable[[Theta, str], tuple[Sums, Trace | None]]


def alone(
    plant: Plant, observer: AbstractObserver, lowpass: DiscreteFilter, steps: Steps
) -> OnePass:
    """The pass of one observer over the same records, again and again.

    Args:
        plant: the model; parameters come with each pass.
        observer: with its gains.
        lowpass: the sampled filter of each record (leading axis).
        steps: the records (leading axis), padded to one length with `use` = `score` = 0.

    Returns:
        A function of θ and of `store`, all but ``"scores"``. It gives sums and traces as NumPy
        arrays, each with the records as leading axis, as `run_pass` does.
    """
    dtype = np.dtype(jnp.result_type(float))
    records = [jax.tree.map(lambda leaf, i=i: np.asarray(leaf)[i], (steps, lowpass))
               for i in range(len(np.asarray(steps.use)))]  # fmt: skip
    rows: list[np.ndarray] = []
    # An observer of the user's own may hold other things than gains.
    numbers = all(np.asarray(leaf).dtype.kind in "fi" for leaf in jax.tree.leaves(observer))

    def scanned(theta: Theta, store: str) -> Any:
        return run_pass(plant, observer, lowpass, steps, jnp.asarray(theta), store=store)

    @functools.cache
    def program(store: str) -> tuple[Pass, Compiled]:
        lane = _lane(observer, np.asarray(plant.theta), len(plant.outputs), dtype)
        what, columns = pass_of(plant, lane, records[0][1], records[0][0], store)
        return what, translated(what, columns, 1)

    def run(theta: Theta, store: str) -> Any:
        if not numbers:
            return scanned(theta, store)
        try:
            what, code = program(store)
        except Untranslatable:
            return scanned(theta, store)
        lane = _lane(observer, theta, len(plant.outputs), dtype)
        if not rows:
            rows.extend(_counted(each, dtype) for each, _ in records)
        shown = len(code.program.shown[0])
        signals = np.zeros((*np.shape(steps.use)[:2], shown), dtype)
        jobs = [(PassRun(code, what, lane, 1), i) for i in range(len(records))]
        waiting = iter(jobs)

        def work() -> None:
            for job, i in waiting:  # threads take from one iterator
                (one, own), keep = records[i], signals[i] if shown else None
                job.go(plant, own, one, rows[i], keep, _CHUNK_BYTES)

        together(work, min(cores(), len(jobs)))
        sums = [job.sums() for job, _ in jobs]
        trace = _trace(signals, len(plant.outputs))
        return jax.tree.map(lambda *leaves: np.concatenate(leaves), *sums), trace

    return run


def _lane(observer: AbstractObserver, theta: Theta, outputs: int, dtype: Any) -> Lanes:
    """The only one; it has neither Δθ nor weights of outputs, which only scores ask for."""
    gains = jax.tree.map(lambda leaf: np.asarray(leaf, dtype)[None], observer)
    given = theta, np.zeros_like(theta), np.ones(outputs)
    return Lanes(gains, *(np.asarray(one, dtype)[None] for one in given))


def _counted(steps: Steps, dtype: Any) -> np.ndarray:
    """Rows of a record up to the last one that counts."""
    counts = np.any((np.asarray(steps.use) > 0) & (np.asarray(steps.score) > 0), axis=1)
    last = np.flatnonzero(counts)[-1:] + 1
    return rows_of(steps, dtype)[: last[0] if len(last) else 1]


def _trace(signals: Float[np.ndarray, "records S signals"], ny: int) -> Trace | None:
    """What each step shows, part by part; zero behind the last one that counts."""
    if not signals.size:
        return None
    injection, weight, phi = np.split(signals, (ny, 2 * ny), axis=2)
    return Trace(injection, weight, phi.reshape(*phi.shape[:2], ny, -1))
