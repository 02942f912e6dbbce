"""The same plant, its equation written in six ways: is the answer the same?

    python benchmarks/truth/equation_forms.py [--quick] [--write]

Random masses, pendulums, stages with dry friction, tanks, lags and plants of two outputs, half of
them with an effect that the model lacks (`form_cases`). Each is identified and searched as it is
affine in its parameters, and in five other forms: scaled, as forces over a mass of which one
parameter is known, with sums of parameters, products, and reciprocals; as a Python function or as
text. Nominal values are off by a factor of up to two, physically the same in each form.
"""

import sys
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks.common import Report, arguments, percent, table
from benchmarks.truth.form_cases import NOISE, SAMPLES, Case, Form, Values, cases, forms

SEED = 32
TOLERANCE = 0.5  # of a standard error of the affine form
RELATIVE = 1e-6  # or this share of the parameter
SHARE_HELD_OUT = 0.3


@dataclass(frozen=True)
class Answer:
    """What a form answered.

    Attributes:
        coefficients, errors: of the affine form, by name.
        status: of `identify`.
        effects: of `discover`; its status where it names none.
        seconds: of both.
    """

    coefficients: Values
    errors: Values
    status: str
    effects: tuple[str, ...]
    seconds: float


def plant(case: Case, form: Form, as_text: bool) -> eoi.Plant:
    """The model as a user writes it."""
    bounds = {name: (0.0, np.inf) for name in form.parameters if name not in form.signed}
    bounds = bounds if case.bounded else {}
    write = _text if as_text else _function
    return write(case, form, bounds)


def _text(case: Case, form: Form, bounds: dict) -> eoi.Plant:
    names = {name: name for name in form.parameters}
    outputs = case.kind.outputs
    if len(outputs) == 1:
        y = outputs[0]
        lines = [_renamed(form.equations[0].format(**names), {"y": y})]
    else:
        lines = [line.format(**names) for line in form.equations]
    derivatives = dict(zip(outputs, lines, strict=True))
    if case.kind.degree == 2:
        derivatives = {outputs[0]: "v", "v": lines[0]}
    return eoi.plant_from_text(
        derivatives, form.parameters, outputs, ["u"], bounds=bounds, fixed=form.fixed
    )


def _renamed(text: str, names: Mapping[str, str]) -> str:
    """Whole words replaced."""
    words = "".join(letter if letter.isalnum() else f"\0{letter}\0" for letter in text)
    return "".join(names.get(word, word) for word in words.split("\0"))


def _function(case: Case, form: Form, bounds: dict) -> eoi.Plant:
    lines = [line.format(**{name: f"p.{name}" for name in form.parameters})
             for line in form.equations]  # fmt: skip
    code = compile(f"stack([{', '.join(lines)}])", form.name, "eval")
    functions = {"sin": jnp.sin, "sqrt": lambda x: jnp.sqrt(jnp.maximum(x, 0.0)),
                 "sign": jnp.sign, "stack": jnp.stack}  # fmt: skip
    degree, outputs = case.kind.degree, case.kind.outputs

    def dynamics(t: Any, x: Any, u: Any, p: Any) -> Any:
        del t
        names = {"y": x.y[0, 0], "u": u[0], "p": p, "v": x.y[degree - 1, 0]}
        names |= {name: x.y[0, j] for j, name in enumerate(outputs)}
        return eval(code, functions | names)

    return eoi.Plant(dynamics, form.parameters, degree, ("u",), outputs, bounds=bounds,
                     fixed=form.fixed)  # fmt: skip


def answered(case: Case, form: Form, as_text: bool) -> Answer:
    """Identified and searched."""
    model = plant(case, form, as_text)
    record = eoi.Record(case.time, case.inputs, case.outputs, "run", hold="zero")
    started = time.perf_counter()
    fit = eoi.identify(model, record)
    discovery = eoi.discover(model, record, SHARE_HELD_OUT)
    seconds = time.perf_counter() - started
    coefficients, errors = moved(form, fit)
    effects = tuple(sorted(discovery.effects)) or (discovery.status.code,)
    return Answer(coefficients, errors, str(fit.status), effects, seconds)


