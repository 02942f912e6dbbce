"""What noise costs: errors over the Cramér–Rao bound, bias and coverage of five plants, many seeds.

python benchmarks/statistics/instruments.py [--quick] [--write]
"""

import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks import independent
from benchmarks.common import Report, arguments, table
from benchmarks.statistics.comparator_cases import Case, cases
from eoi_jax.comparison.methods import StateVariableInstruments

LEVELS = (1e-4, 1e-3, 1e-2)  # of rms(y), output by output
SEEDS = {1e-4: 20, 1e-3: 50, 1e-2: 20}
MANY, FEW = 200, 6  # of the refinement at the middle level, and with --quick
Found = tuple[np.ndarray, np.ndarray]  # parameters and standard errors
METHODS: dict[str, Callable[[Case, eoi.Record], Found]] = {
    "plain": lambda one, record: _fitted(eoi.identify(one.plant, record, instruments=False)),
    "instruments": lambda one, record: _fitted(eoi.identify(one.plant, record, instruments=True)),
    "by default": lambda one, record: _fitted(eoi.identify(one.plant, record)),
    "svf_iv": lambda one, record: _compared(one, record),
    "refine": lambda one, record: _fitted(
        eoi.refine(eoi.identify(one.plant, record, instruments=False), record)
    ),
}


def main() -> None:
    """Every plant and level."""
    options = arguments(__doc__)
    report = Report("Instruments")
    report.add(
        "Records of `comparator_cases.py` under one drive, several seeds of white noise on every "
        "output, σ a share of its rms; everything chosen by the library. *Error*: rms over the "
        "seeds of each parameter's error, over its Cramér–Rao bound (free run, initial state "
        "unknown, differences of `eoi.simulate`): geometric mean and worst parameter. *Bias*: the "
        "largest mean error over its own standard error. *Coverage*: share of all parameters and "
        "seeds inside 1.96 standard errors. `svf_iv` is the state-variable filter with instruments "
        "of `eoi_jax.compare`."
    )
    for one in cases():
        report.add(f"## {one.plant.name}", plant_table(one, LEVELS, seeds_of(options.quick)))
    report.close(__file__, options.write)


def seeds_of(quick: bool) -> Callable[[float, str], int]:
    """How many, by level and method."""

    def count(level: float, name: str) -> int:
        return FEW if quick else MANY if (level, name) == (1e-3, "refine") else SEEDS[level]

    return count


def plant_table(one: Case, levels: tuple[float, ...], seeds: Callable[[float, str], int]) -> str:
    """A row for each level and method."""
    u = one.drive(one.time, 1)
    y = one.simulate(u)
    rows = []
    for level in levels:
        bound = cramer_rao(one, u, y, level)
        for name in METHODS:
            started = time.perf_counter()
            count = seeds(level, name)
            errors, claimed = _scattered(one, name, u, y, level, count)
            seconds = (time.perf_counter() - started) / count
            rows.append([f"{level:g}", name, *_summary(errors, claimed, bound), f"{seconds:.2g}"])
    header = ["σ / rms(y)", "method", "error / bound", "worst", "bias", "coverage", "seeds", "s"]
    return table(header, rows)


def _scattered(
    one: Case, name: str, u: np.ndarray, y: np.ndarray, level: float, seeds: int
) -> Found:
    sigma = level * np.sqrt(np.mean(y**2, axis=0))
    truth = np.asarray(one.truth.theta)
    found = []
    for seed in range(seeds):
        seen = independent.with_sensor(y, sigma, 0.0, 1000 + seed)
        record = eoi.Record(
            one.time, u, seen, f"seed {seed}", input_names=one.plant.inputs,
            output_names=one.plant.outputs, hold="zero",
        )  # fmt: skip
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            theta, claimed = METHODS[name](one, record)
        found.append((theta - truth, claimed))
    errors, claimed = (np.stack(part) for part in zip(*found, strict=True))
    return errors, claimed


def _summary(errors: np.ndarray, claimed: np.ndarray, bound: np.ndarray) -> list[str]:
    answered = np.all(np.isfinite(errors), axis=1)
    errors, claimed = errors[answered], claimed[answered]
    if len(errors) < 2:
        return ["no answer", "", "", "", f"{len(errors)}"]
    over = np.sqrt(np.mean(errors**2, axis=0)) / bound
    spread = np.std(errors, axis=0, ddof=1) / np.sqrt(len(errors))
    bias = np.max(np.abs(np.mean(errors, axis=0)) / spread)
    covered = np.mean(np.abs(errors) <= 1.96 * claimed)
    return [
        f"{np.exp(np.mean(np.log(over))):.3g}", f"{np.max(over):.3g}", f"{bias:.2g}",
        f"{covered:.3f}", f"{len(errors)}",
    ]  # fmt: skip


def cramer_rao(one: Case, u: np.ndarray, y: np.ndarray, level: float) -> np.ndarray:
    """Smallest standard deviations of an unbiased estimate, the initial state unknown."""
    sigma = level * np.sqrt(np.mean(y**2, axis=0))
    plant, theta = one.truth, np.asarray(one.truth.theta)
    start = np.zeros((plant.relative_degree, y.shape[1]))
    start[0] = y[0]
    pace = np.sqrt(np.mean(np.diff(y, axis=0) ** 2, axis=0) / np.var(y, axis=0))
    pace /= one.time[1] - one.time[0]

    def run(values: np.ndarray, x: np.ndarray) -> np.ndarray:
        model = plant.with_parameters(values)
        made = eoi.simulate(model, one.time, u, x, hold="zero", substeps=4)
        return (made.outputs / sigma).ravel()

    columns = []
    for i, value in enumerate(theta):
        step = 1e-5 * abs(value) * (np.arange(len(theta)) == i)
        difference = run(theta + step, start) - run(theta - step, start)
        columns.append(difference / (2.0 * np.max(step)))
    for j, degree in enumerate(plant.degrees):
        for i in range(degree):
            step = np.zeros_like(start)
            step[i, j] = 1e-4 * np.std(y[:, j]) * pace[j] ** i
            columns.append((run(theta, start + step) - run(theta, start - step)) / 2.0)
    slopes = np.stack(columns, axis=1)
    size = np.linalg.norm(slopes, axis=0)
    covariance = np.linalg.inv((slopes / size).T @ (slopes / size)) / np.outer(size, size)
    return np.sqrt(np.diagonal(covariance))[: len(theta)]


def _fitted(result: eoi.Identification | eoi.Refinement) -> Found:
    return np.asarray(result.plant.theta), np.array(list(result.standard_errors.values()))


def _compared(one: Case, record: eoi.Record) -> Found:
    found = StateVariableInstruments().estimate(one.plant, (record,))
    none = np.full(len(one.plant.names), np.nan)
    if found.parameters is None or found.standard_errors is None:
        return none, none
    values, errors = found.parameters, found.standard_errors
    return np.array(list(values.values())), np.array(list(errors.values()))


if __name__ == "__main__":
    main()
