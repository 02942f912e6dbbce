"""Effects that a model does not declare, named from a record: rates, errors, time, and a rival.

    python benchmarks/truth/undeclared_effects.py [--quick] [--write] [--plants mass tank]
        [--seeds FIRST COUNT] [--workers 2] [--cache FOLDER] [--resume] [--no-rival]

Cases come from `effect_cases`, whose simulator shares no code with the library. The rival,
`sindy_rival`, gets the same arrays. Every case is one line of JSON in
`results/undeclared_effects.jsonl` (with --write), from which the tables are made.
"""

import argparse
import json
import multiprocessing
import os
import sys
import tempfile
import warnings
import zlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks.common import ROOT, Report, _commit, results
from benchmarks.truth import effect_cases
from benchmarks.truth import undeclared_tables as tables
from benchmarks.truth.undeclared_tables import Answer, Row
from eoi_jax.models.library.level_tank import square_root

NOISES = (0.0, 1e-4, 1e-3, 1e-2, 5e-2)
LOOPS = ("open", "feedback")
SCORED = 50  # first sample of a free run that counts; those before start it
BATCH = 80  # cases simulated at once: as many lanes cost little more than few
GROUP = 20  # cases of one kind that a worker takes at once
CLEAN = 17  # seeds of cases without effect: 306 of them at noise ≤ 1e-3, on three plants


# -- the declared models ----------------------------------------------------------------------


def _mass(t: Any, x: Any, u: Any, p: Any) -> Any:
    del t
    return -p.k * x.y[0] - p.c * x.y[1] + p.b * u


def _mass_no_spring(t: Any, x: Any, u: Any, p: Any) -> Any:
    del t
    return -p.c * x.y[1] + p.b * u


def _mass_no_damper(t: Any, x: Any, u: Any, p: Any) -> Any:
    del t
    return -p.k * x.y[0] + p.b * u


def _pendulum(t: Any, x: Any, u: Any, p: Any) -> Any:
    del t
    return -p.a * jnp.sin(x.y[0]) - p.b * x.y[1] - p.c * jnp.sign(x.y[1]) + p.d * u


def _pendulum_frictionless(t: Any, x: Any, u: Any, p: Any) -> Any:
    del t
    return -p.a * jnp.sin(x.y[0]) - p.b * x.y[1] + p.d * u


def _pendulum_no_gravity(t: Any, x: Any, u: Any, p: Any) -> Any:
    del t
    return -p.b * x.y[1] - p.c * jnp.sign(x.y[1]) + p.d * u


def _tank(t: Any, x: Any, u: Any, p: Any) -> Any:
    del t
    return -p.alpha * square_root(x.y[0]) + p.beta * u


MODELS: dict[str, Callable[..., Any]] = {
    "mass": _mass,
    "mass_no_spring": _mass_no_spring,
    "mass_no_damper": _mass_no_damper,
    "pendulum": _pendulum,
    "pendulum_frictionless": _pendulum_frictionless,
    "pendulum_no_gravity": _pendulum_no_gravity,
    "tank": _tank,
}


def declared(case: effect_cases.Case) -> eoi.Plant:
    """The declared model at its wrong start; nothing else is told to the library."""
    degree = 1 if case.declared == "tank" else 2
    return eoi.Plant(MODELS[case.declared], case.start, degree, name=case.declared)


def records(case: effect_cases.Case) -> tuple[eoi.Record, eoi.Record]:
    """To estimate from, and held out. The simulator holds its inputs over each sample."""
    return (
        eoi.Record(case.time, case.inputs, case.outputs, "estimation", hold="zero"),
        eoi.Record(case.time, case.held_out_inputs, case.held_out_outputs, "held out", hold="zero"),
    )


# -- one case ---------------------------------------------------------------------------------


def ours(case: effect_cases.Case) -> Answer:
    """What `eoi.discover` says, all by default."""
    plant, (record, held_out) = declared(case), records(case)
    started = perf_counter()
    try:
        found = eoi.discover(plant, record, validation=held_out)
    except Exception as error:  # one bad case must not end the run; the report lists it
        return tables.failed(error, perf_counter() - started)
    seconds = perf_counter() - started
    return Answer(
        found.effects,
        tuple(dict.fromkeys(one.effect for one in found.ranking))[:3],
        found.status.code,
        found.ambiguous_with,
        _library_error(found.before, case),
        _library_error(found.after, case),
        seconds,
        tuple(
            (one.effect.name, one.probability) for one in found.added if one.probability is not None
        ),
    )


