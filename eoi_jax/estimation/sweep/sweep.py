r"""Many estimates in one call: gains × filters × starting points × records × resamples.

Each lane is what `identify` gives for its observer, filter, start and record by plain passes
(``instruments=False``): without instruments, which `identify` takes by itself on noisy records.
Lanes run in chunks: here, or on the workers of any `concurrent.futures.Executor`, and land in a
store from which an interrupted sweep goes on.
"""

import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import numpy as np

from eoi_jax._checks import check, is_whole
from eoi_jax.compiler.jax_setup import configure
from eoi_jax.estimation.engines import AbstractEngine, Automatic
from eoi_jax.estimation.sweep.chunk import Arrays, engines_used, precision_error, run_chunk
from eoi_jax.estimation.sweep.plan import Part, Plan, Settings, plan
from eoi_jax.estimation.sweep.source import Choices
from eoi_jax.estimation.sweep.store import Labels, Store
from eoi_jax.models.plant import Plant

_AHEAD = 64  # chunks that an executor is given ahead of those that have landed
_TRIES = 3  # of a chunk whose worker failed
_CALIBRATED = 16  # gain sets that tell the error of single precision

Place = tuple[int, ...]


def sweep(
    plant: Plant,
    records: Any,
    observers: Any = None,
    lowpass: Any = None,
    *,
    starts: Any = None,
    resamples: int = 0,
    passes: int = 10,
    transient: float | None = None,
    substeps: int | None = None,
    smoothing: float | bool | None = None,
    precision: str = "float64",
    seed: int = 0,
    chunk: int = 4096,
    store: str | Path | None = None,
    engine: AbstractEngine | None = None,
    executor: Executor | None = None,
    part: tuple[int, int] = (0, 1),
    progress: bool = False,
) -> Any:
    """Identify with every combination of gains, filters, starts, records and resamples.

    By plain passes, as ``identify(…, instruments=False)`` does: what noise does to least squares it
    does to every lane.

    Args:
        plant: the model with its nominal parameters.
        records: one, several, or ``{label: records}``; a list in place of a record is estimated
            from jointly, a `LongRecord` piece by piece.
        observers: an observer, `observers.gains(…)`, or a sequence of either; left out: one,
            chosen for each record.
        lowpass: a filter or several; left out: chosen for each record.
        starts: θ_0: dicts of parameters, or rows (starts, np); left out: the nominal values.
        resamples: block-bootstrap resamples, along ``resample`` beside the data as they are (0).
        passes: how many at most.
        transient: time at the start of each record that is not scored [s].
        substeps: as of `identify`.
        smoothing: as of `identify` [rad/s].
        precision: of the loop, ``"float64"`` or ``"float32"``; attributes ``float32_error_of_…``
            then tell what that costs, against double precision on some of the lanes.
        seed: of the resamples.
        chunk: lanes at a time, at most.
        store: folder of a Zarr store that keeps each chunk once it is done; a sweep that was
            interrupted goes on from there. In memory if left out.
        engine: that runs the passes, of `eoi_jax.engines`; left out: the fastest at hand.
        executor: workers for the chunks, e.g. ``client.get_executor()`` of Dask.
        part: ``(i, n)``: only every n-th chunk from the i-th, for an array of n jobs, one store.
        progress: show a bar with rate and time left on a terminal.

    Returns:
        A dataset over (record, lowpass, observer, start, resample): ``parameters``,
        ``standard_error`` (from ``blocks`` of scores, rougher than that of `identify`; NaN on a
        bound), ``index``
        of each pass, ``common_index``, ``sliding_fraction``, ``status`` (`flag_meanings` says
        which), ``ok``; attributes ``engine`` and ``engine_reason`` say which engine ran in this
        call, and why where it is not the fast one. A lane that goes wrong ends with its status, the
        others do not notice. After Ctrl-C: what is done, the rest ``not_run``.

    Raises:
        ValueError: what does not fit, before any work; the message says what to do.
        OSError: the store cannot be written.

    Warns:
        StoreWarning: a part of the store was damaged, and is computed again.
    """
    good = isinstance(part, Sequence) and len(part) == 2 and all(is_whole(one) for one in part)
    check(good and 0 <= part[0] < part[1], "part", "must be (i, n) with 0 ≤ i < n", part)
    choices = Choices(None, transient, substeps, smoothing)
    settings = Settings(resamples, passes, precision, seed, chunk)
    whole = plan(plant, records, observers, lowpass, starts, choices, settings)
    double = _double()
    check(
        precision == "float32" or double,
        "precision",
        "must be float32 where JAX runs in single precision",
        precision,
        "Call `eoi_jax.configure()` first, or ask for float32.",
    )
    engine = engine or Automatic()
    target = Store(whole, store, _labels(whole))
    own = [place for i, place in enumerate(whole.chunks()) if i % part[1] == part[0]]
    left = target.unfinished(own)
    finished = True
    with _shown(progress, whole, own, left) as done:
        try:
            for place, arrays in _results(whole, left, engine, executor):
                if arrays is None:
                    target.mark_lost(place)
                else:
                    target.write(place, arrays)
                done(place)
        except KeyboardInterrupt:
            finished = False
    outcome = {"finished": int(finished), **_engines(whole, own, left, engine)}
    if precision == "float32" and double and finished and own:
        errors = precision_error(whole.only(own[0]), engine, _CALIBRATED)
        outcome |= {f"float32_error_of_{name}": value for name, value in errors.items()}
    return target.dataset(outcome)


