"""Undeclared effects in records as people log them, nothing said about how they were made.

    python benchmarks/truth/options_left_out.py [--quick] [--write] [--plants mass tank]
        [--seeds FIRST COUNT] [--troubles skew gap] [--workers 2] [--cache FOLDER]

The cases are those of `effect_cases` (masses, pendulums, tanks). No record says that its input was
held by a converter, and each has one of the troubles of `TROUBLES`, in turn. Held-out records have
the same trouble, at other places.
"""

import argparse
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from zlib import crc32

import numpy as np
from scipy.interpolate import CubicSpline

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks.common import Report, table
from benchmarks.truth import effect_cases
from benchmarks.truth.undeclared_effects import LOOPS, Block, Key, declared, load, pool, simulate

NOISES = (1e-3, 1e-2)
TROUBLES = ("none", "gap", "output gap", "two rates", "late output", "early output")
GAP = 0.02  # of the record, that is missing
SLOW = 3  # samples of the input to one of the output, where there are two rates
CLEAN = 25  # seeds of cases without an effect: 300 of them
GROUP = 12  # cases that a worker takes at once


# -- records ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Logged:
    """Arrays of one record, (N,) each; NaN where nothing was logged."""

    time: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray


def logged(
    case: effect_cases.Case, trouble: str, held_out: bool, rng: np.random.Generator
) -> Logged:
    """One record of a case with its trouble.

    Args:
        case: what was simulated.
        trouble: one of `TROUBLES`. With a late or early output the channels of the logger are half
            a sample apart.
        held_out: which of the two records.
        rng: for the place of a gap.
    """
    names = ("inputs", "outputs", "clean")
    signals = [getattr(case, f"held_out_{name}" if held_out else name) for name in names]
    inputs, outputs, clean = (signal.astype(float).copy() for signal in signals)
    n = len(inputs)
    if trouble in ("gap", "output gap"):
        first = int(rng.integers(n // 5, 4 * n // 5))
        outputs[first : first + int(GAP * n)] = np.nan
        if trouble == "gap":
            inputs[first : first + int(GAP * n)] = np.nan
    elif trouble == "two rates":
        outputs[np.arange(n) % SLOW != 0] = np.nan
    elif trouble in ("late output", "early output"):
        half = 0.5 if trouble == "early output" else -0.5
        index = np.arange(n)
        moved = CubicSpline(index, clean)(np.clip(index + half, 0, n - 1))
        outputs += moved - clean
    return Logged(case.time, inputs, outputs)


def trouble_of(key: Key) -> str:
    """The trouble of a case: all in turn, over seeds, loops and noises."""
    words = "/".join((key.plant, *key.truth))
    place = crc32(words.encode()) + 2 * len(NOISES) * key.seed
    place += len(NOISES) * LOOPS.index(key.loop) + NOISES.index(key.noise)
    return TROUBLES[place % len(TROUBLES)]


# -- one case ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Row:
    """The answer to one case."""

    key: Key
    trouble: str
    equivalent: tuple[str, ...]
    named: tuple[str, ...]
    status: str
    note: str
    seconds: float

    @property
    def right(self) -> bool:
        """Exactly what is hidden, or another exact description of it."""
        meant = [set(self.key.truth), *([set(self.equivalent)] if self.equivalent else [])]
        return not self.status.startswith("error") and set(self.named) in meant


def row(case: effect_cases.Case, key: Key) -> Row:
    """What `eoi.discover` says, all by default."""
    trouble, rng = trouble_of(key), np.random.default_rng([key.seed, 77])
    parts = [logged(case, trouble, held_out, rng) for held_out in (False, True)]
    started = perf_counter()
    try:
        record, held_out = (eoi.Record(part.time, part.inputs, part.outputs) for part in parts)
        answer = eoi.discover(declared(case), record, validation=held_out)
        result = answer.effects, answer.status.code, " ".join(answer.notes[:2])
    except Exception as error:  # one bad case must not end the run; the report lists it
        result = (), f"error: {type(error).__name__}", str(error)[:200]
    return Row(key, trouble, case.equivalent, *result, perf_counter() - started)


def measure(keys: Sequence[Key], cache: Path) -> list[Row]:
    """Answers to some cases; runs in a worker."""
    warnings.simplefilter("ignore")
    eoi.configure()
    return [row(load(key.path(cache)), key) for key in keys]


# -- the run ----------------------------------------------------------------------------------


def blocks(plants: Sequence[str], first: int, count: int, quick: bool) -> list[Block]:
    """Every single effect, and cases without any."""
    made = []
    for plant in plants:
        truths = effect_cases.SINGLES[plant][:: 7 if quick else 1]
        seeds, clean = tuple(range(first, first + count)), tuple(range(first, first + CLEAN))
        made += [
            Block("none", plant, ((),), clean[: 2 if quick else None], NOISES),
            Block("single", plant, truths, seeds, NOISES),
        ]
    return made


def run(wanted: Sequence[Block], cache: Path, workers: int, troubles: Sequence[str]) -> list[Row]:
    """Simulate and answer all cases."""
    with pool(workers) as executor:
        parts = [part for block in wanted for part in block.parts(60)]
        for future in [executor.submit(simulate, part, cache) for part in parts]:
            future.result()
    keys = [key for block in wanted for key in block.listed() if trouble_of(key) in troubles]
    groups = [keys[first : first + GROUP] for first in range(0, len(keys), GROUP)]
    rows: list[Row] = []
    with pool(workers) as executor:
        futures = [executor.submit(measure, group, cache) for group in groups]
        for future in as_completed(futures):
            rows += future.result()
            for one in future.result():
                if not one.right:
                    print(_miss(one), flush=True)
            print(f"{len(rows)} of {len(keys)}", flush=True)
    place = {key: i for i, key in enumerate(keys)}
    return sorted(rows, key=lambda one: place[one.key])


def _miss(one: Row) -> list[str]:
    return [
        one.key.plant, "+".join(one.key.truth) or "-", one.trouble, one.key.loop,
        f"{one.key.noise:g}", str(one.key.seed), "+".join(one.named) or "-", one.status,
        one.note[:100],
    ]  # fmt: skip


def _rate(rows: Sequence[Row]) -> str:
    right = sum(one.right for one in rows)
    return f"{right} of {len(rows)} ({100 * right / len(rows):.1f} %)" if rows else "–"


def sections(rows: Sequence[Row]) -> list[str]:
    """The tables."""
    single = [one for one in rows if one.key.truth]
    none = [one for one in rows if not one.key.truth]
    alarms = sum(bool(one.named) for one in none)
    targets = [
        [f"exact name, noise {noise:g}", asked, _rate([r for r in single if r.key.noise == noise])]
        for noise, asked in zip(NOISES, ("≥ 98 %", "≥ 97 %"), strict=True)
    ]
    if none:
        share = f"{alarms} of {len(none)} ({100 * alarms / len(none):.1f} %)"
        targets.append(["false alarms", "≤ 1 % of 300", share])
    by_trouble = [
        [
            trouble,
            *(
                _rate([r for r in single if (r.trouble, r.key.noise) == (trouble, noise)])
                for noise in NOISES
            ),
            _rate([r for r in none if r.trouble == trouble]),
        ]
        for trouble in TROUBLES
    ]
    seconds = np.array([one.seconds for one in rows])
    ends = ", ".join(
        f"{status}: {count}" for status, count in Counter(one.status for one in none).items()
    )
    spent = f"Nothing hidden ended as {ends}. Time a case: median {np.median(seconds):.1f} s, "
    spent += f"90 % below {np.quantile(seconds, 0.9):.1f} s."
    header = ["plant", "hidden", "trouble", "loop", "noise", "seed", "named", "ended as", "note"]
    return [
        table(["", "asked", "reached"], targets),
        table(["trouble", "noise 1e-3", "noise 1e-2", "nothing hidden"], by_trouble),
        spent,
        "## Misses",
        table(header, [_miss(one) for one in rows if not one.right]),
    ]


def main() -> None:
    """Simulate, measure, report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a slice")
    parser.add_argument("--write", action="store_true", help="update the file in results/")
    plants = list(effect_cases.SINGLES)
    parser.add_argument("--plants", nargs="+", choices=plants, default=plants)
    parser.add_argument("--troubles", nargs="+", choices=TROUBLES, default=TROUBLES)
    parser.add_argument("--seeds", nargs=2, type=int, default=(31, 2), metavar=("FIRST", "COUNT"))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--cache", type=Path, help="folder to keep simulated cases in")
    options = parser.parse_args()
    eoi.configure()
    report = Report("Undeclared effects, options left out")
    with tempfile.TemporaryDirectory() as temporary:
        cache = options.cache or Path(temporary)
        first, count = options.seeds
        wanted = blocks(options.plants, first, count, options.quick)
        rows = run(wanted, cache, options.workers, options.troubles)
    report.add(*sections(rows))
    report.close(__file__, options.write)


if __name__ == "__main__":
    main()
