"""The paper's comparison on the one-mass plant (section 6), simulated, over many seeds of noise.

The rig is not at hand. `independent.py` simulates its model (21) with the paper's final parameters
as truth, driven as the paper says; every method then estimates from records with sensor noise.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import numpy as np

import eoi_jax as eoi
from benchmarks import common, independent
from eoi_jax import comparators
from eoi_jax.comparison.compare import common_index

PERIOD, DURATION, SAMPLE = 6.0, 12.0, 1e-3  # of the square wave, of an experiment, of the clock [s]
EXPERIMENTS = 6  # that the paper merges for the toolbox
LEVELS = (1e-3, 1e-2)  # standard deviation of the noise over rms(y)
SEEDS, MERGED_SEEDS = 100, 30  # of single records, and of six merged ones
PAPER = {
    "toolbox (tfest)": ((174.2, 12.570, 2.567), 0.0207),
    "VSS direct": ((161.2, 8.095, 2.281), 0.0245),
    "the paper's": ((140.903, 10.0086, 2.249), 0.0028),
}


@dataclass(frozen=True)
class Found:
    """One method over all seeds."""

    method: str
    records: int
    theta: np.ndarray
    index: np.ndarray
    seconds: float
    refused: int

    @property
    def seeds(self) -> int:
        return len(self.theta) + self.refused


def experiment(plant: eoi.Plant, y: np.ndarray, level: float, seed: int) -> eoi.Record:
    """One run of 1 kHz from rest, with white sensor noise."""
    sigma = level * float(np.sqrt(np.mean(y**2)))
    return eoi.Record(
        clock(), drive(), independent.with_sensor(y, sigma, 0.0, seed), f"seed {seed}",
        input_names=plant.inputs, output_names=plant.outputs, hold="zero",
    )  # fmt: skip


def clock() -> np.ndarray:
    return SAMPLE * np.arange(round(DURATION / SAMPLE))


def drive() -> np.ndarray:
    """1 V for half of the period, 0 V for the other."""
    return np.where(np.mod(clock(), PERIOD) < 0.5 * PERIOD, 1.0, 0.0)


def over_seeds(
    method: comparators.AbstractComparator,
    plant: eoi.Plant,
    batches: Sequence[Sequence[eoi.Record]],
    score,
) -> Found:
    """A method on every seed; the first call compiles and is not timed."""
    method.estimate(plant, batches[0])
    start = time.perf_counter()
    found = [method.estimate(plant, records) for records in batches]
    seconds = (time.perf_counter() - start) / len(batches)
    answers = [one.parameters for one in found if one.parameters is not None]
    theta = np.array([[one[name] for name in plant.names] for one in answers])
    index = np.array([score(one)[0] for one in answers])
    refused = len(found) - len(answers)
    return Found(method.name, len(batches[0]), theta, index, seconds, refused)


def level_table(plant: eoi.Plant, y: np.ndarray, level: float, seeds: int, merged: int) -> str:
    """Parameters and P of every method at one level of noise."""
    single = [[experiment(plant, y, level, seed)] for seed in range(seeds)]
    several = [
        [experiment(plant, y, level, 10_000 + EXPERIMENTS * seed + i) for i in range(EXPERIMENTS)]
        for seed in range(merged)
    ]
    score = common_index(plant, single[0][0]).score
    found = [over_seeds(method, plant, single, score) for method in comparators.standard()]
    found.append(over_seeds(comparators.OutputError(), plant, several, score))
    truth = np.asarray(eoi.plants.mass_spring_damper(true=True).theta)
    header = ("method", "records", "seeds", "α", "β", "ρ", "worst bias", "P", "time [s]")
    return common.table(header, [row(one, truth) for one in found])


def row(found: Found, truth: np.ndarray) -> tuple[str, ...]:
    name = found.method + (f" ({found.refused} without answer)" if found.refused else "")
    if not len(found.theta):
        return (name, str(found.records), str(found.seeds), *("-",) * 5, f"{found.seconds:.2g}")
    mean, spread = np.mean(found.theta, axis=0), np.std(found.theta, axis=0)
    bias = mean / truth - 1.0
    worst = int(np.argmax(np.abs(bias)))
    chance = spread[worst] / truth[worst] / np.sqrt(len(found.theta))
    return (
        name,
        str(found.records),
        str(found.seeds),
        *(f"{a:.6g} ± {b:.2g}" for a, b in zip(mean, spread, strict=True)),
        f"{common.percent(bias[worst])} ± {common.percent(chance)}",
        f"{np.mean(found.index):.3g}",
        f"{found.seconds:.2g}",
    )


def paper_indices(plant: eoi.Plant, y: np.ndarray) -> dict[str, tuple[float, ...]]:
    """P of the paper's three sets of parameters on our record, under three filters.

    The default one; 90 rad/s, which the paper uses elsewhere; the default one without noise.
    """
    record, clean = (experiment(plant, y, level, 0) for level in (LEVELS[0], 0.0))
    index, exact = common_index(plant, record).score, common_index(plant, clean).score
    found = {}
    for name, (theta, _) in PAPER.items():
        at = plant.with_parameters(np.asarray(theta))
        wide = eoi.identify(at, record, lowpass=eoi.LowPass(90.0), passes=1).index[0]
        found[name] = tuple(
            float(one[0]) for one in (index(at.parameters), wide, exact(at.parameters))
        )
    return found


def paper_table(plant: eoi.Plant, y: np.ndarray) -> tuple[str, str]:
    """P of the paper's sets beside what it prints, and what that says."""
    found = paper_indices(plant, y)
    rows = [
        (name, *(f"{value:g}" for value in theta), f"{printed:g}",
         *(f"{value:.3g}" for value in found[name]))
        for name, (theta, printed) in PAPER.items()
    ]  # fmt: skip
    header = ("set", "α", "β", "ρ", "P printed (its rig)", "P, default filter", "P, 90 rad/s")
    toolbox, vss, own = (found[name][0] for name in PAPER)
    order = "comes out" if own < min(toolbox, vss) else "does not come out"
    text = (
        f"The paper's order, both rivals far above its own set, {order}: {toolbox:.3g} and "
        f"{vss:.3g} against {own:.3g}. It must, for its own set is the truth here: P says how far "
        "a set is from the one that made the record. On its rig nothing is known to be the truth, "
        "and 0.0028 is what is left of the model's error there under the best of the three (dry "
        "friction, the motor, the sensor: undeclared, and not simulated), under its own filter. "
        "The two rivals lie about as far off here as printed, within a factor of two, where their "
        "difference from the truth is all that there is: the rig is closer to the paper's set "
        "than to theirs. That does not say which *method* is better. P is also what the paper's "
        "method minimises; and the tables above, where every method gets the same records, show "
        "that a toolbox-like fit finds the truth."
    )
    return common.table((*header, "P without noise"), rows), text


