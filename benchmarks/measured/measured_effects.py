"""Measured records: the effects that their declared models lack, named, and the error after.

    python benchmarks/measured/measured_effects.py [--quick] [--write]

The sets stand in `measured_cases.py`. Needs the folder of measured records (EOI_DATA, by default
../shared/data beside the repository); a set that is absent is skipped, and the report says so.
"""

import os
import subprocess
import sys
import tempfile
import time
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from jaxtyping import Float

import eoi_jax as eoi
from benchmarks.common import ROOT, Report, arguments, data_directory, percent, table
from benchmarks.measured.measured_cases import CASES, Case
from eoi_jax.simulation.validate import validate
from eoi_jax.simulation.validation import Validation

_QUICK = 6000  # samples of each record in a quick run


def main() -> None:
    """Every set that is there, then the timing of one."""
    options = arguments(__doc__)
    warnings.simplefilter("ignore", eoi.RecordWarning)  # gaps of the sensors: kept in the notes
    report = Report("Effects found in measured records")
    report.add(
        "Each set starts from the model that its source declares. Discovery sees the held-out "
        "records as `validation`: it refuses effects that make their free run worse, and fits "
        "nothing to them. Records called *untouched* it never sees. Free runs start from a state "
        "estimated over the first 50 samples, which are not scored; *windows* start anew at "
        "regular intervals."
    )
    results = []
    for name, make in CASES.items():
        report.add(f"## {name}")
        folder = data_directory() / name.split(",")[0]
        if not folder.is_dir():
            report.add(f"Skipped: {folder} is absent; set EOI_DATA to the folder of the records.")
            continue
        case = make(data_directory())
        result = discovered(_shortened(case) if options.quick else case)
        results.append((name, result))
        report.add(*_section(result))
    report.add("## All of them", _summary(results))
    if "emps" in dict(results):
        report.add("## Time", _timing())
    report.close(__file__, options.write)


# -- one set ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Result:
    """A discovery and how long it took."""

    case: Case
    discovery: "eoi.Discovery"
    seconds: float


def discovered(case: Case, refine: bool = False) -> Result:
    """Discover once, with windows of the case's length."""
    started = time.perf_counter()
    found = eoi.discover(
        case.plant,
        case.records,
        validation=case.held_out,
        lowpass=case.lowpass,
        window=case.window,
        refine=refine,
    )
    return Result(case, found, time.perf_counter() - started)


def _shortened(case: Case) -> Case:
    return replace(
        case,
        records=tuple(record[:_QUICK] for record in case.records[:2]),
        held_out=tuple(record[:_QUICK] for record in case.held_out[:2]),
        untouched={},
    )


def named(found: "eoi.Discovery") -> str:
    """The effects with the channel that each acts on."""
    if not found.added:
        return "none"
    several = len({one.output for one in found.added}) > 1 or len(found.plant.outputs) > 1
    return ", ".join(
        one.effect.name + (f" ({one.output})" if several else "") for one in found.added
    )


def against_source(undeclared: tuple[str, ...], effects: tuple[str, ...]) -> str:
    """What of the source's list was named, what was not, and what came beside it, in a sentence."""
    lists = [set(entry.split("|")) for entry in undeclared]
    hit = [entry for entry, own in zip(undeclared, lists, strict=True) if own & set(effects)]
    missed = [entry for entry in undeclared if entry not in hit]
    beside = sorted(set(effects) - set().union(*lists))
    parts = [
        f"{kind}: {', '.join(entry.replace('|', ' or ') for entry in entries)}"
        for kind, entries in (
            ("Named of the source's list", hit),
            ("not named", missed),
            ("named beside it", beside),
        )
        if entries
    ]
    return "; ".join(parts) + "."


def errors(case: Case, result: Validation | None, unit: bool = True) -> str:
    """Free-run rms in the case's unit; a run off by a hundred times the signal has diverged."""
    if result is None:
        return "none"
    shown = [
        f"{case.scale * rmse:.3g}" if nrmse < 100.0 else "diverges"
        for rmse, nrmse in zip(result.rmse, result.nrmse, strict=True)
    ]
    return ", ".join(shown) + (f" {case.unit}" if unit else "")


def _section(result: Result) -> list[str]:
    case, found = result.case, result.discovery
    rows = [
        [f"held out, {what}", errors(case, before), errors(case, after)]
        for what, before, after in (
            ("whole", found.before, found.after),
            (f"windows of {case.window:g} s", found.windows_before, found.windows_after),
        )
    ]
    plants = (found.declared.plant, found.plant)
    for name, record in case.untouched.items():
        rows.append(
            [f"untouched: {name}", *(errors(case, validate(plant, record)) for plant in plants)]
        )
    if "mass" in case.plant.names:  # emps
        for kind, records in (("estimation", case.records), ("held out", case.held_out)):
            for held, how in ((False, "the source's recipe"), (True, "force held over each step")):
                shares = [percent(force_error(plant, records[0], held)) for plant in plants]
                rows.append([f"relative force error, {kind}, {how}", *shares])
    return [
        f"Split: {case.split}. Options: {case.why}.",
        table(["free run, rms", "declared", "with the effects"], rows),
        f"Named: {named(found)}. {against_source(case.undeclared, found.effects)}",
        f"```\n{found}\n```",
        f"Time: {result.seconds:.1f} s.",
    ]


