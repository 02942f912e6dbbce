"""Random starts within ±200 % of the truth: how many reach the best optimum.

Each parameter is drawn uniformly from [θ - 2|θ|, θ + 2|θ|], cut to the bounds of the plant. Passes
of all starts run at once (`eoi.sweep`), then all are refined side by side, each from its own
estimate; beside it output error straight from the starts. The tanks also with points that `refine`
draws by itself.

    python benchmarks/statistics/random_starts.py [--quick] [--write]
"""

import functools
import multiprocessing
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import jax.numpy as jnp
import numpy as np

import eoi_jax as eoi
from benchmarks.common import Report, arguments, data_directory, percent, table
from benchmarks.measured import measured_cases, refine_cases
from benchmarks.statistics import comparator_cases
from eoi_jax.refinement.levenberg_marquardt import solve_many
from eoi_jax.refinement.problem import Unknowns, guessed_starts, problem_of
from eoi_jax.refinement.spans import spans_of

NOISE = 1e-3  # of the simulated records, over rms(y)
REACH = 2.0  # of the starts, in sizes of each parameter
STEPS = 50  # of the solver, as `refine` allows by default
SIDE = 100  # starts side by side
ALONE = 300  # of 1000 starts, for output error alone
PROCESSES = 2  # of one core each, where points are drawn
TURNS, ROUNDS = 10, 4  # starts of the tanks in turn, and of points drawn at their end
CLOSE = 1e-2  # cost over the lowest one, less one, that counts as reached


@dataclass(frozen=True)
class Case:
    """A plant, where its starts are drawn, and one record.

    Attributes:
        plant: its values do not count.
        centre: of the starts; the truth, or the best optimum known.
        substeps: of refinement and output error.
        options: of the passes, where they are not the default.
    """

    name: str
    plant: eoi.Plant
    record: eoi.Record
    centre: np.ndarray
    substeps: int
    options: dict[str, Any] = field(default_factory=dict)

    def rows(self, count: int, seed: int = 0) -> np.ndarray:
        """Starts (count, np); fixed parameters stay."""
        reach = REACH * np.abs(self.centre) * np.asarray(self.plant.free)
        low = np.maximum(self.centre - reach, self.plant.lower)
        high = np.minimum(self.centre + reach, self.plant.upper)
        return np.random.default_rng(seed).uniform(low, high, (count, len(low)))


def simulated() -> list[Case]:
    """Of `comparator_cases.py`: one record each, from `independent.py`."""
    substeps = {"Duffing oscillator": 4}  # sampled near its dynamics; one step does for the others
    return [
        Case(
            one.plant.name, one.plant, one.record(1, NOISE), np.asarray(one.truth.theta),
            substeps.get(one.plant.name, 1),
        )
        for one in comparator_cases.cases()
    ]  # fmt: skip


# Best optima known of the measured sets, by `refine` from many starts around the best of before.
OPTIMA = {
    "silverbox": (186053.4, 41.91272, 184315.2, -5935.7, 726398.6, -1010.745),
    "emps": (96.424, 219.76, 18.8441, -3.26542),
    "cascaded_tanks without overflow": (0.0581779, 0.05, 0.0896949, 0.0868692, 16.3331),
    "cascaded_tanks": (0.042255, 0.05, 0.046087, 0.044918, 8.0354, 7.1485, 10.1149, 1.00916,
                       0.21778, 12.658, -0.040703),
}  # fmt: skip


# Most starts have no estimate: points that `refine` draws around one by itself, and how often.
DRAWN = {"cascaded_tanks without overflow": (200, 2), "cascaded_tanks": (100, 180)}
TANKS = {"lowpass": eoi.LowPass(0.05, 2), "passes": 30}  # as in their config


@functools.cache
def measured() -> list[Case]:
    """Of `refine_cases.py`: effects declared."""
    folder = data_directory()
    return [
        Case(name, *made(folder), np.asarray(OPTIMA[name]), substeps, options)
        for name, made, substeps, options in (
            ("silverbox", refine_cases.silverbox, 4, {}),
            ("emps", refine_cases.emps, 1, {}),
            ("cascaded_tanks without overflow", refine_cases.bare_tanks, 4, TANKS),
            ("cascaded_tanks", refine_cases.cascaded_tanks, 4, TANKS),
        )
    ]


@dataclass(frozen=True)
class Ends:
    """Where starts led: costs (starts,), infinite without an answer, and parameters."""

    cost: np.ndarray
    theta: np.ndarray
    seconds: float


def parts(case: Case, rows: np.ndarray) -> list[tuple[slice, eoi.Plant]]:
    """Starts that run side by side, and the plant at the first of them.

    Gains and initial state are chosen there: nothing near the truth may help.
    """
    slices = [slice(first, first + SIDE) for first in range(0, len(rows), SIDE)]
    return [(one, case.plant.with_parameters(rows[one.start])) for one in slices]


