"""Measured records: found effects refined by output error, then what is left named and added.

    python benchmarks/measured/refined.py [--write]

Each set goes through `discover`, `refine`, `remaining` and `refine` again; then through
`discover(refine=True)`, which does all of it and asks the held-out record at each step. Errors of
free runs on records that were not used stand beside published numbers. Needs the folder of measured
records (EOI_DATA, by default ../shared/data beside the repository); an absent set is skipped, and
said so.
"""

import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks.common import Report, arguments, data_directory, table
from benchmarks.measured.measured_cases import CASES, Case
from benchmarks.measured.measured_effects import discovered, errors, force_error, named

SETS = {
    "silverbox": (
        "asked: arrow 0.39 mV, multisine 0.30 mV. Published: polynomial non-linear state space, "
        "commonly quoted as about 0.26 mV on the arrow; output error by scipy with these effects "
        "0.3895 and 0.303 mV"
    ),
    "emps": (
        "asked: 5 mm. Published parameters without any fit 8.4 mm from a start over 50 samples; "
        "a neural network (dynoNet) 5.01 mm in its authors' submission, 2.64 mm on a page of their "
        "project; output error with symmetric friction 5.2 to 9.2 mm"
    ),
    "cascaded_tanks": (
        "asked: 0.34 V. Published: best linear model 0.757, Volterra 0.540, polynomial state space "
        "0.450, non-linear state space 0.343, best known to us 0.31; output error by scipy 0.355"
    ),
}
ROUNDS = 1  # of naming what is left


def main() -> None:
    """Every set that is there."""
    options = arguments(__doc__)
    warnings.simplefilter("ignore", eoi.RecordWarning)
    report = Report("Measured records: refined, and what is left")
    report.add(
        "The estimation record alone decides what is added: `discover` sees the held-out record "
        "(it refuses effects that make its free run worse), `refine` and `remaining` do not. "
        "`discover(refine=True)` does; what nothing ever saw stands in the columns beside. All by "
        "default: whole records."
    )
    for name, beside in SETS.items():
        report.add(f"## {name}", f"{beside}.")
        if not (data_directory() / name).is_dir():
            report.add("Skipped: the set is absent; set EOI_DATA to the folder of the records.")
            continue
        report.add(*_section(name, CASES[name](data_directory()), 0 if options.quick else ROUNDS))
    report.close(__file__, options.write)


def _section(name: str, case: Case, rounds: int) -> list[str]:
    found = discovered(case)
    plant, rows, texts = found.discovery.plant, [], []
    rows.append(["discovered: " + named(found.discovery), *_scores(case, plant, None), ""])
    for turn in range(rounds + 1):
        started = time.perf_counter()
        result = eoi.refine(plant, list(case.records))
        taken = time.perf_counter() - started
        what = "refined" if turn == 0 else "with what was left, refined"
        rows.append([what, *_scores(case, result.plant, result), f"{taken:.1f}"])
        texts += ["", "```text", str(result), "```"]
        if turn == rounds:
            break
        left = eoi.remaining(result)
        texts += ["", "```text", str(left), "```"]
        if left.best is None:
            break
        plant = left.with_best()
    whole = discovered(case, refine=True)
    plant, what = whole.discovery.plant, "`discover(refine=True)`: " + named(whole.discovery)
    rows.append([what, *_scores(case, plant, None), f"{whole.seconds:.1f}"])
    if name == "emps":
        texts += ["", _forces(case, plant)]
    head = ["model", "fitted on", "held out", "in windows", *case.untouched, "first call [s]"]
    return [table(head, rows), *texts]


def _forces(case: Case, plant: "eoi.Plant") -> str:
    shares = [force_error(plant, case.held_out[0], held) for held in (False, True)]
    return (
        "Force error of the last model on the held-out record, as the source takes it and with the "
        f"force held between samples: {100 * shares[0]:.2f}, {100 * shares[1]:.2f} %."
    )


def _scores(case: Case, plant: "eoi.Plant", result: Any) -> list[str]:
    """Error where it was fitted, on what is held out, and on what nothing ever saw."""
    fitted = "" if result is None else f"{case.scale * float(np.max(result.rmse)):.3g} {case.unit}"
    windows = eoi.validate(plant, case.held_out, window=case.window)
    others = [errors(case, eoi.validate(plant, one)) for one in case.untouched.values()]
    whole = errors(case, eoi.validate(plant, case.held_out))
    return [fitted, whole, errors(case, windows), *others]


if __name__ == "__main__":
    main()
