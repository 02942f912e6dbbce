"""Passes of one lane over several records: one estimate, as `identify` runs it.

Compiled where that can be, with a record on each core; else a scan over all of them. The compiled
loop has the regressors side by side in a vector, one direction in θ for each, and puts out F[φ] of
every step, from which Σφᵀφ follows; all else is of single numbers.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from eoi_jax._status import NATIVE, EngineUsed
from eoi_jax.compiler.graph import Untranslatable
from eoi_jax.compiler.loop import AbstractLoop
from eoi_jax.compiler.runtime import CompiledLoop, compiled_loop, cores, numbers, run_in_threads
from eoi_jax.estimation.engines.engine import Lanes
from eoi_jax.estimation.engines.native import pass_of, rows_of
from eoi_jax.estimation.kernel import Carry, Kernel, Step, Steps, Sums, Trace, run_pass
from eoi_jax.estimation.lowpass import DiscreteFilter
from eoi_jax.estimation.observers.observer import AbstractObserver
from eoi_jax.models.plant import Plant

Theta = Float[np.ndarray, " np"]


@dataclass(frozen=True)
class OnePass:
    """The pass of one observer over the same records, as a function of θ and of `store`.

    Attributes:
        run: gives sums and traces as NumPy arrays, each with the records as leading axis, as
            `run_pass` does; `store` is any but ``"scores"``.
        used: the engine that it runs on.
    """

    run: Callable[[Theta, str], tuple[Sums, Trace | None]]
    used: EngineUsed

    def __call__(self, theta: Theta, store: str) -> tuple[Sums, Trace | None]:
        """One pass."""
        return self.run(theta, store)


def single_pass(
    plant: Plant, observer: AbstractObserver, lowpass: DiscreteFilter, steps: Steps
) -> OnePass:
    """The pass of one observer over the same records, again and again.

    Args:
        plant: the model; parameters come with each pass.
        observer: with its gains.
        lowpass: the sampled filter of each record (leading axis).
        steps: the records (leading axis), padded to one length with `use` = `score` = 0.

    Returns:
        The pass; on the scan where it cannot be compiled to machine code.
    """
    dtype = np.dtype(jnp.result_type(float))
    records = [jax.tree.map(lambda leaf, i=i: np.asarray(leaf)[i], (steps, lowpass))
               for i in range(len(np.asarray(steps.use)))]  # fmt: skip
    rows: list[np.ndarray] = []
    # An observer of the user's own may hold other things than gains.
    numeric = all(np.asarray(leaf).dtype.kind in "fi" for leaf in jax.tree.leaves(observer))

    def scanned(theta: Theta, store: str) -> Any:
        return run_pass(plant, observer, lowpass, steps, jnp.asarray(theta), store=store)

    def code() -> CompiledLoop:
        if not numeric:
            raise Untranslatable("an observer that holds other things than numbers")
        lane = _lane(observer, np.asarray(plant.theta), len(plant.outputs), dtype)
        lanes, columns = pass_of(plant, lane, records[0][1], records[0][0], "signals")
        loop = _SinglePass(
            lanes.plant, lanes.lowpass, lanes.lane.observer, lanes.lane.theta, lanes.step, dtype,
            lanes.z_start,
        )  # fmt: skip
        return compiled_loop(loop, columns, len(plant.names), True)

    try:
        compiled = code()
    except Untranslatable as reason:
        return OnePass(scanned, EngineUsed("scan", str(reason)))

    def run(theta: Theta, store: str) -> Any:
        if not rows:
            rows.extend(_counted(record, dtype) for record, _ in records)
        signals = None
        if store == "signals":  # zeros stay behind the last step that counts
            signals = np.zeros((*np.shape(steps.use)[:2], compiled.outputs[-1].stop), dtype)
        jobs = [_Job(compiled, plant, observer, theta, *record) for record in records]
        waiting = iter(range(len(jobs)))

        def work() -> None:
            for i in waiting:  # threads take from one iterator
                jobs[i].go(rows[i], None if signals is None else signals[i])

        run_in_threads(work, min(cores(), len(jobs)))
        sums = [job.sums() for job in jobs]
        trace = None if signals is None else _trace(signals, compiled.outputs, len(theta))
        return jax.tree.map(lambda *leaves: np.stack(leaves), *sums), trace

    return OnePass(run, NATIVE)


@dataclass(frozen=True, eq=False)
class _SinglePass(AbstractLoop):
    """What is traced: lanes are directions in θ, one for each regressor; the rest is shared."""

    plant: Plant
    lowpass: DiscreteFilter
    observer: AbstractObserver
    lane: Any
    step: Step
    dtype: np.dtype
    z_start: Any

    @property
    def fixed(self) -> tuple:
        """What all steps share: plant, F, gains, θ, h, and `Steps.begin`."""
        begin = self.step.y, self.step.y_next, self.z_start
        scalar = jax.ShapeDtypeStruct((), self.dtype)
        return self.plant, self.lowpass, self.observer, self.lane, scalar, *begin

    def begin(self, lane: Any, fixed: tuple) -> Carry:
        """Before the first step."""
        *_, h, y, y_next, z_start = fixed
        return self._kernel(lane, fixed).init(y, y_next, h, z_start)

    def advance(self, lane: Any, fixed: tuple, carry: Carry, row: Step) -> tuple[Carry, Trace]:
        """One step, and its part of a trace."""
        *_, h, _, _, _ = fixed
        return self._kernel(lane, fixed).step(carry, row, h)

    def _kernel(self, lane: Any, fixed: tuple) -> Kernel:
        plant, lowpass, observer, theta, *_ = fixed
        theta, columns = jnp.asarray(theta), jnp.asarray(lane)[:, None]
        no_increment, ones = jnp.zeros_like(theta), jnp.ones(len(plant.outputs), self.dtype)
        return Kernel(plant, observer, lowpass, theta, no_increment, ones, "signals", columns)

    def result(self, carry: Carry) -> Any:
        """What is wanted after the last step."""
        return carry.sums


class _Job:
    """The pass over one record."""

    def __init__(
        self,
        code: CompiledLoop,
        plant: Plant,
        observer: AbstractObserver,
        theta: Theta,
        steps: Steps,
        lowpass: DiscreteFilter,
    ):
        shared = plant, lowpass, observer, theta, steps.sample_period, *steps.begin
        fixed = numbers(shared, code.dtype)
        # A comparison with NaN is false: what the loop makes of one may look like a number.
        self._spoilt = bool(np.any(np.isnan(numbers((observer, theta), code.dtype))))
        self._run = code.begin(np.eye(len(theta), dtype=code.dtype), fixed)
        self._score = np.asarray(steps.score, code.dtype)
        ny = self._score.shape[1]
        self._information = np.zeros((ny, len(theta), len(theta)), code.dtype)

    def go(self, rows: np.ndarray, signals: np.ndarray | None, chunk: int = 4096) -> None:
        """Through the record, `chunk` rows at a time, so that their outputs stay in the cache.

        Outputs are written to `signals` if it is an array.
        """
        places, ny, size = self._run.code.outputs, *self._information.shape[:2]
        first = 0
        with np.errstate(over="ignore", invalid="ignore"):  # of a model without bound
            for part in self._run.outputs(rows, chunk, signals):
                scores = self._score[first : first + len(part)]
                first += len(part)
                for j in range(ny):
                    phi = _regressors(part, places[2 * ny + j], size)
                    # Nearly all steps count: the product would take longer than all else here.
                    all_count = np.all(scores[:, j] == 1.0)
                    scored = phi if all_count else scores[:, j, None] * phi
                    self._information[j] += scored.T @ phi

    def sums(self) -> Sums:
        """What has been added up."""
        size, dtype = self._information.shape[1], self._information.dtype

        def carried(places: np.ndarray) -> np.ndarray:
            values = [np.broadcast_to(self._run.carried(i), size) for i in places.ravel()]
            return np.stack(values).astype(dtype)

        places = self._run.code.program.result
        sums = Sums(
            information=self._information,
            rhs=carried(places.rhs),
            square=carried(places.square)[:, 0],
            observed_square=carried(places.observed_square)[:, 0],
            weight=carried(places.weight)[:, 0],
            count=carried(places.count)[:, 0],
            sliding=carried(places.sliding)[:, 0],
            meat=np.zeros((size, size), dtype),
        )
        return jax.tree.map(lambda leaf: np.full_like(leaf, np.nan), sums) if self._spoilt else sums


def _regressors(outputs: np.ndarray, place: slice, size: int) -> np.ndarray:
    """F[φ] of one output, shape (…, np); of a model without parameters in it all are the same."""
    phi = outputs[..., place][..., :size]
    return np.broadcast_to(phi, (*phi.shape[:-1], size))


def _trace(
    signals: Float[np.ndarray, "records S columns"], places: list[slice], size: int
) -> Trace:
    """What each step puts out, part by part."""
    ny = len(places) // 3
    phi = [_regressors(signals, place, size) for place in places[2 * ny :]]
    # Views, but for the regressors of several outputs.
    return Trace(
        signals[..., :ny], signals[..., ny : 2 * ny],
        phi[0][:, :, None] if ny == 1 else np.stack(phi, axis=2),
    )  # fmt: skip


def _lane(observer: AbstractObserver, theta: Theta, outputs: int, dtype: Any) -> Lanes:
    """The only one; it has neither Δθ nor weights of outputs, which only scores ask for."""
    gains = jax.tree.map(lambda leaf: np.asarray(leaf, dtype)[None], observer)
    numbers_of_lane = theta, np.zeros_like(theta), np.ones(outputs)
    return Lanes(gains, *(np.asarray(leaf, dtype)[None] for leaf in numbers_of_lane))


def _counted(steps: Steps, dtype: Any) -> np.ndarray:
    """Rows of a record up to the last one that counts."""
    counts = np.any((np.asarray(steps.use) > 0) & (np.asarray(steps.score) > 0), axis=1)
    last = np.flatnonzero(counts)[-1:] + 1
    return rows_of(steps, dtype)[: last[0] if len(last) else 1]
