"""Situations of users of other tools, rebuilt: does the command serve them?

Each is a record and a config as a person would bring them, from a public question that its source
names. The data are simulated here; the thread gives only the situation.

    python benchmarks/situations/situations.py [--quick] [--write] [--only NAME …] [--check]

`--check` fits each situation with SciPy, without the library: is the truth determined by the data?
"""

import argparse
import os
import sys
import tomllib
from collections import Counter
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import eoi_jax as eoi
from benchmarks import common
from benchmarks.situations import (
    chemistry,
    drives,
    electrics,
    fluids,
    judge,
    mechanics,
    thermal,
    vehicles,
)
from benchmarks.situations.situation import Situation

ALL: tuple[Situation, ...] = (
    *mechanics.SITUATIONS,
    *drives.SITUATIONS,
    *vehicles.SITUATIONS,
    *electrics.SITUATIONS,
    *thermal.SITUATIONS,
    *chemistry.SITUATIONS,
    *fluids.SITUATIONS,
)
QUICK = ("bursts", "mass_from_force", "trials")
ASKED = 0.95  # share to be served: 38 of 40


def main() -> None:
    """Run the situations and write the result."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a few cheap situations")
    parser.add_argument("--write", action="store_true", help="update the result file")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="these situations")
    parser.add_argument("--check", action="store_true", help="independent fits, no command")
    options = parser.parse_args()
    eoi.configure()
    names = options.only or (QUICK if options.quick else None)
    chosen = [situation for situation in ALL if names is None or situation.name in names]
    if options.check:
        sys.exit(sum(not _checked(situation) for situation in chosen) > 0)
    _report(chosen, options.write)


def _report(chosen: list[Situation], write: bool) -> None:
    report = common.Report("Situations of users")
    rows, verdicts = [], []
    for number, situation in enumerate(chosen, 1):
        answer, verdict = judge.trial(situation)
        verdicts.append(verdict)
        served = "yes" if verdict.served else f"no: {verdict.reason}"
        row = (
            situation.name,
            situation.kind,
            situation.plant,
            situation.command,
            judge.question(situation),
            verdict.answer,
            served,
            f"{answer.seconds:.0f} s",
        )
        rows.append([cell.replace("|", "/").replace("\n", " ") for cell in row])
        print(f"{number}/{len(chosen)} {situation.name}: {served}", file=sys.stderr, flush=True)
    total = sum(verdict.served for verdict in verdicts)
    report.add(
        f"Served: {total} of {len(chosen)}; asked: {100 * ASKED:.0f} %. Time: of the processor, "
        f"one process each. Load of the machine at the end: {os.getloadavg()[0]:.1f}.",
        common.table(
            ("situation", "kind", "plant", "command", "asked", "got", "served", "time"), rows
        ),
        "Not served, by reason: "
        + (
            ", ".join(
                f"{reason} {count}"
                for reason, count in Counter(
                    verdict.reason.split(":")[0].split(" of ")[0]
                    for verdict in verdicts
                    if not verdict.served
                ).most_common()
            )
            or "none"
        )
        + ".",
    )
    report.close(__file__, write)


# -- is the truth determined by the data? ------------------------------------------------------


STARTS = (1.12, 0.9, 1.05, 1.02)  # over the truth, one after the other until the noise is reached
REACHED = 1.2  # mean square of the residual over the noise's


def _checked(situation: Situation) -> bool:
    """Whether a fit of SciPy from a wrong start finds the truth in the noisy files."""
    if situation.refusal:
        print(f"{situation.name}: to be refused", flush=True)
        return True
    fits = []
    for factor in STARTS:
        fits.append(independent_fit(situation, factor))
        if fits[-1][2] <= REACHED:
            break
    found, errors, level = min(fits, key=lambda fit: fit[2])
    faults = [] if level <= REACHED else [f"residual {level:.3g} × noise"]
    for name, right in situation.truth.items():
        value = judge.evaluated(name, found)
        if value is None or not abs(value - right) <= situation.tolerance * abs(right):
            faults.append(f"{name} {value}")
    sizes = ", ".join(f"{name} {100 * error:.2g} %" for name, error in errors.items())
    print(
        f"{situation.name}: {'; '.join(faults) or 'found'} (standard errors: {sizes})", flush=True
    )
    return not faults


def independent_fit(
    situation: Situation, factor: float
) -> tuple[dict[str, float], dict[str, float], float]:
    """Estimates of all that is open, their relative standard errors, and the residual's level.

    Args:
        situation: whose files are fitted; held-out files are not used.
        factor: start over the truth.
    """
    measured = situation.tables(np.random.default_rng(judge.SEED))
    names = situation.fitted or tuple(situation.parameters)
    start = {name: value * factor for name, value in situation.parameters.items() if name in names}

    def residuals(logs: np.ndarray) -> np.ndarray:
        trial = {name: start[name] * np.exp(x - 1) for name, x in zip(names, logs, strict=True)}
        simulated = situation.simulate({**situation.parameters, **trial})
        parts = []
        for file, table in measured.items():
            if file.startswith("test"):
                continue
            for column in _outputs(situation):
                values = table[column].to_numpy(float)
                model = simulated[file][column].reindex(table.index).to_numpy(float)
                valid = np.isfinite(values)
                parts.append((model - values)[valid] / situation.level(column))
        return np.concatenate(parts)

    # the variables start at one: SciPy's steps are relative to them
    fit = least_squares(residuals, np.ones(len(names)), x_scale="jac", diff_step=1e-5)
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac)
    estimates = {name: start[name] * np.exp(x - 1) for name, x in zip(names, fit.x, strict=True)}
    errors = dict(zip(names, np.sqrt(np.diag(covariance)), strict=True))
    return {**situation.parameters, **estimates}, errors, 2 * fit.cost / len(fit.fun)


def _outputs(situation: Situation) -> list[str]:
    """Measured columns: those with noise or rounding that are no inputs of the config."""
    inputs = set(tomllib.loads(situation.config)["data"]["inputs"])
    return [name for name in {**situation.noise, **situation.step} if name not in inputs]


if __name__ == "__main__":
    main()