def passes(case: Case, rows: np.ndarray) -> Ends:
    """Estimates of the passes; the cost is their index under common gains."""
    began, theta, cost = time.perf_counter(), [], []
    for one, plant in parts(case, rows):
        swept = eoi.sweep(plant, case.record, starts=rows[one], **case.options)
        theta.append(np.asarray(swept.parameters).reshape(-1, len(plant.names)))
        index = np.asarray(swept.common_index).reshape(len(theta[-1]), -1)
        cost.append(np.sum(np.log(index), axis=1))
    return Ends(np.concatenate(cost), np.concatenate(theta), time.perf_counter() - began)


def refined(case: Case, rows: np.ndarray, starts: np.ndarray) -> Ends:
    """Each row on its own; where there is none (NaN), no answer.

    Args:
        rows: from which to refine.
        starts: at which the initial state is guessed, as `refine` does once for several starts.
    """
    began, cost, theta = time.perf_counter(), np.full(len(rows), np.inf), rows.copy()
    for one, plant in parts(case, starts):
        (known,) = np.nonzero(np.all(np.isfinite(rows[one]), axis=1))
        if len(known):
            # Always so many: one program.
            index = one.start + known[np.minimum(np.arange(SIDE), len(known) - 1)]
            ends = side_by_side(plant, case.record, case.substeps, rows[index])
            cost[index], theta[index] = ends
    return Ends(np.where(np.isfinite(cost), cost, np.inf), theta, time.perf_counter() - began)


