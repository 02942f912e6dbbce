"""Every method of `eoi_jax.compare`, and outside peers, on five plants at four levels of noise.

Records come from `independent.py`. A peer that is not installed is a row that says so.
"""

import sys
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import numpy as np

import eoi_jax as eoi
from benchmarks import common
from benchmarks.statistics import peers
from benchmarks.statistics.comparator_cases import Case, cases
from eoi_jax import comparators
from eoi_jax.report.comparison import worst_error

LEVELS = (0.0, 1e-4, 1e-3, 1e-2)  # standard deviation of the noise over rms(y), each output
SLOW_LEVEL = 1e-3  # at which peers that take tens of seconds run, and times are shown
EVALUATIONS = 50  # of jax-sysid


def methods(level: float, quick: bool) -> tuple[comparators.AbstractComparator, ...]:
    fast = (peers.Scipy(), peers.Casadi(), peers.PySindy())
    slow = (peers.JaxSysid(EVALUATIONS),) if level == SLOW_LEVEL and not quick else ()
    return (*comparators.standard(), *fast, *slow)


def compared(one: Case, levels: Sequence[float], quick: bool) -> dict[float, eoi.Comparison]:
    """A comparison at each level, all on the same drive and held-out record (without noise)."""
    held = one.record(2, 0.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # those of peers are not ours to mend
        return {
            level: eoi.compare(
                one.plant, one.record(1, level), held, one.truth.parameters, methods(level, quick)
            )
            for level in levels
        }


# -- what is shown ------------------------------------------------------------------------------


def rows(name: str, held: np.ndarray, found: dict[float, eoi.Comparison]) -> list[list[str]]:
    """A row for each method of a plant."""
    last = found[max(found, key=lambda level: level == SLOW_LEVEL)]
    lines = []
    for entry in last.entries:
        shares = []
        for level in LEVELS:
            here = found.get(level)
            known = here is not None and entry.method in [one.method for one in here.entries]
            shares.append(share(here[entry.method]) if here is not None and known else "")
        error = np.max(entry.rmse / held)
        lines.append([
            name, entry.method, *shares,
            "-" if np.isnan(error) else "diverges" if np.isinf(error) else common.percent(error),
            "-" if np.isnan(entry.seconds) else f"{entry.seconds:.2g}",
            f"{entry.first_seconds:.2g}",
        ])  # fmt: skip
    return lines


def share(entry: Any) -> str:
    """The worst parameter error, or how it ended."""
    if entry.parameters is None:
        return entry.status.code
    mark = "" if entry.status.code == "converged" else "*"
    return common.percent(worst_error(entry)) + mark


def ends(found: dict[str, dict[float, eoi.Comparison]]) -> str:
    """Methods without an answer, or with a doubtful one: a sentence of the first, and where."""
    lines: dict[str, tuple[str, list[str]]] = {}
    for name, levels in found.items():
        for level, result in levels.items():
            for one in result.entries:
                if one.status.code != "converged":
                    key = f"{one.method}: {one.status.code}"
                    lines.setdefault(key, (one.status.message, []))[1].append(f"{name} {level:g}")
    return "\n".join(f"- {key}: {text} ({'; '.join(at)})" for key, (text, at) in lines.items())


def figure(found: dict[str, dict[float, eoi.Comparison]], path: Path) -> None:
    """Worst parameter error against noise, a panel for each plant."""
    from matplotlib.figure import Figure

    colours = ("#999999", "#0072B2", "#D55E00", "#E69F00", "#009E73", "#CC79A7", "#000000",
               "#56B4E9", "#8B5A2B", "#6A3D9A", "#F0C000")  # fmt: skip
    names = [one.name for one in methods(SLOW_LEVEL, False)]
    drawn = Figure(figsize=(12, 7), dpi=90, layout="constrained")
    grid = drawn.subplots(2, 3).ravel()
    for axes, (name, levels) in zip(grid, found.items(), strict=False):
        at = [level if level > 0 else 1e-5 for level in levels]
        for colour, method in zip(colours, names, strict=True):
            values = [
                next((100 * worst_error(e) for e in one.entries if e.method == method), np.nan)
                for one in levels.values()
            ]
            own = method in [one.name for one in comparators.standard()]
            style = "o-" if own else "s--"
            axes.loglog(at, values, style, color=colour, markersize=4, linewidth=1.2, label=method)
        axes.set_title(name, fontsize=11)
        axes.set_xticks([1e-5, 1e-4, 1e-3, 1e-2], ["0", "1e-4", "1e-3", "1e-2"])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
        axes.set_xlabel("noise / rms(y)")
        axes.set_ylabel("worst parameter error [%]")
    for axes in grid[len(found) :]:
        axes.axis("off")
    handles, labels = grid[0].get_legend_handles_labels()
    grid[-1].legend(handles, labels, loc="center", fontsize=10, title="dashed: outside peers")
    drawn.savefig(path)


def main() -> None:
    options = common.arguments(__doc__)
    chosen = cases()[:2] if options.quick else cases()
    levels = (0.0, SLOW_LEVEL) if options.quick else LEVELS
    report = common.Report("Comparators: five plants, four levels of noise")
    report.add(
        "Each method starts from the nominal values and gets one record (10 to 20 s, 5000 to "
        "15 000 samples, from `independent.py`) with white noise on every output, one seed a cell. "
        "*Error* is the worst of the plant's parameters, relative to the truth; `*`: it did not "
        "end as converged (sentences below). *Held-out*: rmse of the free run on a record "
        "with another input and no noise, over its spread, worst output, at noise 1e-3. Times at "
        f"noise 1e-3: a second call, and a first. jax_sysid: {EVALUATIONS} evaluations, at noise "
        "1e-3 alone, because it takes so long.",
    )
    found: dict[str, dict[float, eoi.Comparison]] = {}
    lines: list[list[str]] = []
    for one in chosen:
        found[one.plant.name] = compared(one, levels, options.quick)
        size = np.std(one.record(2, 0.0).outputs, axis=0)
        lines += rows(one.plant.name, size, found[one.plant.name])
        print(f"{one.plant.name} done", flush=True)
    errors = (f"error, noise {level:g}" for level in LEVELS)
    header = ("plant", "method", *errors, "held-out", "time [s]", "first [s]")
    report.add(common.table(header, lines), "Ends other than converged:", ends(found))
    if options.write:
        figure(found, common.results(__file__) / "comparators.png")
        report.add("![Worst parameter error against noise](comparators.png)")
    report.add(f"CPU time: {time.process_time():.0f} s.")
    report.close(__file__, options.write)


if __name__ == "__main__":
    main()
