"""How a sweep grows: time and peak memory against lanes and samples, each in a process of its own.

Pendulum of the paper with the gains of section 5.3.1 spread over two decades, one record, one pass
(a sweep adds one for the standard errors and one for the common index). Peak memory is the largest
resident set of the process, with Python, JAX and the libraries in it.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks import common
from eoi_jax.estimation.observers import SecondOrder, gains

LANES = [1, 10, 100, 1000, 10_000, 100_000, 1_000_000]
SAMPLES = [1_000, 10_000, 100_000, 1_000_000, 10_000_000]
FEW, SHORT = 64, 10_000  # lanes along samples, samples along lanes
LONGEST = 100_000_000
PERIOD = 1e-3


def main() -> None:
    if "--child" in sys.argv:
        child(json.loads(sys.argv[sys.argv.index("--child") + 1]))
        return
    options = common.arguments(__doc__)
    cut = slice(None, -2) if options.quick else slice(None)
    report = common.Report("Scaling of a sweep")
    curves = {}
    for precision in ("float64", "float32"):
        for axis, values in (("lanes", LANES[cut]), ("samples", SAMPLES[cut])):
            base = {"lanes": FEW, "samples": SHORT, "precision": precision}
            rows = [measured({**base, axis: value}) for value in values]
            curves[precision, axis] = (values, rows)
            report.add(f"## {precision}, against {axis}", rows_table(axis, values, rows))
    report.add("## Asked", asked(options.quick))
    if options.write:
        draw(curves).savefig(common.results(__file__) / "scaling.png", dpi=110)
    report.close(__file__, options.write)


def rows_table(axis: str, values: list[int], rows: list[dict[str, Any]]) -> str:
    return common.table(
        (axis, "first call [s]", "again [s]", "ns per lane, step and pass", "peak memory [MiB]"),
        [
            (f"{value:,}", f"{one['first']:.2f}", f"{one['again']:.3f}", f"{one['ns']:.2f}",
             f"{one['peak']:.0f}")
            for value, one in zip(values, rows, strict=True)
        ],
    )  # fmt: skip


def asked(quick: bool) -> str:
    """What the issue of the sweep asks for by name."""
    lanes, samples = (100_000, 10_000) if quick else (1_000_000, 100_000)
    long = LONGEST // 100 if quick else LONGEST
    sets = 400 if quick else 10_000
    once = {"precision": "float64", "once": True}
    big = measured({**once, "lanes": lanes, "samples": samples, "precision": "float32"})
    small, large = (
        measured({**once, "lanes": 8, "samples": n, "long": True}) for n in (long // 100, long)
    )
    case = {**once, "lanes": sets, "samples": 60_001, "records": 4, "passes": 5}
    whole = measured(case)
    growth = f"{small['peak']:.0f} → {large['peak']:.0f} MiB, {large['first']:.0f} s"
    rows = [
        (
            f"peak memory, {lanes:,} lanes × {samples:,} samples, float32",
            "< 2 GiB",
            f"{big['peak']:.0f} MiB, {big['first']:.0f} s",
        ),
        (f"peak memory, {long // 100:,} to {long:,} samples, 8 lanes", "< 200 MiB more", growth),
        (
            f"{sets:,} gain sets × 4 records × 5 passes, 60 s at 1 kHz",
            "< 180 s",
            f"{whole['first']:.0f} s, from the call to the dataset, compilation included",
        ),
    ]
    return common.table(("what", "asked", "measured"), rows)


def measured(case: dict[str, Any]) -> dict[str, Any]:
    """One case in a process of its own."""
    command = [sys.executable, __file__, "--child", json.dumps(case)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{case}: {done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def child(case: dict[str, Any]) -> None:
    eoi.configure()
    plant, passes = eoi.plants.pendulum(), case.get("passes", 1)
    sets = gains(
        SecondOrder, {"c1": 17.5, "c2": 57.25, "c3": np.geomspace(30.0, 3000.0, case["lanes"])}
    )
    with tempfile.TemporaryDirectory() as folder:
        count = case.get("records", 1)
        records = [record(case, Path(folder), seed) for seed in range(count)]

        def call() -> float:
            start = time.perf_counter()
            eoi.sweep(plant, records, sets, eoi.LowPass(20.0), passes=passes, substeps=1,
                      smoothing=False, precision=case["precision"])  # fmt: skip
            return time.perf_counter() - start

        first = call()
        again = first if case.get("once") or first > 60 else min(call() for _ in range(3))
    steps = (case["samples"] - 1) * count * (passes + 2)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    ns = 1e9 * again / steps / case["lanes"]
    print(json.dumps({"first": first, "again": again, "ns": ns, "peak": peak}))


def record(case: dict[str, Any], folder: Path, seed: int) -> Any:
    """A pendulum driven so that y is a sum of sines: exact at any length, nothing to simulate."""
    if not case.get("long"):
        t = PERIOD * np.arange(case["samples"])
        u, y = driven(t, seed)
        return eoi.Record(t, u, y, f"record {seed}", hold="smooth")
    maps = [
        np.lib.format.open_memmap(folder / f"{name}{seed}.npy", "w+", float, (case["samples"],))
        for name in "uy"
    ]
    step = 1_000_000
    for first in range(0, case["samples"], step):
        part = slice(first, min(first + step, case["samples"]))
        values = driven(PERIOD * np.arange(part.start, part.stop), seed)
        for name, value in zip("uy", values, strict=True):
            own = np.load(folder / f"{name}{seed}.npy", mmap_mode="r+")
            own[part] = value
    del maps
    u, y = (np.load(folder / f"{name}{seed}.npy", mmap_mode="r") for name in "uy")
    return eoi.LongRecord(PERIOD, u, y, hold="smooth")


def driven(t: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """u = (ÿ + a sin y + b ẏ + c sign ẏ)/d of the paper's true pendulum, y three sines."""
    rng = np.random.default_rng(seed)
    sines = [(0.6, 2.0), (0.4, 5.0), (0.1, 9.0)]
    waves = [(one, rng.uniform(0, 2 * np.pi)) for one in sines]
    y, rate, acceleration = (
        sum(a * w**k * np.sin(w * t + p + k * np.pi / 2) for (a, w), p in waves) for k in range(3)
    )
    u = (acceleration + 81.0 * np.sin(y) + 1.7 * rate + 0.3 * np.sign(rate)) / 99.0
    return u, np.asarray(y)


def draw(curves: dict) -> Any:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4), layout="constrained")
    panels = figure.subplots(1, 4)
    colours = {"float64": "#0072B2", "float32": "#D55E00"}
    for (precision, axis), (values, rows) in curves.items():
        left = 0 if axis == "lanes" else 2
        for panel, key, label in ((left, "again", "time [s]"), (left + 1, "peak", "memory [MiB]")):
            axes = panels[panel]
            axes.plot(values, [one[key] for one in rows], "o-", ms=4, label=precision,
                      color=colours[precision])  # fmt: skip
            axes.set(xscale="log", xlabel=axis, title=label)
            axes.set_yscale("log")
            axes.grid(alpha=0.3)
            axes.legend()
    return figure


if __name__ == "__main__":
    main()