def _library_error(result: Any, case: effect_cases.Case) -> float:
    if result is None or not np.all(np.isfinite(result.rmse)):
        return float("inf")
    return _error(result.predictions[0].outputs[:, 0], case)


def _error(prediction: np.ndarray, case: effect_cases.Case) -> float:
    """Root mean square of a free run's error against the output without noise."""
    with np.errstate(all="ignore"):
        value = float(np.sqrt(np.mean((prediction - case.held_out_clean)[SCORED:] ** 2)))
    return value if np.isfinite(value) else float("inf")


def rival(case: effect_cases.Case) -> Answer:
    """What sparse regression says, set up by hand."""
    from benchmarks.truth import sindy_rival

    started = perf_counter()
    try:
        found = sindy_rival.discover(case)  # pyright: ignore[reportArgumentType] it only reads
        start = sindy_rival.start_of(case.time, case.held_out_outputs)
        runs = [
            sindy_rival.free_run(model, case.time, case.held_out_inputs, start)
            for model in (found.bare(), found)
        ]
    except Exception as error:
        return tables.failed(error, perf_counter() - started)
    status = "complete" if found.effects else "nothing_named"
    before, after = (_error(run, case) for run in runs)
    return Answer(found.effects, found.effects[:3], status, (), before, after, found.seconds)


def row(case: effect_cases.Case, key: "Key", first: bool, how: "How") -> Row:
    """Both answers to one case, beside the truth."""
    return Row(
        key.kind, key.plant, case.declared, case.truth, case.equivalent, case.loop, case.noise,
        case.seed, key.samples, case.strength, float(case.noise * np.std(case.held_out_clean)),
        how.commit, first, ours(case), rival(case) if how.rival else None,
    )  # fmt: skip


# -- which cases ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Key:
    """What determines a case."""

    kind: str
    plant: str
    truth: tuple[str, ...]
    loop: str
    noise: float
    seed: int
    samples: int

    def path(self, cache: Path) -> Path:
        """File of the simulated case; another simulator gets another folder."""
        digest = _simulator_digest()
        truth = "+".join(self.truth).replace(":", "_") or "none"
        name = f"{truth}-{self.loop}-{self.noise:g}-{self.seed}-{self.samples}.npz"
        return cache / digest / self.plant / name


