"""Random starts within ±200 % of the truth: how many reach the best optimum, with passes and without.

Each parameter is drawn uniformly from [θ - 2|θ|, θ + 2|θ|], cut to the bounds of the plant. Passes
of all starts run at once (`eoi.sweep`), then all are refined side by side, each from its own
estimate; beside it output error straight from the starts.

    python benchmarks/random_starts.py [--quick] [--write]
"""

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import comparator_cases
import jax
import jax.numpy as jnp
import numpy as np
import refine_cases
from common import Report, arguments, data_directory, percent, table

import eoi_jax as eoi
from eoi_jax.levenberg_marquardt import solve_many
from eoi_jax.output_error import Unknowns, guessed_starts, problem_of, spans_of

NOISE = 1e-3  # of the simulated records, over rms(y)
REACH = 2.0  # of the starts, in sizes of each parameter
STEPS = 50  # of the solver, as `refine` allows by default
SIDE = 100  # starts side by side
CLOSE = 1e-2  # cost over the lowest one, less one, that counts as reached


@dataclass(frozen=True)
class Case:
    """A plant, where its starts are drawn, and one record.

    Attributes:
        plant: with the values from which gains and initial state are chosen.
        centre: of the starts; the truth, or the best optimum known.
        substeps: of refinement and output error.
        options: of the passes, where they are not the default.
    """

    name: str
    plant: eoi.Plant
    centre: np.ndarray
    record: eoi.Record
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
            one.plant.name, one.plant, np.asarray(one.truth.theta), one.record(1, NOISE),
            substeps.get(one.plant.name, 1),
        )
        for one in comparator_cases.cases()
    ]  # fmt: skip


@dataclass(frozen=True)
class Ends:
    """Where starts led: costs (starts,), infinite without an answer, and parameters."""

    cost: np.ndarray
    theta: np.ndarray
    seconds: float


def passes(case: Case, rows: np.ndarray) -> tuple[np.ndarray, Any, float]:
    """Estimates of the passes, NaN without one; the dataset of the sweep; seconds."""
    began = time.perf_counter()
    swept = eoi.sweep(case.plant, case.record, starts=rows, **case.options)
    theta = np.asarray(swept.parameters).reshape(len(rows), -1)
    return theta, swept, time.perf_counter() - began


def refined(case: Case, rows: np.ndarray) -> Ends:
    """Each row refined on its own; the initial state is guessed once, as `refine` does."""
    began = time.perf_counter()
    spans = spans_of([case.record], None)
    problem = problem_of(case.plant, [case.record], spans, case.substeps)
    state = jnp.asarray(guessed_starts(case.plant, [case.record], spans, case.substeps))
    free = np.asarray(problem.free)
    cost, theta = np.full(len(rows), np.inf), rows.copy()
    (known,) = np.nonzero(np.all(np.isfinite(rows), axis=1))
    for first in range(0, len(known), SIDE):
        which = known[first : first + SIDE]
        index = which[np.minimum(np.arange(SIDE), len(which) - 1)]  # always so many: one program
        starts = jnp.broadcast_to(state, (SIDE, *state.shape))
        found = solve_many(problem, Unknowns(jnp.asarray(rows[index][:, free]), starts), STEPS)
        cost[which] = np.asarray(found.cost)[: len(which)]
        theta[np.ix_(which, free)] = np.asarray(found.unknowns.theta)[: len(which)]
    cost = np.where(np.isfinite(cost), cost, np.inf)
    return Ends(cost, theta, time.perf_counter() - began)
