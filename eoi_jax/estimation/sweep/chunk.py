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
from eoi_jax.estimation.sweep.source import Choices, StepSource
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
OK = tuple(number for number, name in enumerate(CODES) if name in ANSWERED)
Arrays = dict[str, np.ndarray]


def run_chunk(part: Part, engine: AbstractEngine) -> Arrays:
    """Run every lane of a chunk.

    Args:
        part: of the plan.
        engine: that runs the passes.

    Returns:
        Arrays by name, leading axes (observer, start, resample): ``parameters`` and
        ``standard_error`` (np), ``index`` (passes, ny), ``common_index`` and ``sliding_fraction``
        (ny), ``status`` (number in `CODES`), ``best_pass`` (from 0), ``passes``, ``blocks``.
    """
    results = [_Lanes(part, group, engine).run() for group in _groups(part)]
    return {
        key: np.concatenate([group_arrays[key] for group_arrays in results]) for key in results[0]
    }


def engines_used(part: Part, engine: AbstractEngine) -> list[EngineUsed]:
    """Engines that the lanes of a chunk run on, without repetition; arguments as of `run_chunk`."""
    return list(dict.fromkeys(_Lanes(part, group, engine).used() for group in _groups(part)))


def precision_error(part: Part, engine: AbstractEngine, sets: int = 16) -> dict[str, float]:
    """Largest error of single against double precision, on the first gain sets of a chunk.

    Args:
        part: the chunk.
        engine: that runs the passes.
        sets: number of gain sets.

    Returns:
        Relative error of the common index and of the parameters, each over its largest value.
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
    """Lanes of a chunk with one kind of observer."""

    def __init__(self, part: Part, gains: GainSets, engine: AbstractEngine):
        self.part, self.gains, self.engine = part, gains, engine
        observer = gains.observer
        taps = len(np.atleast_2d(np.asarray(observer.kernel))[0])
        self.source = _source(part, part.choices, taps, observer.scheme == "explicit")
        draws = range(part.resamples.start, part.resamples.stop)
        self.shape = (len(gains), len(part.starts), len(draws))
        # gain set, start and resample of each lane
        self.gain, self.start, self.draw = (axis.ravel() for axis in np.indices(self.shape))
        self.draws = _draws(part, self.source, draws)

    def run(self) -> Arrays:
        part = self.part
        start = part.starts[self.start]

        def run(running: np.ndarray, theta: np.ndarray, number: int) -> Sums:
            del number
            return self._pass(running, theta)

        history = iterate(run, part.plant, start, part.settings.passes)
        all_lanes = np.arange(len(start))
        best = history.best
        scored = self._pass(all_lanes, best.theta, "scores", best.increment, best.weights)
        covariance = sandwich(
            part.plant.free, best, np.asarray(scored.meat), self.source.block_counts
        )
        errors = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
        codes = self._codes(history)
        valid = codes != CODES.index("invalid_gains")
        answered = np.isin(codes, OK)
        arrays = {
            "parameters": np.where(answered[:, None], best.theta, np.nan),
            "standard_error": np.where(answered[:, None], errors, np.nan),
            "index": np.where(valid[:, None, None], history.index, np.nan),
            "common_index": np.where(answered[:, None], self._common(best.theta), np.nan),
            "sliding_fraction": mean(best.sums.sliding, best.sums.count),
            "status": codes,
            "blocks": np.full(len(codes), self.source.block_counts.complete_blocks, np.int32),
            "best_pass": history.best_pass.astype(np.int16),
            "passes": history.passes.astype(np.int16),
        }
        return {key: value.reshape(*self.shape, *value.shape[1:]) for key, value in arrays.items()}

    def used(self) -> EngineUsed:
        """Engine of the passes; the same for all lanes and records of a chunk."""
        lanes = self._stacked(np.arange(1), self.part.starts[:1])
        steps, lowpass = next(iter(self.source))
        return engine_used(self.engine, self.part.plant, lanes, lowpass, steps)

    def _codes(self, history: IterationHistory) -> Int[np.ndarray, " lanes"]:
        names = np.where(self.gains.valid[self.gain], history.codes, "invalid_gains")
        return np.select([names == name for name in CODES], range(len(CODES))).astype(np.int8)

    def _pass(
        self,
        selected: Int[np.ndarray, " lanes"],
        theta: Float[np.ndarray, "lanes np"],
        store: str = "nothing",
        increment: np.ndarray | None = None,
        weights: np.ndarray | None = None,
    ) -> Sums:
        """Sums over all records of the estimate, for the selected lanes."""
        lanes = self._stacked(selected, theta, increment, weights)
        return _added(self.part, self.source, lanes, self.engine, store)

    def _stacked(
        self,
        selected: Int[np.ndarray, " lanes"],
        theta: Float[np.ndarray, "lanes np"],
        increment: np.ndarray | None = None,
        weights: np.ndarray | None = None,
    ) -> Lanes:
        return Lanes(
            self.gains[self.gain[selected]].observer,
            theta,
            np.zeros_like(theta) if increment is None else increment,
            np.ones((len(theta), len(self.part.plant.outputs))) if weights is None else weights,
            None if self.draws is None else self.draws[self.draw[selected]],
        )

    def _common(self, theta: Float[np.ndarray, "lanes np"]) -> Float[np.ndarray, "lanes ny"]:
        """Index at the estimates under the default filter and observer.

        They are the same for all lanes of a record, so that the index can compare the lanes.
        """
        part = self.part
        choices = replace(part.choices, lowpass=None)
        source, observer = _default(part, choices)
        (gains,) = gain_sets(observer, len(part.plant.outputs))
        observers = gains[np.zeros(len(theta), int)].observer
        unit_weights = np.ones((len(theta), len(part.plant.outputs)))
        lanes = Lanes(observers, theta, np.zeros_like(theta), unit_weights)
        sums = _added(part, source, lanes, self.engine, "nothing")
        return np.where(sums.weight > 0, mean(sums.square, sums.weight), np.nan)


def _added(
    part: Part, source: StepSource, lanes: Lanes, engine: AbstractEngine, store: str
) -> Sums:
    total, first = None, 0
    lanes = jax.tree.map(lambda leaf: leaf.astype(part.settings.precision), lanes)
    for i, (steps, lowpass) in enumerate(source):
        record_lanes = lanes
        if lanes.emphasis is not None:
            last = first + source.blocks[i]
            record_lanes = replace(lanes, emphasis=lanes.emphasis[:, first:last])
            first = last
        new = engine.run(part.plant, record_lanes, lowpass, steps, store)
        new = jax.tree.map(lambda leaf: np.asarray(leaf, dtype=float), new)
        total = new if total is None else jax.tree.map(np.add, total, new)
    assert total is not None
    return total


def _draws(
    part: Part, source: StepSource, numbers: range
) -> Float[np.ndarray, "draws blocks"] | None:
    """Number of times that each block is drawn (block bootstrap); None for the data as measured.

    A draw depends only on the seed, the record and its number, not on the size of chunks.
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


