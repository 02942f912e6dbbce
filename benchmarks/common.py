"""What the benchmarks share: configs as cases, Markdown tables, and where a number was measured."""

import argparse
import os
import platform
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

import eoi_jax as eoi
from benchmarks import independent
from eoi_jax.cli import build
from eoi_jax.cli import config as configs

ROOT = Path(__file__).resolve().parents[1]


def arguments(description: str | None) -> argparse.Namespace:
    """`--quick` and `--write`; JAX is set up on the way."""
    parser = argparse.ArgumentParser(description=(description or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="shorter records, fewer cases")
    parser.add_argument("--write", action="store_true", help="update the result file")
    options = parser.parse_args()
    eoi.configure()
    return options


def data_directory() -> Path:
    """Folder of the measured records: $EOI_DATA, else beside the repository."""
    return Path(os.environ.get("EOI_DATA") or ROOT.parent / "shared" / "data")


# -- cases ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """A config made into what `identify` takes, with data from both simulators."""

    plant: eoi.Plant
    truth: dict[str, float]
    observer: eoi.observers.AbstractObserver | None
    lowpass: eoi.LowPass | None
    passes: int
    smoothing: float | bool | None
    record: eoi.Record  # independent.py
    library: eoi.Record  # the library's own simulator

    def identify(self, record: eoi.Record | None = None, **options) -> eoi.Identification:
        """The config's estimate as the paper has it, from the independent record by default."""
        settings = {
            "observer": self.observer,
            "lowpass": self.lowpass,
            "passes": self.passes,
            "smoothing": self.smoothing,
            "instruments": False,
            **options,
        }
        return eoi.identify(self.plant, record or self.record, **settings)

    def errors(self, result: eoi.Identification) -> dict[str, float]:
        """Error of each increment over the true increment."""
        start = self.plant.parameters
        return {
            key: (result.parameters[key] - self.truth[key]) / (self.truth[key] - start[key])
            for key in self.plant.names
        }

    def worst(self, result: eoi.Identification) -> float:
        """The largest of them, absolute."""
        return max(abs(value) for value in self.errors(result).values())


def case(name: str, sample_period: float | None = None, duration: float | None = None) -> Case:
    """The config of that name, on another grid if wanted."""
    config = configs.load(ROOT / "configs" / f"{name}.toml")
    table = config.simulate
    assert table is not None
    changes = {"sample_period": sample_period, "duration": duration}
    table = msgspec.structs.replace(
        table, **{key: value for key, value in changes.items() if value is not None}
    )
    config = msgspec.structs.replace(config, simulate=table)
    plant = build.plant(config, ROOT / "configs")
    library = build.records(config, plant, ROOT / "configs")[0]
    start = plant.parameters
    truth = {key: value + table.increments.get(key, 0.0) for key, value in start.items()}
    truth |= table.truth
    y = simulated(config.plant or "", truth, library, table.initial)
    noise, quantum = (
        np.array([level.get(key, 0.0) for key in plant.outputs])
        for level in (table.noise, table.quantisation)
    )
    if np.any(noise > 0):
        y = independent.with_sensor(y, noise, quantum, seed=1000 + table.seed)
    return Case(
        plant,
        truth,
        build.observer(config),
        build.lowpass(config),
        config.identify.passes,
        config.identify.smoothing,
        with_outputs(library, y),
        library,
    )


def explicit(observer: Any) -> eoi.observers.AbstractObserver:
    """The published form of an observer, with the same gains."""
    return type(observer)(**{**vars(observer), "scheme": "explicit"})


def simulated(kind: str, truth: dict[str, float], record: eoi.Record, initial: dict) -> np.ndarray:
    """Outputs (N, ny) of one of the paper's plants along the inputs of `record`."""
    arguments = (truth, record.time, record.inputs[:, 0], str(record.hold))
    if kind == "level_tank":
        return independent.level_tank(*arguments, start=float(initial["level"]))
    simulators: dict[str, Callable[..., np.ndarray]] = {
        "three_mass_spring_damper": independent.three_masses,
        "mass_spring_damper": independent.one_mass,
        "pendulum": independent.pendulum,
    }
    return simulators[kind](*arguments)


def with_outputs(record: eoi.Record, y: np.ndarray) -> eoi.Record:
    """The same record with other outputs."""
    return eoi.Record(
        record.time,
        record.inputs,
        y,
        f"{record.name}, independent",
        input_names=record.input_names,
        output_names=record.output_names,
        units=record.units,
        hold=record.hold,
    )


# -- text -------------------------------------------------------------------------------------


def table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A Markdown table with aligned columns."""
    cells = [[str(cell) for cell in row] for row in (header, *rows)]
    widths = [max(len(row[j]) for row in cells) for j in range(len(header))]
    lines = [
        "| " + " | ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) + " |"
        for row in cells
    ]
    lines.insert(1, "|" + "|".join("-" * (w + 2) for w in widths) + "|")
    return "\n".join(lines)


def percent(value: float) -> str:
    """A share in percent, three significant digits."""
    return f"{100 * value:.3g} %"


def provenance() -> str:
    """Machine, precision, date, commit and versions, as Markdown."""
    import jax

    packages = ", ".join(f"{name} {version(name)}" for name in ("jax", "equinox", "numpy", "scipy"))
    dtype = np.dtype(jax.numpy.result_type(float)).name
    now = datetime.now(UTC).strftime("%Y-%m-%d")
    return (
        f"Measured {now} at commit {_commit()} on {_processor()}, {os.cpu_count()} cores, "
        f"{dtype}; Python {platform.python_version()}, {packages}."
    )


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model\t")]
    return f"{names[0]} (model {models[0]})" if names and models else platform.machine()


def _commit() -> str:
    def git(*words: str) -> str:
        run = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
        return run.stdout.strip()

    try:
        sources = ("eoi_jax", "configs", "benchmarks/*.py")
        changed = git("status", "--porcelain", "--untracked-files=no", *sources)
        return git("rev-parse", "--short", "HEAD") + (" with local changes" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def results(script: str) -> Path:
    """Folder of results beside the script at this path."""
    folder = Path(script).resolve().parent / "results"
    folder.mkdir(exist_ok=True)
    return folder


class Report:
    """Sections as they come: printed at once, and written to the result file at the end."""

    def __init__(self, title: str):
        self.parts = [f"# {title}", provenance()]
        self.started = time.perf_counter()
        print("\n\n".join(self.parts), flush=True)

    def add(self, *parts: str) -> None:
        """One more paragraph, heading or table for each argument."""
        self.parts += parts
        print("\n" + "\n\n".join(parts), flush=True)

    def close(self, script: str, write: bool) -> None:
        """Say how long it took, and write the result file of the script at this path if asked."""
        self.add(f"Whole run: {time.perf_counter() - self.started:.0f} s.")
        if write:
            path = results(script) / f"{Path(script).stem}.md"
            path.write_text("\n\n".join(self.parts) + "\n", encoding="utf-8")
            print(f"\nWritten to {path.relative_to(ROOT)}")
