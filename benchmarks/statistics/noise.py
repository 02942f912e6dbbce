"""How the estimate degrades with measurement noise: default gains and the paper's, 20 seeds.

python benchmarks/statistics/noise.py [--quick] [--write]
"""

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks.common import Case, Report, arguments, case, percent, table, with_outputs
from benchmarks.independent import one_mass, with_sensor

LEVELS = (1e-5, 1e-4, 1e-3, 1e-2)  # of rms(y), output by output
STEP = 1e-3
USABLE = 0.05  # worst increment, median over the seeds


def main() -> None:
    """Every plant, level and choice of gains."""
    options = arguments(__doc__)
    report = Report("Noise")
    seeds = 3 if options.quick else 20
    report.add(
        f"White noise on every output, its standard deviation σ a share of that output's rms; "
        f"records of 20 s (three masses 10 s) at 1 ms from `independent.py`, {seeds} seeds, "
        "implicit form, plain passes (instruments: `instrumental_variables.py`), sub-steps and "
        "smoothing decided by the library. *Error* is that of an "
        "increment Δθ over the true Δθ: the median over all increments and seeds, then the worst "
        "increment of a seed: its median and its largest value over the seeds. h² c3 / σ, the "
        "relay's reach over one sample, takes the σ of the raw record: smoothing (zero phase, five "
        "times the filter's band) makes it sufficient again."
    )
    plants = {
        "one_mass": _one_mass(),
        "pendulum": case("pendulum", STEP, 20.0),
        "three_masses": case("three_masses", STEP, 10.0),
    }
    for name, one in plants.items():
        report.add(f"## {name.replace('_', ' ')}")
        _plant(report, one, seeds)
    report.close(__file__, options.write)


def _one_mass() -> Case:
    """Section 6: square wave of 6 s; gains of section 5.2.2, because none are given there."""
    plant, truth = eoi.plants.mass_spring_damper(), eoi.plants.mass_spring_damper(true=True)
    time_axis = STEP * np.arange(20001)
    u = eoi.excitation.square(time_axis, amplitude=1.0, frequency=1.0 / 6.0)
    library = eoi.simulate(truth, time_axis, u)
    record = with_outputs(library, one_mass(truth.parameters, time_axis, u, str(library.hold)))
    observer = eoi.observers.SecondOrder(c1=94.0, c2=94.0, c3=10.0)
    return Case(
        plant, truth.parameters, observer, eoi.LowPass(90.0), 5, None, record, library
    )  # fmt: skip


def _plant(report: Report, one: Case, seeds: int) -> None:
    started = time.perf_counter()
    rms = np.sqrt(np.mean(one.record.outputs**2, axis=0))
    rows, usable = [], {}
    for gains, tuned in (
        ("paper's", one),
        ("default", replace(one, observer=None, lowpass=None)),
    ):
        for level in (0.0, *LEVELS):
            row, error = _level(tuned, level * rms, seeds if level else 1)
            rows.append([gains, f"{level:g}", *row])
            if error <= USABLE:
                usable[gains] = level
    report.add(
        table(
            ["gains", "σ / rms(y)", "median error", "worst increment, median", "worst, largest",
             "in sliding", "h² c3 / σ", "cut-off [rad/s]", "smoothed"],
            rows,
        ),
        "Worst increment within 5 % (median of the seeds) up to: "
        + "; ".join(f"{gains} gains, {level:g} of rms(y)" for gains, level in usable.items())
        + f". Time: {time.perf_counter() - started:.0f} s.",
    )  # fmt: skip


def _level(one: Case, sigma: np.ndarray, seeds: int) -> tuple[list[str], float]:
    errors, sliding, reach, cutoffs, smoothed = [], [], [], [], 0
    for seed in range(seeds):
        noisy = with_outputs(one.record, with_sensor(one.record.outputs, sigma, 0.0, seed))
        result = one.identify(noisy)
        errors.append([abs(value) for value in one.errors(result).values()])
        sliding.append(np.min(result.sliding_fraction))
        assert isinstance(result.observer, eoi.observers.SecondOrder)
        reach.append(np.min(STEP**2 * np.asarray(result.observer.c3) / np.maximum(sigma, 1e-300)))
        cutoffs.append(result.lowpass.cutoff)
        smoothed += any("smoothed" in note for note in result.reasons)
    worst = np.max(errors, axis=1)
    row = [
        percent(float(np.median(errors))), percent(float(np.median(worst))),
        percent(float(np.max(worst))), percent(float(np.min(sliding))),
        f"{np.median(reach):.2g}" if np.all(sigma > 0) else "", f"{np.median(cutoffs):.3g}",
        f"{smoothed} of {seeds}",
    ]  # fmt: skip
    return row, float(np.median(worst))


if __name__ == "__main__":
    main()
