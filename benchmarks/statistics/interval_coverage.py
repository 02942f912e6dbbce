"""Do 95 % intervals hold the truth in 95 of 100 experiments? Five plants, 500 seeds.

Two kinds of coloured residuals, measurement noise that is AR(1), and beside it a small random force
(a pump that wanders, for the tank) of which the model knows nothing; and white noise. Each seed
draws them anew; the excitation is the same for all. Records come from `independent.py`, and from a
plain fixed-step loop over all seeds at once where that would take hours.

python benchmarks/statistics/interval_coverage.py [--quick] [--write]
"""

import multiprocessing
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks import independent
from benchmarks.common import Report, arguments, percent, table
from eoi_jax import excitation
from eoi_jax.estimation.defaults import default_substeps

LEVEL = 0.95
SAMPLES = 1500  # a dozen decay times of the pendulum and of the three masses, no more
AUTOREGRESSION = 0.9  # of the noise, from sample to sample
NOISE = 1e-3  # its standard deviation over that of each output
FORCE = 5e-3  # standard deviation of the undeclared force over that of the input
KINDS = ("noise", "noise and force", "white noise")
METHODS = ("identify", "refine")
Simulate = Callable[[dict[str, float], np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Case:
    """A plant, its experiment, and a simulator that is not the library's.

    Attributes:
        simulate: parameters, time (N,), held inputs (runs, N): outputs (runs, N, ny).
        levels: between which the input is drawn, anew every `dwell` seconds.
        force: for how long the undeclared force keeps its level [s].
        substeps: of the refinement.
    """

    name: str
    plant: eoi.Plant
    simulate: Simulate
    period: float
    levels: tuple[float, float]
    dwell: float
    force: float
    substeps: int

    @property
    def nominal(self) -> eoi.Plant:
        """Where the passes start: 20 % off, up and down by turns."""
        factors = np.where(np.arange(len(self.plant.names)) % 2 == 0, 1.2, 0.8)
        return self.plant.with_parameters(factors * np.asarray(self.plant.theta))


# -- simulators -------------------------------------------------------------------------------


def one_by_one(simulator: Callable[..., np.ndarray], **options: float) -> Simulate:
    """A simulator of `independent.py`, run after run."""

    def simulate(p: dict[str, float], time: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        return np.stack([simulator(p, time, one, "zero", **options) for one in inputs])

    return simulate


def stepped(
    acceleration: Callable[..., np.ndarray], friction: str | None, substeps: int
) -> Simulate:
    """Runge–Kutta of order four for all runs at once; dry friction by halves around each step.

    Friction takes the velocity towards zero and not beyond: a run that sticks stays.
    """

    def simulate(p: dict[str, float], time: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        h = (time[1] - time[0]) / substeps
        drag = 0.5 * h * (p[friction] if friction else 0.0)
        y, v = np.zeros((2, len(inputs)))
        out = np.zeros((len(inputs), len(time), 1))
        for k in range(len(time) - 1):
            u = inputs[:, k]
            for _ in range(substeps):
                v = np.sign(v) * np.maximum(np.abs(v) - drag, 0.0)
                a1 = acceleration(p, y, v, u)
                v2 = v + 0.5 * h * a1
                a2 = acceleration(p, y + 0.5 * h * v, v2, u)
                v3 = v + 0.5 * h * a2
                a3 = acceleration(p, y + 0.5 * h * v2, v3, u)
                v4 = v + h * a3
                a4 = acceleration(p, y + h * v3, v4, u)
                y = y + h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
                v = v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
                v = np.sign(v) * np.maximum(np.abs(v) - drag, 0.0)
            out[:, k + 1, 0] = y
        return out

    return simulate


def swinging(p: dict[str, float], y: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Eq. (20) without its dry friction."""
    return p["d"] * u - p["a"] * np.sin(y) - p["b"] * v


def hardening(p: dict[str, float], y: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The circuit of the silverbox."""
    spring = p["stiffness"] * y + p["cubic_stiffness"] * y**3
    return p["gain"] * u - p["damping"] * v - spring + p["offset"]


def cases() -> dict[str, Case]:
    """The five plants with parameters that are the truth."""
    plants = eoi.plants
    start = 4.0  # m, of the tank, near where its mean inflow keeps it
    tank = one_by_one(independent.level_tank, start=start)
    several = [
        Case("level tank", plants.level_tank(true=True), tank, 0.02, (20.0, 35.0), 1.0, 0.4, 1),
        Case(
            "one mass", plants.mass_spring_damper(true=True), one_by_one(independent.one_mass),
            0.01, (-3.0, 3.0), 0.3, 0.1, 1,
        ),
        Case(
            "three masses", plants.three_mass_spring_damper(true=True),
            one_by_one(independent.three_masses), 0.01, (-3.0, 3.0), 0.3, 0.1, 4,
        ),
        Case(
            "pendulum", plants.pendulum(true=True), stepped(swinging, "c", 20),
            0.01, (-0.3, 0.3), 0.6, 0.1, 4,
        ),
        Case(
            "Duffing oscillator", plants.duffing_oscillator(reference=True),
            stepped(hardening, None, 10), 1e-3, (-0.15, 0.15), 8e-3, 3e-3, 4,
        ),
    ]  # fmt: skip
    return {one.name: one for one in several}


# -- records ----------------------------------------------------------------------------------


def records(case: Case, kind: str, seeds: range, samples: int) -> list[eoi.Record]:
    """One for each seed."""
    time = np.arange(samples) * case.period
    u = excitation.random_steps(time, *case.levels, case.dwell, seed=1)
    draws = [np.random.default_rng([seed, KINDS.index(kind)]) for seed in seeds]
    forces = np.zeros((1, samples))
    if kind == "noise and force":
        held = round(case.force / case.period)
        levels = np.stack([draw.standard_normal(-(-samples // held)) for draw in draws])
        forces = FORCE * np.std(u) * np.repeat(levels, held, axis=1)[:, :samples]
    clean = case.simulate(case.plant.parameters, time, u + forces)
    a = 0.0 if kind == "white noise" else AUTOREGRESSION
    y = np.broadcast_to(clean, (len(draws), *clean.shape[1:]))
    size = NOISE * np.std(clean[0], axis=0)
    return [
        eoi.Record(time, u, one + size * coloured(draw, one.shape, a), f"seed {seed}", hold="zero")
        for seed, draw, one in zip(seeds, draws, y, strict=True)
    ]


def coloured(draw: np.random.Generator, shape: tuple[int, ...], a: float) -> np.ndarray:
    """AR(1) noise of standard deviation one, in its steady state; white for a = 0."""
    settle = 200
    white = np.sqrt(1.0 - a**2) * draw.standard_normal((shape[0] + settle, *shape[1:]))
    return np.asarray(lfilter([1.0], [1.0, -a], white, axis=0))[settle:]


# -- estimates --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """Of one plant and kind of residual; arrays (seeds, free parameters), NaN without an answer.

    Attributes:
        error: estimate less truth.
        deviation: standard error.
        covered: whether the interval held the truth.
        freedom: degrees of freedom of each.
    """

    error: np.ndarray
    deviation: np.ndarray
    covered: np.ndarray
    freedom: np.ndarray


def outcomes(
    name: str, kind: str, seeds: range, samples: int = SAMPLES, methods: tuple[str, ...] = METHODS
) -> dict[str, Outcome]:
    """Estimates from every seed, by method."""
    eoi.configure()
    case = cases()[name]
    several = records(case, kind, seeds, samples)
    # Chosen once, as a user would: then nothing is compiled anew.
    first = eoi.identify(case.nominal, several[0])
    substeps = default_substeps(case.nominal, first.records, first.lowpass.cutoff)[0]
    found = {method: [] for method in methods}
    for record in several:
        start = eoi.identify(case.nominal, record, first.observer, first.lowpass, substeps=substeps)
        if "identify" in methods:
            found["identify"].append(_judged(case, start))
        if "refine" in methods:
            refined = eoi.refine(start.plant, record, substeps=case.substeps)
            found["refine"].append(_judged(case, refined))
    return {
        method: Outcome(*(np.asarray(part) for part in zip(*rows, strict=True)))
        for method, rows in found.items()
    }


def _judged(case: Case, result: eoi.Identification | eoi.Refinement) -> tuple[np.ndarray, ...]:
    truth = np.asarray(case.plant.theta)
    if not result.status.ok:
        nothing = np.full(len(truth), np.nan)
        return nothing, nothing, nothing, nothing
    known = eoi.uncertainty(result)
    low, high = np.asarray(list(known.intervals(LEVEL).values())).T
    error = np.asarray(list(known.parameters.values())) - truth
    deviation = np.asarray(list(known.standard_errors.values()))
    covered = np.where(np.isfinite(deviation), (low <= truth) & (truth <= high), np.nan)
    return error, deviation, covered, known.degrees_of_freedom


# -- the report -------------------------------------------------------------------------------


def row(name: str, kind: str, method: str, one: Outcome) -> list[str]:
    """Coverage, its worst parameter, and where a miss would come from."""
    names = cases()[name].plant.names
    share = np.nanmean(one.covered, axis=0)
    spread = np.nanstd(one.error, axis=0)
    bias = np.nanmean(one.error, axis=0) / spread
    size = np.sqrt(np.nanmean(one.deviation**2, axis=0)) / spread
    low, high = int(np.argmin(share)), int(np.argmax(share))
    far = int(np.argmax(np.abs(bias)))
    return [
        name,
        kind,
        method,
        percent(float(np.nanmean(one.covered))),
        f"{percent(share[low])} {names[low]} … {percent(share[high])} {names[high]}",
        f"{bias[far]:+.2f} {names[far]}",
        f"{np.min(size):.2f} … {np.max(size):.2f}",
        " … ".join(f"{number:.3g}" for number in _ends(np.nanmedian(one.freedom, axis=0))),
        str(int(np.sum(np.isnan(one.error[:, 0])))),
    ]


def _ends(values: np.ndarray) -> tuple[float, float]:
    return float(np.min(values)), float(np.max(values))


HEADER = (
    "plant", "residual", "method", "coverage", "worst and best parameter", "largest bias / spread",
    "standard error / spread", "degrees of freedom", "no answer",
)  # fmt: skip


def main() -> None:
    """Every plant and kind of residual, on two processes."""
    options = arguments(__doc__)
    count = 40 if options.quick else 500
    report = Report(
        "Coverage of 95 % intervals",
    )
    report.add(
        f"{count} seeds; records of {SAMPLES} samples; AR(1) noise, a = {AUTOREGRESSION}, of "
        f"{NOISE:g} of each output's standard deviation; force of {FORCE:g} of the input's. With "
        f"{count} seeds a true 95 % shows as {percent(0.95 - 2 * deviation(count))} to "
        f"{percent(0.95 + 2 * deviation(count))} (two sigma) for one parameter. Bias and standard "
        "error are over the spread of the estimates."
    )
    # The slowest first, so that both processes end together.
    tasks = [(name, kind) for name in reversed(cases()) for kind in KINDS]
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        running = {task: pool.submit(outcomes, *task, range(count)) for task in tasks}
        rows = [
            row(*task, method, one)
            for task in reversed(tasks)
            for method, one in running[task].result().items()
        ]
    report.add(table(HEADER, rows))
    report.close(__file__, options.write)


def deviation(count: int) -> float:
    """Standard deviation of a share of 95 % over so many trials."""
    return float(np.sqrt(LEVEL * (1.0 - LEVEL) / count))


if __name__ == "__main__":
    main()
