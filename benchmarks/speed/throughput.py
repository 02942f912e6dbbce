"""Lane-steps per second of a pass on a CPU, beside C and what else one might write.

The pendulum with four parameters, second-order observer and filter, as a sweep over gains runs
it: thousands of lanes over one record. Rivals: C and a loop for Numba, both written by hand for
this very plant (`throughput_rivals.py`); the library's own kernel under a plain `jit(vmap(scan))`,
in a process of its own without the library's option for XLA; its scan engine; a loop in NumPy.
All use all cores and are timed in turn, again and again; a ratio is the median over the rounds.

    python benchmarks/speed/throughput.py --write           # the table, and results/throughput.md
    python benchmarks/speed/throughput.py --quick --json    # under a minute; one JSON object
"""

import argparse
import contextlib
import io
import json
import os
import pickle
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import eoi_jax as eoi
from eoi_jax.estimation.engines import Lanes, Native, Scan
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.observers import SecondOrder
from eoi_jax.estimation.preparation import prepare_steps, step_inputs
from eoi_jax.models.library import pendulum

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from benchmarks import common
from benchmarks.speed import throughput_rivals as rivals

PERIOD, CUTOFF = 1e-3, 20.0
CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
FEW = 64  # the lanes of a small sweep
OURS, PLAIN, C = "Native", "plain jit(vmap(scan))", "C"


def main(words: list[str] | None = None) -> dict[str, Any]:
    """Measure, print, and write if asked; returns what `--json` prints."""
    options = arguments(words)
    if options.plain:
        plain_worker(options.plain)
        return {}
    eoi.configure()
    jax.config.update("jax_num_cpu_devices", CORES)
    printed = io.StringIO() if options.json else sys.stdout
    with contextlib.redirect_stdout(printed):
        found = measured(options)
    if options.json:
        print(json.dumps(found))
    return found


def arguments(words: list[str] | None) -> argparse.Namespace:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--quick", action="store_true", help="a quarter of the record, float32 only"
    )
    parser.add_argument("--write", action="store_true", help="update the files in results/")
    parser.add_argument("--json", action="store_true", help="print one JSON object, nothing else")
    parser.add_argument("--lanes", type=int, default=4096, help="a multiple of 64")
    parser.add_argument("--steps", type=int, help="of the record; 20 000 if left out")
    parser.add_argument("--rounds", type=int, help="5 if left out")
    parser.add_argument("--plain", help=argparse.SUPPRESS)
    return parser.parse_args(words)


def measured(options: argparse.Namespace) -> dict[str, Any]:
    """All tables, and their numbers by name; of single precision at the top."""
    steps = options.steps or (5000 if options.quick else 20_000)
    rounds = options.rounds or (3 if options.quick else 5)
    report = common.Report("Throughput of a pass on the CPU")
    if not rivals.C.available():
        report.add("There is no gcc here: C is left out.")
    found: dict[str, Any] = {"cores": CORES}
    for dtype in (np.float32,) if options.quick else (np.float32, np.float64):
        kind = np.dtype(dtype).name
        problem = Case(dtype, options.lanes, steps)
        part = compared(problem, rounds, report)
        found |= part if dtype == np.float32 else {kind: part}
    found["float32_error"] = precision(options.lanes, steps, report)
    report.close(__file__, options.write)
    if options.write:
        path = common.results(__file__) / "throughput.json"
        path.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return found


