r"""Many estimates in one call: gains × filters × starting points × records × resamples.

Each lane is one estimate: what `identify` gives for its observer, filter, start and record with
``instruments=False``. (By default `identify` adds instrumental variables on noisy records.) Lanes
run in chunks, in this process or on the workers of any `concurrent.futures.Executor`. Finished
chunks go to a store, from which an interrupted sweep resumes.
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

from eoi_jax._checks import check, counted, is_whole
from eoi_jax.compiler.jax_setup import configure
from eoi_jax.estimation.engines import AbstractEngine, Automatic
from eoi_jax.estimation.sweep.chunk import Arrays, engines_used, precision_error, run_chunk
from eoi_jax.estimation.sweep.plan import Part, Plan, Settings, make_plan
from eoi_jax.estimation.sweep.source import Choices
from eoi_jax.estimation.sweep.store import Labels, Store
from eoi_jax.models.plant import Plant

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

    Every lane is a plain estimate, as of ``identify(…, instruments=False)``: measurement noise
    biases it as it biases least squares.

    Args:
        plant: the model with its nominal parameters.
        records: one, several, or ``{label: records}``; a list in place of a record makes one joint
            estimate, a `LongRecord` is read piece by piece.
        observers: an observer, `observers.gains(…)`, or a sequence of either; default: one, chosen
            for each record.
        lowpass: a filter or several; default: chosen for each record.
        starts: θ_0: dicts of parameters, or rows (starts, np); default: the nominal values.
        resamples: block-bootstrap resamples, along ``resample`` after the data as measured (0).
        passes: largest number of iterations.
        transient: time at the start of each record that is not scored [s].
        substeps: as of `identify`.
        smoothing: as of `identify` [rad/s].
        precision: of the loop, ``"float64"`` or ``"float32"``; attributes ``float32_error_of_…``
            then give the error against double precision, measured on some of the lanes.
        seed: of the resamples.
        chunk: largest number of lanes that run at a time.
        store: folder of a Zarr store that keeps each finished chunk; an interrupted sweep resumes
            from it. Default: in memory.
        engine: that runs the passes, of `eoi_jax.engines`; default: the fastest available.
        executor: workers for the chunks, e.g. ``client.get_executor()`` of Dask.
        part: ``(i, n)``: only every n-th chunk from the i-th, for an array of n jobs, one store.
        progress: show a bar with rate and time left on a terminal.

    Returns:
        A dataset over (record, lowpass, observer, start, resample): ``parameters``,
        ``standard_error`` (from ``blocks`` of scores, rougher than that of `identify`; NaN on a
        bound), ``index`` of each iteration, ``common_index``, ``sliding_fraction``, ``status``
        (named by `flag_meanings`), ``ok``; attributes ``engine`` and ``engine_reason`` say which
        engine ran in this call, and why it was not the fastest. A lane that fails ends with its
        status and does not affect the others. After Ctrl-C the unfinished lanes are ``not_run``.

    Raises:
        ValueError: invalid arguments, before any work; the message says what to do.
        OSError: the store cannot be written.

    Warns:
        StoreWarning: a part of the store was damaged, and is computed again.
    """
    good = (
        isinstance(part, Sequence) and len(part) == 2 and all(is_whole(number) for number in part)
    )
    check(good and 0 <= part[0] < part[1], "part", "must be (i, n) with 0 ≤ i < n", part)
    choices = Choices(None, transient, substeps, smoothing)
    settings = Settings(resamples, passes, precision, seed, chunk)
    plan = make_plan(plant, records, observers, lowpass, starts, choices, settings)
    double = _double()
    check(
        precision == "float32" or double,
        "precision",
        "must be float32 where JAX runs in single precision",
        precision,
        "Call `eoi_jax.configure()` first, or ask for float32.",
    )
    engine = engine or Automatic()
    target = Store(plan, store, _labels(plan))
    places = [place for i, place in enumerate(plan.chunks()) if i % part[1] == part[0]]
    unfinished = target.unfinished(places)
    finished = True
    with _progress_bar(progress, plan, places, unfinished) as on_chunk:
        try:
            for place, arrays in _results(plan, unfinished, engine, executor):
                if arrays is None:
                    target.mark_lost(place)
                else:
                    target.write(place, arrays)
                on_chunk(place)
        except KeyboardInterrupt:
            finished = False
    outcome = {"finished": int(finished), **_engines(plan, places, unfinished, engine)}
    if precision == "float32" and double and finished and places:
        errors = precision_error(plan.part_at(places[0]), engine)
        outcome |= {f"float32_error_of_{name}": value for name, value in errors.items()}
    return target.dataset(outcome)


