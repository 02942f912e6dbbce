"""Time of pass and refinement, compiled, beside scipy's least squares over a loop by Numba.

Same model, record, starting values and steps a sample; one process, by turns; medians. The rival
(`refine_rivals.py`) is written by hand for each plant.

    python benchmarks/speed/refine_speed.py [--quick] [--write]
"""

import os
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks.common import Report, arguments, data_directory, table
from benchmarks.measured import refine_cases
from benchmarks.speed import refine_rivals as rivals

STARTS = 100  # side by side
OWN = ("trf", 1e-8)  # scipy's `least_squares` as it comes
PAUSE = 0.3  # before each round [s]: the rival's BLAS threads spin on after its last call
REACH = 2.0  # of them, around the estimate, in sizes of each parameter


@dataclass(frozen=True)
class Case:
    """A plant from its starting values, its record, and the rival's simulator of it."""

    name: str
    plant: eoi.Plant
    record: eoi.Record
    run: Callable[..., np.ndarray]
    substeps: int


def cases() -> tuple[Case, ...]:
    """Of emps one step a sample is exact but for the stops: linear between them, a held input."""
    folder = data_directory()
    emps, box = refine_cases.emps(folder), refine_cases.silverbox(folder)
    return (
        Case("emps, 1 step a sample", *emps, rivals.emps(), 1),
        Case("emps, 4 steps a sample", *emps, rivals.emps(), 4),
        Case("silverbox, 4 steps a sample", *box, rivals.silverbox(), 4),
    )


@dataclass
class Measured:
    """Of one case.

    Attributes:
        seconds: by what took them, one for each round.
        cost: mean square errors, by who found them.
        setting: of the rival, the fastest that finds the lowest cost within 1 %.
    """

    setting: tuple[str, float]
    seconds: dict[str, list[float]] = field(default_factory=dict)
    cost: dict[str, float] = field(default_factory=dict)

    def median(self, *names: str) -> float:
        """Of the sum of these [s]."""
        return float(np.median(np.sum([self.seconds[name] for name in names], axis=0)))

    def ratio(self, ours: tuple[str, ...], theirs: str) -> float:
        """Median over the rounds."""
        both = np.sum([self.seconds[name] for name in ours], axis=0)
        return float(np.median(both / np.asarray(self.seconds[theirs])))


def measured(case: Case, rounds: int) -> Measured:
    """Everything once to compile, then by turns."""
    one = Measured(fastest(case))
    for number in range(rounds + 1):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", eoi.RecordWarning)
            taken, cost = turn(case, one.setting)
        one.cost |= cost
        for name, seconds in taken.items():
            one.seconds.setdefault(name, []).extend([seconds] * (number > 0))
    return one


def turn(case: Case, setting: tuple[str, float]) -> tuple[dict[str, float], dict[str, float]]:
    """Seconds and costs of one round."""
    time.sleep(PAUSE)
    seconds, cost = {}, {}
    steps = {"": {"substeps": case.substeps}, "fine ": {}}
    starts = {}
    for name, fineness in steps.items():  # as one would call them, one right after the other
        seconds[f"{name}identify"], starts[name] = timed(
            lambda fineness=fineness: eoi.identify(case.plant, case.record, **fineness)
        )
        seconds[f"{name}refine"], cost[f"{name}refine"] = refined(case, starts[name])
    seconds["cold refine"], cost["cold refine"] = refined(case, case.plant)
    for name, start, how in (
        ("scipy", case.plant, setting),
        ("own scipy", case.plant, OWN),
        ("warm scipy", starts[""], setting),
    ):
        values = start.parameters
        fit = rivals.fit(case.run, values, case.record, case.substeps, how)
        seconds[name], cost[name] = fit.seconds, fit.cost
    return seconds, cost


def refined(case: Case, start: eoi.Plant | eoi.Identification) -> tuple[float, float]:
    """Seconds, and mean square error."""
    seconds, found = timed(lambda: eoi.refine(start, case.record, substeps=case.substeps))
    return seconds, float(found.rmse[0]) ** 2