def _source(part: Part, choices: Choices, taps: int, explicit: bool) -> StepSource:
    key = (part.group.content_hash, choices, taps, explicit, _outline(part.plant))
    return _cached_source(key, _NotInKey((part.plant, part.group.records)))


def _default(part: Part, choices: Choices) -> tuple[StepSource, AbstractObserver]:
    """The default observer of the records, and their steps for it."""
    # An implicit observer averages over as many steps as its relative degree.
    source = _source(part, choices, max(part.plant.degrees), False)
    return source, source.observer(part.plant)


class _NotInKey(tuple):
    """Arguments of a cached function that its key determines: all compare equal."""

    def __hash__(self) -> int:
        return 0

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _NotInKey)


@lru_cache(maxsize=4)
def _cached_source(key: Any, plant_and_records: _NotInKey) -> StepSource:
    """Steps of the records, prepared once in a process for all chunks of a record."""
    _, choices, taps, explicit, _ = key
    plant, records = plant_and_records
    return StepSource(plant, records, choices, taps, explicit)


def _outline(plant: Plant) -> tuple:
    """The properties of a plant that preparing records depends on, with its nominal values."""
    theta = tuple(np.asarray(plant.theta).tolist())
    return plant.degrees, plant.jumps.tobytes(), plant.names, theta