def _engines(
    whole: Plan, own: list[Place], left: list[Place], engine: AbstractEngine
) -> dict[str, str]:
    """Names of the engines that lanes ran on, and why where that is not the fast one."""
    used = engines_used(whole.only(left[0]), engine) if left else []
    names = dict.fromkeys(one.name for one in used)
    reasons = dict.fromkeys(one.reason for one in used if one.reason)
    found = len(own) - len(left)
    if found:
        reasons[f"{found} of {len(own)} chunks were in the store, their engine is not recorded"] = (
            None
        )
    return {"engine": ", ".join(names) or "none", "engine_reason": "; ".join(reasons)}


def _double() -> bool:
    """Whether JAX runs in double precision."""
    return bool(jax.dtypes.canonicalize_dtype(float) == np.float64)


def _results(
    whole: Plan, places: list[Place], engine: AbstractEngine, executor: Executor | None
) -> Iterator[tuple[Place, Arrays | None]]:
    if executor is None:
        for place in places:
            yield place, run_chunk(whole.only(place), engine)
        return
    yield from _spread(whole, places, engine, executor)


def _spread(
    whole: Plan, places: list[Place], engine: AbstractEngine, executor: Executor
) -> Iterator[tuple[Place, Arrays | None]]:
    """Chunks on an executor's workers, as they come; None for one that failed again and again."""
    waiting = deque((place, _TRIES) for place in places)
    running: dict[Future, tuple[Place, int]] = {}
    double = _double()
    try:
        while waiting or running:
            while waiting and len(running) < _AHEAD:
                place, tries = waiting.popleft()
                future = executor.submit(remote_chunk, whole.only(place), engine, double)
                running[future] = (place, tries)
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                place, tries = running.pop(future)
                try:
                    yield place, future.result()
                except (ValueError, TypeError):
                    raise
                except Exception as error:
                    warnings.warn(f"chunk {place} failed on its worker: {error}", stacklevel=4)
                    if tries > 1:
                        waiting.append((place, tries - 1))
                    else:
                        yield place, None
    finally:
        for future in running:
            future.cancel()


def remote_chunk(one: Part, engine: AbstractEngine, double: bool) -> Arrays:
    """`run_chunk` in a worker process, which sets up JAX first as the caller's is."""
    if _double() != double:
        configure(float64=double)
    return run_chunk(one, engine)


def _labels(whole: Plan) -> Labels:
    plant = whole.plant
    texts = {
        "record": ("record", [one.name for one in whole.groups]),
        "data_hash": ("record", [one.data_hash for one in whole.groups]),
        "parameter": ("parameter", list(plant.names)),
        "output": ("output", list(plant.outputs)),
    }
    numbers = {
        "pass": (("pass",), np.arange(1, whole.settings.passes + 1)),
        "lowpass": (("lowpass",), np.arange(len(whole.choices))),
        "observer": (("observer",), np.arange(whole.shape[2])),
        "start": (("start",), np.arange(len(whole.starts))),
        "resample": (("resample",), np.arange(1 + whole.settings.resamples)),
        "theta_0": (("start", "parameter"), whole.starts),
        **_filters(whole),
        **_gains(whole),
    }
    attributes = {
        "plant": plant.name,
        "precision": whole.settings.precision,
        "seed": whole.settings.seed,
        "common_index": "under the observer and the filter that would be chosen for the record",
    }
    kinds = [one.kind for one in whole.observers or ()]
    return Labels(texts, numbers, kinds, attributes)


def _filters(whole: Plan) -> dict[str, Any]:
    given = [one.lowpass for one in whole.choices]
    known = [one for one in given if one is not None]
    if len(known) < len(given):
        return {}
    return {
        "cutoff": (("lowpass",), np.asarray([one.cutoff for one in known])),
        "order": (("lowpass",), np.asarray([one.order for one in known])),
    }


def _gains(whole: Plan) -> dict[str, Any]:
    """Every gain along ``observer``; NaN for observers that have no such gain."""
    groups = whole.observers or ()
    labels: dict[str, Any] = {}
    if groups:
        counts = [len(one) for one in groups]
        labels["kind"] = (("observer",), np.repeat(np.arange(len(groups)), counts))
    for name in dict.fromkeys(name for one in groups for name in one.labels):
        parts = [one.labels.get(name, np.full(len(one), np.nan)) for one in groups]
        if any(part.ndim > 1 for part in parts):
            wide = len(whole.plant.outputs)
            parts = [np.broadcast_to(p.reshape(len(p), -1), (len(p), wide)) for p in parts]
        values = np.concatenate(parts)
        labels[name] = (("observer", "output")[: values.ndim], values)
    return labels


@contextmanager
def _shown(
    progress: bool, whole: Plan, own: Iterable[Place], left: list[Place]
) -> Iterator[Callable[[Place], None]]:
    """A function that is told of each chunk that landed."""
    if not progress:
        yield lambda _: None
        return
    from rich.console import Console  # only where there is a terminal to draw on
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    def lanes(place: Place) -> int:
        return int(np.prod([one.stop - one.start for one in whole.region(place)]))

    total = sum(lanes(place) for place in own)
    start = total - sum(lanes(place) for place in left)
    columns = (
        TextColumn("sweep"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("lanes, {task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("sweep", total=total, completed=start, rate="compiling")

        def landed(place: Place) -> None:
            bar.advance(task, lanes(place))
            speed = bar.tasks[0].speed
            bar.update(task, rate=f"{speed:,.0f} a second" if speed else "")

        yield landed