class Case:
    """The pendulum's nominal model on a record of the true one, gains spread over the lanes."""

    def __init__(self, dtype: Any, lanes: int, steps: int):
        self.dtype, self.count = np.dtype(dtype), lanes
        time_ = PERIOD * np.arange(max(steps, 20_000) + 1)
        u = eoi.excitation.multisine(time_, 0.6, (0.2, 3.0), 12, seed=1)
        record = eoi.simulate(pendulum(true=True), time_, u)
        lowpass = LowPass(CUTOFF)
        inputs = [step_inputs(record, False)]
        batch: Any = prepare_steps(
            pendulum(), [record], inputs, 2, 0.5, lowpass.memory, [np.zeros(1)], False, 0.05
        )
        whole = jax.tree.map(lambda leaf: np.asarray(leaf[0]), batch)
        self.steps: Any = jax.tree.map(lambda leaf: leaf[:steps] if leaf.ndim else leaf, whole)
        self.lowpass = lowpass.discretise(PERIOD)
        self.plant = pendulum()

    def lanes(self, count: int) -> Lanes:
        """Gain sets."""
        spread = np.linspace(0.8, 1.2, count)
        c1, c2, c3 = ((level * spread).astype(self.dtype) for level in (200.0, 2e4, 2000.0))
        theta = np.tile(self.plant.theta, (count, 1)).astype(self.dtype)
        ones = np.ones((count, 1), self.dtype)
        return Lanes(SecondOrder(c1, c2, c3), theta, np.zeros_like(theta), ones)

    def problem(self, count: int) -> rivals.Problem:
        """The same for the rivals."""
        lanes, real = self.lanes(count), self.dtype
        observer: Any = lanes.observer
        arrays: Any = {
            "transition": self.lowpass.transition,
            "entry": self.lowpass.entry,
            "y": np.append(self.steps.y[:, 0], self.steps.y_next[-1, 0]),
            **{key: getattr(self.steps, key)[:, 0] for key in ("u", "use", "score")},
            **{key: getattr(observer, key) for key in ("c1", "c2", "c3")},
            "theta": np.asarray(lanes.theta).T,
        }
        arrays = {key: np.ascontiguousarray(one, real) for key, one in arrays.items()}
        return rivals.Problem(h=PERIOD, restart=np.ascontiguousarray(self.steps.restart), **arrays)

    def engine(self, engine: Any, count: int, first: int | None = None) -> Callable[[], Any]:
        """One of the library's engines on this case, or on the first steps of it."""
        lanes = self.lanes(count)
        steps = jax.tree.map(lambda leaf: leaf[:first] if leaf.ndim else leaf, self.steps)

        def run() -> Any:
            with jax.enable_x64(self.dtype == np.float64):
                return engine.run(self.plant, lanes, self.lowpass, steps)

        return run


def compared(case: Case, rounds: int, report: common.Report) -> dict[str, Any]:
    """One table: every rival in turn, and what is asked of our engine."""
    steps, problem = len(case.steps.time), case.problem(case.count)
    few = min(steps, 500)
    with Plain(case, (case.count, FEW)) as plain:
        runs: dict[str, tuple[Callable, int, int]] = {
            OURS: (case.engine(Native(), case.count), case.count, steps),
            "Native, one core": (case.engine(Native(1), case.count), case.count, steps),
            "Numba": (rivals.Numba(problem, CORES), case.count, steps),
            PLAIN: (lambda: plain(case.count), case.count, steps),
            "Scan": (case.engine(Scan(), case.count), case.count, steps),
            "NumPy": (rivals.Loop(problem.first(few), CORES), case.count, few),
            f"{OURS}, {FEW} lanes": (case.engine(Native(), FEW), FEW, steps),
            f"{PLAIN}, {FEW} lanes": (lambda: plain(FEW), FEW, steps),
        }
        if rivals.C.available():
            runs = {C: (rivals.C(problem, CORES), case.count, steps), **runs}
        for name, (run, count, length) in runs.items():
            agree(name, run(), case.engine(Native(), count, length)(), case.dtype)
        times = in_turn(runs, rounds)
    found = summary(case, times, steps)
    rows = [
        [name, f"{np.median(times[name]):.3g}", *(f"{over(times, name, one):.3g}" for one in pair)]
        for name, pair in ((name, (OURS, C)) for name in runs)
    ]
    report.add(
        f"## {case.dtype.name}: {case.count} lanes, {steps} steps",
        common.table(["", "ns a lane and step", "times Native", "times C"], rows),
        f"Two cores over one: {found['speed_up_of_cores']:.3g} on {CORES}. The plain scan over "
        f"ours: {found['ratio_to_plain_vmap']:.3g}, at {FEW} lanes "
        f"{found['ratio_to_plain_vmap_64_lanes']:.3g}. NumPy ran {few} steps.",
    )
    return found


def in_turn(runs: dict[str, tuple[Callable, int, int]], rounds: int) -> dict[str, np.ndarray]:
    """Nanoseconds a lane and step of each, one after the other, `rounds` times."""
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(rounds):
        for name, (run, lanes, steps) in runs.items():
            start = time.perf_counter()
            shown = run()
            spent = shown if isinstance(shown, float) else time.perf_counter() - start
            times[name].append(1e9 * spent / (lanes * steps))
    return {name: np.array(each) for name, each in times.items()}


def over(times: dict[str, np.ndarray], one: str, other: str) -> float:
    """Median ratio of two that ran in the same rounds; NaN where one did not run."""
    if one not in times or other not in times:
        return float("nan")
    return float(np.median(times[one] / times[other]))


