"""The first discovery of a process: what it compiles, and its time over that of `import jax`.

`eoi discover` on its built-in example, from the start of the process to the report, cold (nothing
compiled on disk) and warm (what the process before it kept), by turns with `import jax`; medians.
Python's bytecode is there, as an installation leaves it, of this package as of JAX.

    python benchmarks/speed/first_discovery.py [--quick] [--write]
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from benchmarks.common import ROOT, Report, arguments, table

TURNS, QUICK_TURNS = 7, 2
DISCOVER = "from eoi_jax.cli.main import main; main()"
# What is compiled goes through these two functions; what the disk serves, through the first alone.
COUNTED = """
import atexit, os, sys
from jax._src import compiler

counts = {"asked": 0, "compiled": 0}

def count(name, key):
    whole = getattr(compiler, name)

    def counted(*args, **kwargs):
        counts[key] += 1
        return whole(*args, **kwargs)

    setattr(compiler, name, counted)

count("compile_or_get_cached", "asked")
count("backend_compile_and_load", "compiled")
from eoi_jax.compiler import jit

made = []
compile_loop = jit._compile
jit._compile = lambda *given: made.append(1) or compile_loop(*given)

def said():
    with open(os.environ["COUNTS"], "w") as file:
        file.write(f"{counts['asked']} {counts['compiled']} {len(made)}")

from eoi_jax.cli.main import main
try:
    main()
finally:
    said()
"""


@dataclass(frozen=True)
class Run:
    """One process: its wall time and its CPU time [s]."""

    wall: float
    processor: float


def process(
    code: str, words: list[str], folder: Path, bytecode: Path, settings: dict[str, str]
) -> Run:
    """Python with some code, in a folder of its own."""
    python = {"PYTHONPATH": str(ROOT), "PYTHONPYCACHEPREFIX": str(bytecode)}
    python["PYTHONDONTWRITEBYTECODE"] = ""
    environment = os.environ | python | {"JAX_PLATFORMS": "cpu"} | settings
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(
        [sys.executable, "-c", code, *words], cwd=folder, env=environment, check=True,
        stdout=subprocess.DEVNULL,
    )  # fmt: skip
    wall = time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = (after.ru_utime + after.ru_stime) - (before.ru_utime + before.ru_stime)
    return Run(wall, spent)


def discovery(code: str, cache: Path, bytecode: Path, counts: Path | None = None) -> Run:
    """`eoi discover` with a cache, and a file for what `COUNTED` counts."""
    settings = {"EOI_CACHE": str(cache), "COUNTS": str(counts)}
    with tempfile.TemporaryDirectory() as folder:
        return process(code, ["discover", "--quiet"], Path(folder), bytecode, settings)


def compilations(bytecode: Path) -> list[list[str]]:
    """Of a first process and of the next one, by the same cache; their bytecode stays."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        counts = Path(folder) / "counts"
        for name in ("first process", "next process"):
            discovery(COUNTED, Path(folder) / "cache", bytecode, counts)
            rows.append([name, *counts.read_text(encoding="utf-8").split()])
    return rows


def times(turns: int, bytecode: Path) -> dict[str, list[Run]]:
    """`import jax`, a cold and a warm discovery, by turns."""
    runs: dict[str, list[Run]] = {"import jax": [], "cold": [], "warm": []}
    for _ in range(turns):
        with tempfile.TemporaryDirectory() as folder:
            cache = Path(folder) / "cache"
            runs["import jax"].append(process("import jax", [], Path(folder), bytecode, {}))
            runs["cold"].append(discovery(DISCOVER, cache, bytecode))
            runs["warm"].append(discovery(DISCOVER, cache, bytecode))
    return runs


def main() -> None:
    options = arguments(__doc__)
    report = Report("The first discovery of a process")
    turns = QUICK_TURNS if options.quick else TURNS
    with tempfile.TemporaryDirectory() as folder:
        counted = compilations(Path(folder))
        runs = times(turns, Path(folder))
    report.add(
        "Programs of XLA that are asked for, those of them that the disk did not have, and loops "
        "compiled to machine code by LLVM.",
        table(["", "XLA asked", "XLA compiled", "LLVM compiled"], counted),
    )
    rows = []
    for name, several in runs.items():
        row = [name]
        for kind in ("wall", "processor"):
            own = np.array([getattr(one, kind) for one in several])
            base = np.array([getattr(one, kind) for one in runs["import jax"]])
            row += [f"{np.median(own):.2f} s", f"{np.median(own / base):.1f}"]
        rows.append(row)
    report.add(
        f"Medians of {turns} turns: from the start of the process to its end, and over "
        "`import jax` of the same turn.",
        table(["", "wall", "over import", "CPU", "over import"], rows),
    )
    report.close(__file__, options.write)


if __name__ == "__main__":
    main()
