"""Every method of `eoi_jax.compare`, and outside peers, on five plants at four levels of noise.

Records come from `independent.py`. A peer that is not installed is a row that says so.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import common
import independent
import numpy as np
import peers

import eoi_jax as eoi
from eoi_jax import comparators
from eoi_jax.data import excitation
from eoi_jax.report.comparison import worst_error

LEVELS = (0.0, 1e-4, 1e-3, 1e-2)  # standard deviation of the noise over rms(y), each output
SLOW_LEVEL = 1e-3  # at which peers that take tens of seconds run, and times are shown
EVALUATIONS = 50  # of jax-sysid


@dataclass(frozen=True)
class Case:
    """A plant, what drives it, and its second simulator."""

    plant: eoi.Plant
    truth: eoi.Plant
    time: np.ndarray
    drive: Callable[[np.ndarray, int], np.ndarray]
    simulate: Callable[[np.ndarray], np.ndarray]

    def record(self, seed: int, level: float) -> eoi.Record:
        """The same drive for the same seed; white noise on every output."""
        u = self.drive(self.time, seed)
        y = self.simulate(u)
        sigma = level * np.sqrt(np.mean(y**2, axis=0))
        return eoi.Record(
            self.time, u, independent.with_sensor(y, sigma, 0.0, 100 + seed), f"seed {seed}",
            input_names=self.plant.inputs, output_names=self.plant.outputs, hold="zero",
        )  # fmt: skip


def case(
    plant: eoi.Plant,
    truth: eoi.Plant,
    period: float,
    samples: int,
    drive: Callable[[np.ndarray, int], np.ndarray],
    simulator: Callable[..., np.ndarray],
    **start: float,
) -> Case:
    time = period * np.arange(samples)
    p = truth.parameters
    return Case(plant, truth, time, drive, lambda u: simulator(p, time, u, "zero", **start))


def cases() -> tuple[Case, ...]:
    """The five plants, from the paper's nominal values (Duffing: the linear guess)."""
    make = eoi.plants
    return (
        case(
            make.level_tank(), make.level_tank(true=True), 2e-3, 10_000,
            lambda t, seed: 4.0 + excitation.multisine(t, 0.6, (0.05, 1.0), 12, seed),
            independent.level_tank, start=0.1,
        ),
        case(
            make.mass_spring_damper(), make.mass_spring_damper(true=True), 1e-3, 10_000,
            lambda t, seed: excitation.prbs(t, 1.0, 0.1, seed), independent.one_mass,
        ),
        case(
            make.three_mass_spring_damper(), make.three_mass_spring_damper(true=True), 1e-3, 10_000,
            lambda t, seed: excitation.prbs(t, 1.0, 0.05, seed), independent.three_masses,
        ),
        case(
            make.pendulum(), make.pendulum(true=True), 1e-3, 15_000,
            lambda t, seed: excitation.random_steps(t, -0.5, 0.5, 0.8, seed), independent.pendulum,
        ),
        case(
            make.duffing_oscillator(), make.duffing_oscillator(reference=True), 1 / 610.35, 5000,
            lambda t, seed: excitation.multisine(t, 0.05, (1.0, 150.0), 100, seed),
            independent.duffing,
        ),
    )  # fmt: skip


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
            "-" if np.isnan(error) else common.percent(error),
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
    """Sentences of the methods without an answer, or with a doubtful one."""
    lines: dict[str, list[str]] = {}
    for name, levels in found.items():
        for level, result in levels.items():
            for one in result.entries:
                if one.status.code != "converged":
                    text = f"{one.method}: {one.status}"
                    lines.setdefault(text, []).append(f"{name} {level:g}")
    return "\n".join(f"- {text} ({'; '.join(where)})" for text, where in lines.items())


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
    given = common.arguments(__doc__)
    chosen = cases()[:2] if given.quick else cases()
    levels = (0.0, SLOW_LEVEL) if given.quick else LEVELS
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
        found[one.plant.name] = compared(one, levels, given.quick)
        size = np.std(one.record(2, 0.0).outputs, axis=0)
        lines += rows(one.plant.name, size, found[one.plant.name])
        print(f"{one.plant.name} done", flush=True)
    errors = (f"error, noise {level:g}" for level in LEVELS)
    header = ("plant", "method", *errors, "held-out", "time [s]", "first [s]")
    report.add(common.table(header, lines), "Ends other than converged:", ends(found))
    if given.write:
        common.RESULTS.mkdir(exist_ok=True)
        figure(found, common.RESULTS / "comparators.png")
        report.add("![Worst parameter error against noise](comparators.png)")
    report.close("comparators", given.write)


if __name__ == "__main__":
    main()