def summary(case: Case, times: dict[str, np.ndarray], steps: int) -> dict[str, Any]:
    """Numbers by name; null for what could not run."""
    few = f", {FEW} lanes"
    ratio_to_c = over(times, OURS, C)
    return {
        "dtype": case.dtype.name,
        "lanes": case.count,
        "steps": steps,
        "ns_per_lane_step": float(np.median(times[OURS])),
        "ratio_to_c": None if np.isnan(ratio_to_c) else ratio_to_c,
        "ratio_to_plain_vmap": over(times, PLAIN, OURS),
        "ratio_to_plain_vmap_64_lanes": over(times, PLAIN + few, OURS + few),
        "speed_up_of_cores": over(times, "Native, one core", OURS),
        "all_ns_per_lane_step": {name: float(np.median(each)) for name, each in times.items()},
    }


def as_rows(sums: Any) -> np.ndarray:
    """Sums of the library in the order of the rivals."""
    upper = np.triu_indices(4)
    parts = [sums.information[:, 0][:, *upper].T, sums.rhs[:, 0].T]
    return np.concatenate([*parts, *(one.T for one in (sums.square, sums.observed_square))])


def agree(name: str, sums: Any, ours: Any, dtype: np.dtype) -> None:
    """Whether a rival adds up the same, to rounding."""
    if isinstance(sums, float):  # the plain scan keeps its sums to itself
        return
    rows, expected = sums[:16] if isinstance(sums, np.ndarray) else as_rows(sums), as_rows(ours)
    size = np.max(np.abs(expected), axis=1, keepdims=True)
    worst = float(np.max(np.abs(rows - expected) / np.where(size > 0, size, 1.0)))
    # Second differences of y in single precision lose 2⁻²⁴ y/h² of an injection of order ten.
    if not worst < (2e-2 if dtype == np.float32 else 1e-8):
        raise SystemExit(f"{name} differs from the library by {worst:.1e}")


def precision(lanes: int, steps: int, report: common.Report) -> dict[str, float]:
    """How far single precision is from double, relative, the worst lane."""
    count = min(lanes, 256)
    single, double = (
        Case(dtype, count, steps).engine(Native(), count)() for dtype in (np.float32, np.float64)
    )
    size = np.max(np.abs(double.information), axis=(0, 1))
    found = {
        "index": float(np.max(np.abs(single.square / double.square - 1.0))),
        "information": float(np.max(np.abs(single.information - double.information) / size)),
    }
    report.add(
        f"float32 against float64, the worst of {count} lanes: index {found['index']:.1e}, "
        f"information matrix {found['information']:.1e} of its largest entries."
    )
    return found


# -- the plain scan, in a process of its own --------------------------------------------------


class Plain:
    """A process in which XLA runs as it comes; it times itself."""

    def __init__(self, case: Case, counts: tuple[int, ...]):
        lanes = [jax.tree.leaves(case.lanes(count)) for count in counts]
        with tempfile.NamedTemporaryFile(suffix=".pickle", delete=False) as file:
            pickle.dump((dict(vars(case.steps)), dict(vars(case.lowpass)), lanes), file)
        self._path = file.name
        environment = {key: value for key, value in os.environ.items() if key != "XLA_FLAGS"}
        environment["JAX_ENABLE_X64"] = str(int(case.dtype == np.float64))
        self._process = subprocess.Popen(
            [sys.executable, __file__, "--plain", self._path],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def __enter__(self) -> "Plain":
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()
        os.unlink(self._path)

    def __call__(self, lanes: int) -> float:
        """Seconds of one run."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(lanes, file=self._process.stdin, flush=True)
        return float(self._process.stdout.readline())


def plain_worker(path: str) -> None:
    """Read numbers of lanes, write seconds; the first time of each compiles."""
    from eoi_jax.estimation.kernel import Steps
    from eoi_jax.estimation.lowpass import DiscreteFilter

    with open(path, "rb") as file:
        steps, lowpass, leaves = pickle.load(file)
    real = jnp.result_type(float)

    def cast(tree: Any) -> Any:
        return jax.tree.map(
            lambda leaf: jnp.asarray(leaf, real if leaf.dtype.kind == "f" else None), tree
        )

    steps, lowpass, plant = cast(Steps(**steps)), cast(DiscreteFilter(**lowpass)), pendulum()
    like = Lanes(SecondOrder(1.0, 1.0, 1.0), *[np.ones((1, 1))] * 3)
    many = {len(one[0]): cast(jax.tree.unflatten(jax.tree.structure(like), one)) for one in leaves}
    run = jax.jit(jax.vmap(lambda lane: lane.kernel(plant, lowpass, "nothing").run(steps)[0]))
    for line in sys.stdin:
        start = time.perf_counter()
        jax.block_until_ready(run(many[int(line)]))
        print(time.perf_counter() - start, flush=True)


if __name__ == "__main__":
    main()