def lag_text(plant: eoi.Plant, y: np.ndarray) -> str:
    """Where the bias of the VSS direct method comes from, in numbers."""
    found = comparators.VSSDirect().estimate(plant, [experiment(plant, y, 0.0, 0)]).parameters
    assert found is not None
    true = eoi.plants.mass_spring_damper(true=True).parameters
    return (
        "`vss_direct` filters its injection (τ = 0.02 s) and not its regressors, so that what "
        "α̂₀ is off by is taken for damping: (300 - α) τ = "
        f"{(300.0 - true['alpha']) * 0.02:.3g} to first order, {found['beta'] - true['beta']:.3g} "
        "without noise. α̂₀ is the middle of the paper's intervals here; the paper does not give "
        "its form, and its β (8.095, below the truth here) suggests that its α̂₀ was another."
    )


def main() -> None:
    options = common.arguments(__doc__)
    plant = eoi.plants.mass_spring_damper()
    true = eoi.plants.mass_spring_damper(true=True)
    truth = np.asarray(true.theta)
    y = independent.one_mass(true.parameters, clock(), drive(), "zero")
    seeds, merged = (4, 2) if options.quick else (SEEDS, MERGED_SEEDS)
    report = common.Report("Section 6: the one-mass plant, beside the paper")
    report.add(
        f"`y'' = -α y - β y' + ρ u` with the paper's final parameters as truth ({truth[0]:g}, "
        f"{truth[1]:g}, {truth[2]:g}), from rest; square wave of period {PERIOD:g} s, 50 % duty, "
        f"1 V, {DURATION:g} s an experiment at 1 kHz; all methods start from the toolbox's values. "
        "White noise; mean ± spread over the seeds; *worst bias* is the largest "
        "of the three mean errors, with the standard error of that mean. P: eq. (14) on the first "
        "record of seed 0 under one observer and filter, the library's default there. "
        f"`output_error` also on {EXPERIMENTS} merged experiments, as the paper merges them for "
        "the toolbox. Time: a call once compiled.",
    )
    for level in LEVELS:
        sigma = level * float(np.sqrt(np.mean(y**2)))
        report.add(
            f"## Noise {level:g} of rms(y) ({1e6 * sigma:.3g} µm)",
            level_table(plant, y, level, seeds, merged),
        )
    report.add(lag_text(plant, y))
    report.add("## The paper's three sets of parameters on our record", *paper_table(plant, y))
    report.add(f"CPU time: {time.process_time():.0f} s.")
    report.close(__file__, options.write)


if __name__ == "__main__":
    main()