def _engines(
    plan: Plan, places: list[Place], unfinished: list[Place], engine: AbstractEngine
) -> dict[str, str]:
    """Names of the engines of the lanes, and why they are not the fastest."""
    used = engines_used(plan.part_at(unfinished[0]), engine) if unfinished else []
    engine_names = dict.fromkeys(engine_used.name for engine_used in used)
    reasons = dict.fromkeys(engine_used.reason for engine_used in used if engine_used.reason)
    stored_count = len(places) - len(unfinished)
    if stored_count:
        share = f"{stored_count} of {counted(len(places), 'chunk')}"
        reasons[f"{share} came from the store, where their engine is not recorded"] = None
    return {"engine": ", ".join(engine_names) or "none", "engine_reason": "; ".join(reasons)}


def _double() -> bool:
    """Whether JAX runs in double precision."""
    return bool(jax.dtypes.canonicalize_dtype(float) == np.float64)


def _results(
    plan: Plan, places: list[Place], engine: AbstractEngine, executor: Executor | None
) -> Iterator[tuple[Place, Arrays | None]]:
    if executor is None:
        for place in places:
            yield place, run_chunk(plan.part_at(place), engine)
        return
    yield from _spread(plan, places, engine, executor)


def _spread(
    plan: Plan,
    places: list[Place],
    engine: AbstractEngine,
    executor: Executor,
    max_queued: int = 64,
    max_tries: int = 3,
) -> Iterator[tuple[Place, Arrays | None]]:
    """Chunks from an executor's workers as they finish; None for a chunk that failed every time.

    At most `max_queued` are submitted at a time; one whose worker fails has `max_tries`.
    """
    waiting = deque((place, max_tries) for place in places)
    running: dict[Future, tuple[Place, int]] = {}
    double = _double()
    try:
        while waiting or running:
            while waiting and len(running) < max_queued:
                place, tries = waiting.popleft()
                future = executor.submit(remote_chunk, plan.part_at(place), engine, double)
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


def remote_chunk(part: Part, engine: AbstractEngine, double: bool) -> Arrays:
    """`run_chunk` in a worker process, with JAX set to the precision of the caller."""
    if _double() != double:
        configure(float64=double)
    return run_chunk(part, engine)


def _labels(plan: Plan) -> Labels:
    plant = plan.plant
    texts = {
        "record": ("record", [group.name for group in plan.groups]),
        "data_hash": ("record", [group.data_hash for group in plan.groups]),
        "parameter": ("parameter", list(plant.names)),
        "output": ("output", list(plant.outputs)),
    }
    numbers = {
        "pass": (("pass",), np.arange(1, plan.settings.passes + 1)),
        "lowpass": (("lowpass",), np.arange(len(plan.choices))),
        "observer": (("observer",), np.arange(plan.shape[2])),
        "start": (("start",), np.arange(len(plan.starts))),
        "resample": (("resample",), np.arange(1 + plan.settings.resamples)),
        "theta_0": (("start", "parameter"), plan.starts),
        **_filters(plan),
        **_gains(plan),
    }
    attributes = {
        "plant": plant.name,
        "precision": plan.settings.precision,
        "seed": plan.settings.seed,
        "common_index": "under the observer and the filter that would be chosen for the record",
    }
    kinds = [group.kind for group in plan.observers or ()]
    return Labels(texts, numbers, kinds, attributes)


def _filters(plan: Plan) -> dict[str, Any]:
    filters = [choice.lowpass for choice in plan.choices]
    chosen = [lowpass for lowpass in filters if lowpass is not None]
    if len(chosen) < len(filters):
        return {}
    return {
        "cutoff": (("lowpass",), np.asarray([lowpass.cutoff for lowpass in chosen])),
        "order": (("lowpass",), np.asarray([lowpass.order for lowpass in chosen])),
    }


def _gains(plan: Plan) -> dict[str, Any]:
    """Every gain along ``observer``; NaN for observers without that gain."""
    groups = plan.observers or ()
    labels: dict[str, Any] = {}
    if groups:
        counts = [len(group) for group in groups]
        labels["kind"] = (("observer",), np.repeat(np.arange(len(groups)), counts))
    for name in dict.fromkeys(name for group in groups for name in group.labels):
        parts = [group.labels.get(name, np.full(len(group), np.nan)) for group in groups]
        if any(part.ndim > 1 for part in parts):
            wide = len(plan.plant.outputs)
            parts = [np.broadcast_to(p.reshape(len(p), -1), (len(p), wide)) for p in parts]
        values = np.concatenate(parts)
        labels[name] = (("observer", "output")[: values.ndim], values)
    return labels


@contextmanager
def _progress_bar(
    progress: bool, plan: Plan, places: Iterable[Place], unfinished: list[Place]
) -> Iterator[Callable[[Place], None]]:
    """A function to call with each finished chunk, which advances a bar if `progress`."""
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
        return int(np.prod([span.stop - span.start for span in plan.region(place)]))

    total = sum(lanes(place) for place in places)
    start = total - sum(lanes(place) for place in unfinished)
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