def side_by_side(
    plant: eoi.Plant, record: eoi.Record, substeps: int, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What `refine` does from one row, from all of them: costs and parameters."""
    spans = spans_of([record], None)
    problem = problem_of(plant, [record], spans, substeps)
    state = jnp.asarray(guessed_starts(problem, [record], spans))
    starts = jnp.broadcast_to(state, (len(rows), *state.shape))
    free = np.asarray(problem.free)
    found = solve_many(problem, Unknowns(jnp.asarray(rows[:, free]), starts), STEPS)
    theta = rows.copy()
    theta[:, free] = np.asarray(found.unknowns.theta)
    return np.asarray(found.cost), theta


# -- what is shown ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Found:
    """What a case came to.

    Attributes:
        name: of the case.
        passed: estimates of the passes.
        polished: refined from these.
        alone: output error from the same starts, the first of them.
        drawn: refined from the passes with points drawn around them, of the tanks.
        best: lowest cost of all, of a refinement from `Case.centre` too.
    """

    name: str
    passed: Ends
    polished: Ends
    alone: Ends
    drawn: Ends | None
    best: float

    def reached(self, ends: Ends, close: float = CLOSE) -> np.ndarray:
        """Which starts ended at a cost so close to the best one."""
        return ends.cost <= (1.0 + close) * self.best

    def median(self, ends: Ends) -> float:
        """Rms error over that of the best optimum, of the middle one of those that missed."""
        missed = ends.cost[~self.reached(ends)]
        return float(np.sqrt(np.median(missed) / self.best)) if len(missed) else np.nan


def found(case: Case, count: int, alone: int) -> Found:
    """Passes and refinement from `count` starts, output error from the first `alone`."""
    rows = case.rows(count)
    passed = passes(case, rows)
    polished = refined(case, passed.theta, rows)
    straight = refined(case, rows[:alone], rows[:alone])
    best = refined(case, case.centre[None], case.centre[None])
    more = drawn(case, passed.theta, rows) if case.name in DRAWN else None
    lowest = min(float(np.min(one.cost)) for one in (polished, straight, best, more or best))
    return Found(case.name, passed, polished, straight, more, lowest)


def row(one: Found) -> list[str]:
    """Of the table."""
    estimates = np.isfinite(one.passed.theta[:, 0])
    cells = [one.name, f"{np.sum(estimates)} of {len(estimates)}"]
    for ends in (one.polished, one.alone):
        wide, narrow = one.reached(ends), one.reached(ends, CLOSE / 10)
        missed = one.median(ends)
        shares = [percent(float(np.mean(one))) for one in (wide, narrow)]
        cells += [
            f"**{shares[0]}** ({shares[1]}) of {len(wide)}",
            "" if np.isnan(missed) else "no run" if missed > 1e4 else f"{missed:.3g}",
        ]
    seconds = (one.passed.seconds, one.polished.seconds, one.alone.seconds)
    return [*cells, ", ".join(f"{value:.3g}" for value in seconds)]


def drawn(case: Case, rows: np.ndarray, starts: np.ndarray) -> Ends:
    """`refine` of each row on its own with points that it draws around it by itself.

    Args:
        rows: estimates of the passes.
        starts: where they began; drawn around where there is no estimate (NaN).
    """
    began = time.perf_counter()
    known = np.all(np.isfinite(rows), axis=1, keepdims=True)
    several = np.where(known, rows, starts)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(PROCESSES, context, initializer=eoi.configure) as pool:
        ends = list(pool.map(one_drawn, [case.name] * len(several), several))
    cost = np.asarray([one[0] for one in ends])
    cost = np.where(np.isfinite(cost), cost, np.inf)  # no answer
    return Ends(cost, np.stack([one[1] for one in ends]), time.perf_counter() - began)


def one_drawn(name: str, row: np.ndarray) -> tuple[float, np.ndarray]:
    """Cost and parameters from one row, in a process of its own."""
    (case,) = (one for one in measured() if one.name == name)
    plant, (points, rounds) = case.plant.with_parameters(row), DRAWN[name]
    one = eoi.refine(plant, case.record, substeps=case.substeps, starts=points, rounds=rounds)
    return cost_of(one, case.record), np.asarray(one.plant.theta)


def cost_of(one: eoi.Refinement, record: eoi.Record) -> float:
    """In the unit of `side_by_side`: squares over the variance of the output."""
    return float(len(record) * one.rmse[0] ** 2 / np.var(record.outputs))


def tanks_in_turn(number: int) -> tuple[list[str], tuple[float, float]]:
    """A random start without effects refined with drawn points, `discover`, `refine`.

    Returns:
        A row, and the costs without drawn points and with them.
    """
    folder = data_directory()
    case, (plant, record) = measured_cases.cascaded_tanks(folder), refine_cases.bare_tanks(folder)
    bare = Case("", plant, record, np.asarray(OPTIMA["cascaded_tanks without overflow"]), 4, TANKS)
    lost = plant.with_parameters(bare.rows(number + 1)[number])
    points, _ = DRAWN["cascaded_tanks without overflow"]
    first = eoi.refine(lost, record, starts=points)
    more = eoi.discover(
        first.plant, case.records, case.held_out, lowpass=case.lowpass, window=case.window
    )
    alone = eoi.refine(more.plant, record)
    helped = eoi.refine(more.plant, record, starts=points, rounds=ROUNDS)
    volts = [f"{float(one.rmse[0]):.4f} V" for one in (first, alone, helped)]
    cells = [str(number), volts[0], ", ".join(more.effects), *volts[1:]]
    return cells, (cost_of(alone, record), cost_of(helped, record))


def drawn_row(one: Found) -> list[str]:
    """Of the table of drawn points."""
    assert one.drawn is not None
    wide, missed = one.reached(one.drawn), one.median(one.drawn)
    rest = "" if np.isnan(missed) else f"{missed:.3g}"
    share = f"**{percent(float(np.mean(wide)))}** of {len(wide)}"
    points, rounds = DRAWN[one.name]
    seconds = f"{one.drawn.seconds / len(wide):.2g}"
    return [one.name, f"{points}, {rounds}", share, rest, seconds]


HEADER = ("case", "passes answer", "pass + refine", "missed: rms / best", "output error alone",
          "missed: rms / best", "time: passes, refine, alone [s]")  # fmt: skip


def main() -> None:
    """All cases."""
    options = arguments(__doc__)
    report = Report("Random starts within ±200 % of the truth")
    report.add(
        f"Each parameter uniform in [θ - {REACH:g}|θ|, θ + {REACH:g}|θ|] of the truth (simulated) "
        "or of the best optimum known (measured), drawn inside the plant's bounds where it has any "
        f"(the mass of emps; levels and overflow rates of the tanks). Simulated records: noise "
        f"{NOISE:g} of rms(y), from `independent.py`. Gains, and the initial state that refinement "
        f"starts from, are chosen at a random start too, one in {SIDE}. *Reached*: cost of the "
        f"free run within {percent(CLOSE)} of the lowest found by anything (in brackets: "
        f"{percent(CLOSE / 10)}). At most {STEPS} steps of the solver, here and there. "
        f"Output error alone: the first {ALONE} of 1000 starts. *No run*: the middle one "
        "of those that missed has no estimate to refine, or its free run diverges."
    )
    rows, ends = [], []
    for case in simulated()[:2] if options.quick else [*simulated(), *measured()]:
        count = SIDE if options.quick or case.name in OPTIMA else 1000
        one = found(case, count, min(count, ALONE))
        rows.append(row(one))
        print(rows[-1], flush=True)
        ends.append(one)
    report.add(table(HEADER, rows))
    if not options.quick:
        several = [one for one in ends if one.drawn is not None]
        report.add(
            "Passes, then `refine(starts=…, rounds=…)`, each start on its own: points around the "
            "estimate of the passes, or around the start where they have none. Two processes share "
            "the starts; seconds are those of both over all starts.",
            table(("case", "starts, rounds", "reached", "missed: rms / best", "seconds a start"),
                  [drawn_row(one) for one in several]),
        )  # fmt: skip
        turns = [tanks_in_turn(number) for number in range(TURNS)]
        best = min(several[-1].best, *(min(costs) for _, costs in turns))
        points, _ = DRAWN["cascaded_tanks without overflow"]
        report.add(
            f"The tanks in turn, each from one random start: `refine(starts={points})` without "
            "effects; `discover` from there; `refine` with what it adds, without and with points "
            f"drawn {ROUNDS} times, and both costs beside the lowest of all:",
            table(("start", "bare", "added", "with these", f"rounds={ROUNDS}", "above the best"),
                  [[*cells, ", ".join(percent(cost / best - 1.0) for cost in costs)]
                   for cells, costs in turns]),
        )  # fmt: skip
    report.close(__file__, options.write)


if __name__ == "__main__":
    main()