@dataclass(frozen=True)
class Block:
    """Cases of one kind and plant: each truth, seed, loop and noise."""

    kind: str
    plant: str
    truths: tuple[tuple[str, ...], ...]
    seeds: tuple[int, ...]
    noises: tuple[float, ...] = NOISES
    loops: tuple[str, ...] = LOOPS
    samples: int = effect_cases.SAMPLES

    def listed(self) -> list[Key]:
        """In the order in which `effect_cases` makes them."""
        return [
            Key(self.kind, self.plant, truth, loop, noise, seed, self.samples)
            for truth in self.truths
            for seed in self.seeds
            for loop in self.loops
            for noise in self.noises
        ]

    def parts(self, size: int) -> list["Block"]:
        """Cut into blocks of about `size` cases, but no smaller than one truth and seed."""
        each = len(self.loops) * len(self.noises)
        seeds = _chunks(self.seeds, max(1, size // each))
        truths = max(1, size // (each * len(seeds[0])))
        return [
            replace(self, truths=some, seeds=part)
            for part in seeds
            for some in _chunks(self.truths, truths)
        ]


def _chunks(items: tuple, size: int) -> list[tuple]:
    return [items[first : first + size] for first in range(0, len(items), size)]


def full(plants: Sequence[str], first: int, count: int) -> list[Block]:
    """Every single effect, pair and outside effect; many cases without any."""
    blocks = []
    for plant in plants:
        seeds = tuple(range(first, first + count))
        none = tuple(range(first, first + CLEAN))
        blocks += [
            Block("none", plant, ((),), none),
            Block("single", plant, effect_cases.SINGLES[plant], seeds),
            Block("pair", plant, effect_cases.PAIRS[plant], seeds, (1e-3,)),
            Block("outside", plant, effect_cases.OUTSIDE[plant], seeds, (1e-3,)),
        ]
    return blocks


def quick(plants: Sequence[str], first: int) -> list[Block]:
    """A slice of about three minutes: a few of each kind, in open loop."""
    some: dict[str, tuple[str, ...]] = {
        "mass": ("coulomb_friction", "cubic_stiffness", "input_delay"),
        "pendulum": ("quadratic_drag", "constant_offset", "input_saturation"),
        "tank": ("leak", "actuator_lag"),
    }
    blocks = []
    for plant in plants:
        singles = tuple((name,) for name in some[plant])
        blocks += [
            Block("none", plant, ((),), (first, first + 1), (1e-3, 5e-2), ("open",)),
            Block("single", plant, singles, (first,), (1e-3, 1e-2), ("open",)),
            Block("pair", plant, effect_cases.PAIRS[plant][:1], (first,), (1e-3,), ("open",)),
            Block("outside", plant, effect_cases.OUTSIDE[plant][1:2], (first,), (1e-3,), ("open",)),
        ]
    return blocks


# -- simulated cases on disk ------------------------------------------------------------------

_SIGNALS = ("inputs", "outputs", "clean")
_ARRAYS = (*_SIGNALS, *(f"held_out_{name}" for name in _SIGNALS))


def _simulator_digest() -> str:
    sources = sorted(Path(__file__).parent.glob("effect_*.py"))
    return f"{zlib.crc32(b''.join(one.read_bytes() for one in sources)):08x}"


def simulate(block: Block, cache: Path) -> None:
    """Put the cases of a block on disk, unless they are there."""
    keys = block.listed()
    if all(key.path(cache).exists() for key in keys):
        return
    made = effect_cases.iterate(
        block.plant, block.truths, block.seeds, block.noises, block.loops, block.samples
    )
    for key, case in zip(keys, made, strict=True):
        assert (key.truth, key.loop, key.noise, key.seed) == (
            case.truth, case.loop, case.noise, case.seed,
        )  # fmt: skip
        store(case, key.path(cache))


def store(case: effect_cases.Case, path: Path) -> None:
    """One case as a file; complete or not there at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    values = {name: v for name, v in vars(case).items() if name not in (*_ARRAYS, "time")}
    part = path.with_suffix(f".{os.getpid()}")
    with part.open("wb") as file:
        arrays = {name: getattr(case, name) for name in _ARRAYS}
        np.savez(file, values=np.array(json.dumps(values)), **arrays)
    part.replace(path)


def load(path: Path) -> effect_cases.Case:
    """The case that `store` wrote."""
    with np.load(path) as file:
        arrays = {name: file[name] for name in _ARRAYS}
        values = json.loads(str(file["values"]))
    for name in ("truth", "equivalent", "strength"):
        values[name] = tuple(values[name])
    plant = effect_cases.DECLARED[values["declared"]][0]
    time = np.arange(len(arrays["inputs"])) * effect_cases.PERIOD[plant]
    return effect_cases.Case(time=time, **arrays, **values)


# -- the run ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class How:
    """What a worker is told beside the cases."""

    cache: Path
    commit: str
    rival: bool


_compiled: set[tuple[str, tuple[str, ...]]] = set()  # kinds that this process has seen


def measure(keys: Sequence[Key], how: How) -> list[Row]:
    """Both answers to some cases, in order; runs in a worker."""
    warnings.simplefilter("ignore")
    eoi.configure()
    rows = []
    for key in keys:
        case = load(key.path(how.cache))
        kind = (case.declared, case.truth)
        rows.append(row(case, key, kind not in _compiled, how))
        _compiled.add(kind)
    return rows


@contextmanager
def pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Worker processes of one thread each, replaced now and then."""
    one_thread = {
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "MKL_NUM_THREADS": "1",
        "NPROC": "1",  # read by XLA for the size of its thread pools
        "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false",
    }
    before = dict(os.environ)
    os.environ.update(one_thread)
    try:
        spawn = multiprocessing.get_context("spawn")  # JAX does not survive a fork
        with ProcessPoolExecutor(workers, spawn) as executor:
            yield executor
    finally:
        os.environ.clear()
        os.environ.update(before)


def run(blocks: Sequence[Block], path: Path, workers: int, how: How) -> tuple[float, float]:
    """Simulate and measure what the file of rows lacks.

    Args:
        blocks: which cases.
        path: JSON lines, appended to as groups are done.
        workers: processes.
        how: folder of simulated cases, and whether the rival answers too.

    Returns:
        Seconds of simulation and of measurement.
    """
    done = {_key(one) for one in tables.read(path)}
    wanted = [block for block in blocks if not done.issuperset(block.listed())]
    started = perf_counter()
    with pool(workers) as executor:
        parts = [part for block in wanted for part in block.parts(BATCH)]
        parts = [part for part in parts if not done.issuperset(part.listed())]
        for future in [executor.submit(simulate, part, how.cache) for part in parts]:
            future.result()
    simulated = perf_counter()
    print(f"Simulated in {simulated - started:.0f} s.", flush=True)
    with pool(workers) as executor:
        _collect([executor.submit(measure, keys, how) for keys in _groups(wanted, done)], path)
    return simulated - started, perf_counter() - simulated


def _groups(blocks: Sequence[Block], done: set[Key]) -> list[list[Key]]:
    """Cases of one plant and truth together, so that compiled kernels are used again."""
    groups = []
    for block in blocks:
        for truth in block.truths:
            keys = [key for key in replace(block, truths=(truth,)).listed() if key not in done]
            groups += [list(some) for some in _chunks(tuple(keys), GROUP)]
    return groups


def _collect(futures: Sequence[Future], path: Path) -> None:
    started, count = perf_counter(), 0
    path.parent.mkdir(parents=True, exist_ok=True)
    for place, future in enumerate(as_completed(futures), start=1):
        rows: list[Row] = future.result()
        with path.open("a", encoding="utf-8") as file:
            file.writelines(tables.line(one) + "\n" for one in rows)
        count += len(rows)
        right = sum(one.right(one.ours) for one in rows)
        label = f"{rows[0].declared} {'+'.join(rows[0].truth) or 'none'}: {right} of {len(rows)}"
        spent = f"{count} cases, {perf_counter() - started:.0f} s"
        print(f"{place}/{len(futures)} {label} ({spent})", flush=True)


def _key(one: Row) -> Key:
    return Key(one.kind, one.plant, one.truth, one.loop, one.noise, one.seed, one.samples)


def arguments(words: Sequence[str] | None = None) -> argparse.Namespace:
    """The options, checked."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a slice of about three minutes")
    parser.add_argument("--write", action="store_true", help="update the files in results/")
    parser.add_argument("--plants", nargs="+", choices=list(effect_cases.SINGLES),
                        default=list(effect_cases.SINGLES))  # fmt: skip
    parser.add_argument("--seeds", nargs=2, type=int, default=(1, 2), metavar=("FIRST", "COUNT"),
                        help=f"of effects; without any effect {CLEAN} from FIRST on")  # fmt: skip
    parser.add_argument("--workers", type=int, default=2, help="processes, one thread each")
    parser.add_argument("--cache", type=Path, help="folder to keep simulated cases in")
    parser.add_argument("--resume", action="store_true", help="skip cases that have their line")
    parser.add_argument("--no-rival", action="store_true", help="leave the rival out")
    options = parser.parse_args(words)
    if options.resume and not (options.write or options.cache):
        parser.error("--resume needs --write or --cache: else no file of cases is kept")
    if options.cache and options.cache.resolve().is_relative_to(ROOT):
        parser.error("--cache must lie outside the repository: it grows to gigabytes")
    return options


def main() -> None:
    """Simulate, measure, report."""
    options = arguments()
    eoi.configure()
    first, count = options.seeds
    blocks = quick(options.plants, first) if options.quick else full(options.plants, first, count)
    with tempfile.TemporaryDirectory() as temporary:
        cache = options.cache or Path(temporary)
        path = (results(__file__) if options.write else cache) / "undeclared_effects.jsonl"
        if not options.resume:
            path.unlink(missing_ok=True)
        report = Report("Effects that a model does not declare")
        times = run(blocks, path, options.workers, How(cache, _commit(), not options.no_rival))
        wanted = {key for block in blocks for key in block.listed()}
        rows = [one for one in tables.read(path) if _key(one) in wanted]
        report.add(*tables.sections(rows))
        report.add(
            f"Simulation {times[0]:.0f} s, discovery and rival {times[1]:.0f} s, on "
            f"{options.workers} processes of one thread each, in the last run."
        )
        if options.write:
            tables.figure(rows, results(__file__) / "undeclared_effects.png")
        report.close(__file__, options.write)


if __name__ == "__main__":
    main()
