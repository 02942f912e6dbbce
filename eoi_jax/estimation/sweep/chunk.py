"""One chunk of a sweep: its lanes iterated, and scored so that they can be compared."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from eoi_jax._status import ANSWERED, EngineUsed
from eoi_jax.estimation.engines import AbstractEngine, Lanes
from eoi_jax.estimation.engines.automatic import engine_used
from eoi_jax.estimation.iteration import IterationHistory, iterate, mean, sandwich
from eoi_jax.estimation.kernel import Sums
from eoi_jax.estimation.observers import AbstractObserver
from eoi_jax.estimation.observers.gain_sets import GainSets, gain_sets
from eoi_jax.estimation.sweep.plan import Part
from eoi_jax.estimation.sweep.source import Choices, Source
from eoi_jax.models.plant import Plant

CODES = (
    "not_run",
    "converged",
    "passes_exhausted",
    "stalled",
    "unidentifiable",
    "diverged",
    "no_data",
    "invalid_gains",
    "lost",
)
OK = tuple(CODES.index(name) for name in ANSWERED)
Arrays = dict[str, np.ndarray]


def run_chunk(part: Part, engine: AbstractEngine) -> Arrays:
    """Every lane of a chunk.

    Args:
        part: of the plan.
        engine: that runs the passes.

    Returns:
        Arrays by name, leading axes (observer, start, resample): ``parameters`` and
        ``standard_error`` (np), ``index`` (passes, ny), ``common_index`` and ``sliding_fraction``
        (ny), ``status`` (number in `CODES`), ``best_pass`` (from 0), ``passes``, ``blocks``.
    """
    results = [_Lanes(part, group, engine).run() for group in _groups(part)]
    return {key: np.concatenate([one[key] for one in results]) for key in results[0]}


def engines_used(part: Part, engine: AbstractEngine) -> list[EngineUsed]:
    """Which engines the lanes of a chunk run on, each once; arguments as of `run_chunk`."""
    return list(dict.fromkeys(_Lanes(part, group, engine).used() for group in _groups(part)))


def precision_error(part: Part, engine: AbstractEngine, sets: int) -> dict[str, float]:
    """What single precision costs, on a few gain sets: largest relative error against double.

    Returns:
        Of the common index and of the parameters, each against its largest value.
    """
    single, double = (
        run_chunk(part.sample(sets, precision), engine) for precision in ("float32", "float64")
    )
    ok = np.isin(double["status"], OK)
    errors = {}
    for name in ("common_index", "parameters"):
        a, b = single[name][ok], double[name][ok]
        size = np.max(np.abs(b), axis=0, initial=np.finfo(float).tiny)
        errors[name] = float(np.max(np.abs(a - b) / size, initial=0.0)) if b.size else np.nan
    return errors


def _groups(part: Part) -> tuple[GainSets, ...]:
    """Observers of a chunk, by kind."""
    if part.observers is not None:
        return part.observers
    return gain_sets(_default(part, part.choices)[1], len(part.plant.outputs))


class _Lanes:
    """Lanes of one kind of observer."""

    def __init__(self, part: Part, gains: GainSets, engine: AbstractEngine):
        self.part, self.gains, self.engine = part, gains, engine
        observer = gains.observer
        taps = len(np.atleast_2d(np.asarray(observer.kernel))[0])
        self.source = _source(part, part.choices, taps, observer.scheme == "explicit")
        draws = range(part.resamples.start, part.resamples.stop)
        self.shape = (len(gains), len(part.starts), len(draws))
        # of each lane, which gain set, start and resample
        self.gain, self.start, self.draw = (axis.ravel() for axis in np.indices(self.shape))
        self.draws = _draws(part, self.source, draws)

    def run(self) -> Arrays:
        part = self.part
        start = part.starts[self.start]

        def run(which: np.ndarray, theta: np.ndarray, number: int) -> Sums:
            del number
            return self._pass(which, theta)

        done = iterate(run, part.plant, start, part.settings.passes)
        every = np.arange(len(start))
        one = done.best
        scored = self._pass(every, one.theta, "scores", one.increment, one.weights)
        covariance = sandwich(part.plant.free, one, np.asarray(scored.meat), self.source.tally)
        errors = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
        codes = self._codes(done)
        valid = codes != CODES.index("invalid_gains")
        known = np.isin(codes, OK)
        arrays = {
            "parameters": np.where(known[:, None], one.theta, np.nan),
            "standard_error": np.where(known[:, None], errors, np.nan),
            "index": np.where(valid[:, None, None], done.index, np.nan),
            "common_index": np.where(known[:, None], self._common(one.theta), np.nan),
            "sliding_fraction": mean(one.sums.sliding, one.sums.count),
            "status": codes,
            "blocks": np.full(len(codes), self.source.tally.complete_blocks, np.int32),
            "best_pass": done.best_pass.astype(np.int16),
            "passes": done.passes.astype(np.int16),
        }
        return {key: value.reshape(*self.shape, *value.shape[1:]) for key, value in arrays.items()}

    def used(self) -> EngineUsed:
        """The engine that the passes run on: the same for all lanes and all records of a part."""
        lanes = self._stacked(np.arange(1), self.part.starts[:1])
        steps, lowpass = next(iter(self.source))
        return engine_used(self.engine, self.part.plant, lanes, lowpass, steps)

    def _codes(self, done: IterationHistory) -> Int[np.ndarray, " lanes"]:
        names = np.where(self.gains.valid[self.gain], done.codes, "invalid_gains")
        return np.select([names == name for name in CODES], range(len(CODES))).astype(np.int8)

    def _pass(
        self,
        which: Int[np.ndarray, " lanes"],
        theta: Float[np.ndarray, "lanes np"],
        store: str = "nothing",
        increment: np.ndarray | None = None,
        weights: np.ndarray | None = None,
    ) -> Sums:
        """Sums over all records of the estimate, of some of the lanes."""
        lanes = self._stacked(which, theta, increment, weights)
        return _added(self.part, self.source, lanes, self.engine, store)

    def _stacked(
        self,
        which: Int[np.ndarray, " lanes"],
        theta: Float[np.ndarray, "lanes np"],
        increment: np.ndarray | None = None,
        weights: np.ndarray | None = None,
    ) -> Lanes:
        return Lanes(
            self.gains[self.gain[which]].observer,
            theta,
            np.zeros_like(theta) if increment is None else increment,
            np.ones((len(theta), len(self.part.plant.outputs))) if weights is None else weights,
            None if self.draws is None else self.draws[self.draw[which]],
        )

    def _common(self, theta: Float[np.ndarray, "lanes np"]) -> Float[np.ndarray, "lanes ny"]:
        """Index at the estimates under the filter and the observer that would be chosen.

        The same for all lanes of a record, so that it can compare them.
        """
        part = self.part
        choices = replace(part.choices, lowpass=None)
        source, observer = _default(part, choices)
        (gains,) = gain_sets(observer, len(part.plant.outputs))
        alike = gains[np.zeros(len(theta), int)].observer
        ones = np.ones((len(theta), len(part.plant.outputs)))
        lanes = Lanes(alike, theta, np.zeros_like(theta), ones)
        sums = _added(part, source, lanes, self.engine, "nothing")
        return np.where(sums.weight > 0, mean(sums.square, sums.weight), np.nan)


def _added(part: Part, source: Source, lanes: Lanes, engine: AbstractEngine, store: str) -> Sums:
    total, first = None, 0
    lanes = jax.tree.map(lambda leaf: leaf.astype(part.settings.precision), lanes)
    for i, (steps, lowpass) in enumerate(source):
        here = lanes
        if lanes.emphasis is not None:
            last = first + source.blocks[i]
            here = replace(lanes, emphasis=lanes.emphasis[:, first:last])
            first = last
        new = engine.run(part.plant, here, lowpass, steps, store)
        new = jax.tree.map(lambda leaf: np.asarray(leaf, dtype=float), new)
        total = new if total is None else jax.tree.map(np.add, total, new)
    assert total is not None
    return total


def _draws(part: Part, source: Source, numbers: range) -> Float[np.ndarray, "draws blocks"] | None:
    """How often each block of the records is drawn (block bootstrap); None: the data as they are.

    A draw depends on seed, record and its own number alone: chunks may be cut in any way.
    """
    if numbers == range(1):
        return None
    count = sum(source.blocks)
    rows = []
    for number in numbers:
        rng = np.random.default_rng([part.settings.seed, part.number, number])
        drawn = rng.multinomial(count, np.full(count, 1.0 / count))
        rows.append(drawn if number else np.ones(count))
    return np.asarray(rows, dtype=float)


def _source(part: Part, choices: Choices, taps: int, explicit: bool) -> Source:
    key = (part.group.content_hash, choices, taps, explicit, _outline(part.plant))
    return _remembered(key, _Unhashed((part.plant, part.group.records)))


def _default(part: Part, choices: Choices) -> tuple[Source, AbstractObserver]:
    """The observer that would be chosen for the records, and their steps for it."""
    # An implicit observer averages over as many steps as its relative degree.
    source = _source(part, choices, max(part.plant.degrees), False)
    return source, source.observer(part.plant)


class _Unhashed(tuple):
    """Goes along with a key that says it all."""

    def __hash__(self) -> int:
        return 0

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Unhashed)


@lru_cache(maxsize=4)
def _remembered(key: Any, rest: _Unhashed) -> Source:
    """Sources are made ready once in a process, for all chunks of a record."""
    _, choices, taps, explicit, _ = key
    plant, records = rest
    return Source(plant, records, choices, taps, explicit)


def _outline(plant: Plant) -> tuple:
    """What preparing records asks of a plant, and its nominal values."""
    theta = tuple(np.asarray(plant.theta).tolist())
    return plant.degrees, plant.jumps.tobytes(), plant.names, theta