def timed(call: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds it takes, and what it gives."""
    began = time.perf_counter()
    found = call()
    return time.perf_counter() - began, found


def fastest(case: Case) -> tuple[str, float]:
    """Of the rival's settings, best of three each."""
    fits = [
        min(
            (rivals.fit(case.run, case.plant.parameters, case.record, case.substeps, setting)
             for _ in range(4)),
            key=lambda fit: fit.seconds,
        )
        for setting in rivals.SETTINGS
    ]  # fmt: skip
    lowest = min(fit.cost for fit in fits)
    order = np.argsort([fit.seconds if fit.cost < 1.01 * lowest else np.inf for fit in fits])
    return rivals.SETTINGS[order[0]]


def side_by_side(case: Case, rounds: int) -> tuple[float, float, float]:
    """Median seconds of one start, and of `STARTS` further ones; how much these lower the cost."""
    theta = np.asarray(eoi.refine(case.plant, case.record, substeps=case.substeps).plant.theta)
    draw = np.random.default_rng(0).uniform(-1.0, 1.0, (STARTS, len(theta)))
    lower, upper = case.plant.lower, case.plant.upper
    rows = np.clip(theta + REACH * np.abs(theta) * draw, lower, upper)

    def one() -> eoi.Refinement:
        return eoi.refine(case.plant, case.record, substeps=case.substeps)

    def many() -> eoi.Refinement:
        return eoi.refine(case.plant, case.record, substeps=case.substeps, starts=rows)

    one()
    many()
    pairs = [(timed(one), timed(many)) for _ in range(rounds)]
    alone, together = (float(np.median([pair[i][0] for pair in pairs])) for i in (0, 1))
    (_, first), (_, last) = pairs[-1]
    return alone, together, float(last.rmse[0] / first.rmse[0]) ** 2 - 1.0


# -- what is shown ------------------------------------------------------------------------------


def milliseconds(seconds: float) -> str:
    """Three digits."""
    return f"{1e3 * seconds:.3g} ms"


def row(name: str, one: Measured) -> list[str]:
    """Of the main table."""
    method, tolerance = one.setting
    ours, theirs = one.cost["refine"], one.cost["scipy"]
    return [
        name,
        milliseconds(one.median("identify")),
        milliseconds(one.median("refine")),
        milliseconds(one.median("identify", "refine")),
        f"{milliseconds(one.median('scipy'))} ({method}, {tolerance:g})",
        f"**{one.ratio(('identify', 'refine'), 'scipy'):.2f}**",
        milliseconds(one.median("own scipy")),
        f"{one.ratio(('identify', 'refine'), 'own scipy'):.2f}",
        f"{1e3 * ours**0.5:.4f}",
        f"{1e3 * theirs**0.5:.4f}",
        f"{100 * (ours / theirs - 1.0):+.2g} %",
    ]


def other_row(name: str, one: Measured) -> list[str]:
    """Of the second one."""
    fine, best = ("fine identify", "fine refine"), min(one.cost.values())
    costs = (f"{100 * (one.cost[key] / best - 1.0):+.2g} %" for key in
             ("fine refine", "cold refine", "warm scipy"))  # fmt: skip
    return [
        name,
        milliseconds(one.median("fine identify")),
        milliseconds(one.median(*fine)),
        f"{one.ratio(fine, 'scipy'):.2f}",
        milliseconds(one.median("cold refine")),
        f"{one.ratio(('cold refine',), 'scipy'):.2f}",
        milliseconds(one.median("warm scipy")),
        f"{one.ratio(('refine',), 'warm scipy'):.2f}",
        ", ".join(costs),
    ]


HEADER = ("case", "identify", "refine", "both", "scipy (method, ftol)", "both / scipy",
          "scipy as it comes", "both / that", "ours, rms", "scipy, rms",
          "cost, ours over scipy's")  # fmt: skip
OTHER = ("case", "identify, 20 steps a sample", "and refine", "/ scipy", "cold refine", "/ scipy",
         "scipy from the pass", "refine / that", "costs of the three over the best")  # fmt: skip


def main() -> None:
    """Both tables, and many starts."""
    options = arguments(__doc__)
    rounds = 3 if options.quick else 9
    report = Report("Pass and refinement beside scipy over Numba")
    report.add(
        f"Medians of {rounds} rounds by turns, everything compiled, {PAUSE:g} s of pause before "
        f"each round; load average before {os.getloadavg()[0]:.2f}. emps: 24 841 samples, Coulomb "
        "friction and offset; silverbox: 5000 samples of the estimation part, quadratic and cubic "
        "stiffness, offset, band-limited input. All start from the plant's starting values; pass, "
        "refinement and rival take the same steps a sample; rms in mm and mV. The rival takes the "
        "method and tolerance that are fastest for it within 1 % of the lowest cost; beside it "
        "`least_squares` as it comes: `trf`, 1e-8. Ours ends with standard errors, the rival with "
        "a point.",
    )
    several = cases()[-1:] if options.quick else cases()
    found = {case.name: measured(case, rounds) for case in several}
    report.add(table(HEADER, [row(name, one) for name, one in found.items()]))
    report.add(
        "The same with the pass at the steps a sample that it chooses by itself, 20; refinement "
        "without a pass (cold); scipy from the estimate of the pass; what each of these ends at:",
        table(OTHER, [other_row(name, one) for name, one in found.items()]),
    )
    rows = []
    for case in several:
        alone, together, change = side_by_side(case, 3)
        rows.append([case.name, milliseconds(alone), milliseconds(together),
                     f"**{together / alone:.2f}**", f"{100 * change:+.2g} %"])  # fmt: skip
    report.add(
        f"`refine` from {STARTS} more starts, each parameter within ±{100 * REACH:.0f} % of the "
        "optimum, inside the bounds (medians of 3):",
        table(("case", "one start", f"{STARTS} more", "ratio", "cost"), rows),
        f"Load average after: {os.getloadavg()[0]:.2f}.",
    )
    report.close(__file__, options.write)


if __name__ == "__main__":
    main()