def _summary(results: list[tuple[str, Result]]) -> str:
    rows = []
    for name, one in results:
        found = one.discovery
        arrows = [
            f"{errors(one.case, before, unit=False)} → {errors(one.case, after)}"
            for before, after in (
                (found.before, found.after),
                (found.windows_before, found.windows_after),
            )
        ]
        rows.append(
            [
                name, found.status.code, named(found), ", ".join(found.ambiguous_with) or "-",
                percent(found.explained), *arrows, f"{one.seconds:.1f} s",
            ]
        )  # fmt: skip
    header = ["set", "status", "named", "ambiguous with", "explained",
              "held out, whole", "held out, windows", "time"]  # fmt: skip
    return table(header, rows)


# -- the force error of emps ------------------------------------------------------------------


def force_error(plant: eoi.Plant, record: eoi.Record, held: bool = False) -> float:
    """‖τ − τ̂‖/‖τ‖ of a plant driven by a force, by the recipe of the set's document.

    Position through a Butterworth filter of fourth order, 100 Hz, forward and backward; central
    differences; τ̂ is the force with which the model gives the measured acceleration; both
    decimated by ten. States of the plant's own run along the measured motion, from rest.

    Args:
        plant: with a parameter `mass` where the force acts through a state of its own.
        record: one force, one position.
        held: the controller holds each force until the next one, so that around a sample's
            instant one half of the force is the sample before; the recipe takes the sample
            alone, half a step too early.
    """
    from scipy.signal import butter, decimate, sosfiltfilt

    h, force = record.sample_period, record.inputs
    if held:
        force = 0.5 * (force + np.concatenate([force[:1], force[:-1]]))
    y = sosfiltfilt(butter(4, 2.0 * 100.0 * h, output="sos"), record.outputs[:, 0])
    rate = np.gradient(y, h)
    acceleration = np.gradient(rate, h)
    f, slope = _along(plant, record.time, np.stack([y, rate], axis=1)[:, :, None], force)
    keep = slice(50, -50)  # differences at the ends are one-sided
    missing = decimate(((acceleration - f) / slope)[keep], 10)
    return float(np.linalg.norm(missing) / np.linalg.norm(decimate(force[keep, 0], 10)))


def _along(
    plant: eoi.Plant,
    time: Float[np.ndarray, " time"],
    motion: Float[np.ndarray, "time r ny"],
    force: Float[np.ndarray, "time nu"],
) -> tuple[np.ndarray, np.ndarray]:
    """f of the one output and ∂f/∂u along a motion, each (N,)."""
    theta, h, fine = jnp.asarray(plant.theta), time[1] - time[0], 10

    def step(z: Any, now: Any) -> Any:
        t, y, u = now

        def derivative(u: Any) -> Any:
            return plant.derivative(t, eoi.State(y, z), u, theta)[0]

        f, slope = derivative(u), jax.grad(derivative)(u)
        for _ in range(fine):
            z = z + h / fine * plant.internal_rate(t, eoi.State(y, z), u, theta)
        return z, (f, slope[0])

    signals = (jnp.asarray(time), jnp.asarray(motion), jnp.asarray(force))
    along = jax.jit(lambda start: jax.lax.scan(step, start, signals)[1])
    f, slope = (np.asarray(one) for one in along(plant.internal_start(theta)))
    # Where the force acts through a state of the model's own, the declared mass gives the slope.
    return f, np.where(slope != 0.0, slope, 1.0 / plant.parameters["mass"])


# -- time -------------------------------------------------------------------------------------

_CHILD = """
import sys, time, warnings
sys.path.insert(0, {root!r})
import eoi_jax as eoi
eoi.configure()
warnings.simplefilter("ignore", eoi.RecordWarning)
from benchmarks.measured.measured_cases import CASES
from benchmarks.common import data_directory
for _ in range(2):
    started = time.time()
    case = CASES["emps"](data_directory())
    eoi.discover(case.plant, case.records, validation=case.held_out)
    print(started, time.time(), flush=True)
"""


def _timing() -> str:
    """Whole discovery on emps: from process start without and with compiled kernels; again."""
    rows = []
    with tempfile.TemporaryDirectory() as cache:
        for label in ("nothing compiled before", "kernels on disk from an earlier process"):
            start, second = process_times(Path(cache))
            rows.append([label, f"{start:.1f} s", f"{second:.1f} s"])
    header = ["kernels", "from process start to the answer", "second call in that process"]
    return table(header, rows) + "\n\nReading the files is included; asked: 20 s and 8 s."


def process_times(cache: Path) -> tuple[float, float]:
    """Seconds from process start to the first answer, and of the second call in it."""
    started = time.time()
    run = subprocess.run(
        [sys.executable, "-c", _CHILD.format(root=str(ROOT))],
        env={**os.environ, "EOI_CACHE": str(cache)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    first, second = (tuple(map(float, line.split())) for line in run.stdout.splitlines()[-2:])
    return first[1] - started, second[1] - second[0]


if __name__ == "__main__":
    main()