def moved(form: Form, fit: eoi.Identification) -> tuple[Values, Values]:
    """Coefficients of the affine form with their errors, by central differences."""
    values = fit.parameters
    center = form.to_affine(values)
    slopes = []
    for name, value in values.items():
        step = 1e-6 * abs(value) or 1e-9
        above = form.to_affine({**values, name: value + step})
        below = form.to_affine({**values, name: value - step})
        slopes.append([(above[key] - below[key]) / (2 * step) for key in center])
    slope = np.asarray(slopes).T
    variance = np.diagonal(slope @ np.asarray(fit.covariance) @ slope.T)
    return center, dict(zip(center, np.sqrt(variance).tolist(), strict=True))


def distance(reference: Answer, other: Answer) -> float:
    """Largest difference of a coefficient in standard errors; 0 where it is relatively tiny."""
    worst = 0.0
    for name, value in reference.coefficients.items():
        difference = abs(other.coefficients[name] - value)
        if not difference <= RELATIVE * abs(value):
            error = reference.errors[name]
            worst = max(worst, difference / error if error > 0 else np.inf)
            worst = np.inf if np.isnan(difference) else worst
    return worst


def main() -> None:
    """One row for each form, then what differs."""
    options = arguments(__doc__)
    warnings.simplefilter("ignore")
    count = 6 if options.quick else 50
    report = Report("Forms of an equation")
    report.add(
        f"{count} plants, records of {SAMPLES} samples, noise {NOISE:g} of each output's spread; "
        f"the last {SHARE_HELD_OUT:.0%} of a record are held out in `discover`. *Same estimate*: "
        f"every coefficient within {TOLERANCE:g} of its standard error of the affine form's, or "
        f"within {RELATIVE:g} of its value. *Same errors*: standard errors within 10 %. "
        "*Right*: the hidden effect alone is named, or nothing where none is hidden."
    )
    rows, misses = {}, []
    for i, case in enumerate(cases(count, SEED)):
        reference = None
        for j, form in enumerate(forms(case, [SEED, i])):
            as_text = bool((i + j) % 2)
            answer = answered(case, form, as_text)
            reference = reference or answer
            ratio = [answer.errors[name] / reference.errors[name] for name in reference.errors]
            away = distance(reference, answer)
            right = answer.effects == ((case.hidden,) if case.hidden else ("nothing_missing",))
            same = away <= TOLERANCE, answer.effects == reference.effects
            near = bool(np.all(np.abs(np.log(ratio)) < 0.1))
            rows.setdefault(form.name, []).append((*same, near, right, away, answer.seconds))
            if not (all(same) and near):
                misses.append(
                    [i, case.kind.name, case.hidden or "-", form.name,
                     "text" if as_text else "Python", "yes" if case.bounded else "no",
                     f"{away:.2g}", f"{min(ratio):.2g} to {max(ratio):.2g}",
                     ", ".join(answer.effects), ", ".join(reference.effects),
                     answer.status.split(":")[0]]
                )  # fmt: skip
                print(misses[-1], flush=True)
    lines, total = [], np.zeros(3, int)
    for name, results in rows.items():
        same, effects, near, right, away, seconds = (
            np.asarray(part) for part in zip(*results, strict=True)
        )
        if name != "affine":
            total += [np.sum(same & effects), np.sum(same), len(same)]
        lines.append(
            [name, len(same), int(np.sum(same)), int(np.sum(effects)), int(np.sum(same & effects)),
             int(np.sum(near)), int(np.sum(right)), f"{np.max(away):.2g}",
             f"{np.median(seconds):.1f} s"]
        )  # fmt: skip
    header = ["form", "plants", "same estimate", "same effects", "both", "same errors", "right",
              "largest difference [errors]", "time, median"]  # fmt: skip
    report.add(table(header, lines))
    report.add(
        f"Same estimate and effects: {total[0]} of {total[2]}, {percent(total[0] / total[2])}."
    )
    if misses:
        header = ["plant", "kind", "hides", "form", "written in", "bounds", "difference [errors]",
                  "errors over the affine ones", "effects", "affine", "status"]  # fmt: skip
        report.add("## What differs", table(header, misses))
    report.close(__file__, options.write)


if __name__ == "__main__":
    main()
