"""What a discovery found, as text: the answer in one sentence, then the numbers behind it."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from eoi_jax.discovery.acceptance import DENIED
from eoi_jax.discovery.confirm import only_short
from eoi_jax.discovery.result import Added, Discovery, Evidence, Lead, Texts
from eoi_jax.models.effects import INPUT_EFFECTS, AbstractInternalEffect
from eoi_jax.models.equations.display import equation_text
from eoi_jax.models.jacobians import input_slopes
from eoi_jax.models.plant import Plant
from eoi_jax.report.tables import columns, parameter_table, quantity, with_error
from eoi_jax.simulation.validate import Validation

_DRIFT = " (whole records drift away in free run)"
# So many of the candidates that were not added are shown.
_NEXT = 5


def discovery_text(discovery: Discovery) -> str:
    """The whole answer.

    Args:
        discovery: of `discover`.

    Returns:
        A sentence, then tables: parameters and errors before and after, what explains how much,
        what it might be instead, the equation, the next-best candidates, notes.
    """
    first = answer(discovery)
    blocks = [
        first,
        "" if str(discovery.status) in first else str(discovery.status),
        lead(discovery),
        change_table(discovery) if discovery.added else parameter_table(discovery.declared),
        error_table(discovery),
        _explained(discovery),
        *_equations(discovery),
        candidate_table(discovery),
        _findings(discovery),
        "\n".join(f"- {note}" for note in (*discovery.notes, *discovery.engine.notes)),
    ]
    return "\n\n".join(block for block in blocks if block)


def _findings(discovery: Discovery) -> str:
    """What the residual shows where no effect explains it."""
    if discovery.diagnosis is None:
        return ""
    found = [f"- {finding}" for finding in discovery.diagnosis.findings]
    return "\n".join(["The residual of the declared model:", *found])


def answer(discovery: Discovery) -> str:
    """What the model lacks, and the free-run error before and after, in one sentence."""
    lacking = _listed(_added_phrases(discovery))
    code = discovery.status.code
    if code == "nothing_missing":
        start = "The model lacks nothing that the records show"
    elif code == "unexplained" and lacking:
        start = f"The model lacks {lacking}, and something that no effect tried explains"
    elif code == "unexplained":
        start = "The model lacks something that no effect tried explains"
        start += " on all records" if DENIED in discovery.status.message else ""
    elif lacking:
        start = f"The model lacks {lacking}"
    else:
        return f"No answer: {discovery.status}"
    return f"{start}: {_free_run_errors(discovery)}."


def lead(discovery: Discovery) -> str:
    """What free runs say of the set that comes nearest to an answer, in one sentence; or ""."""
    if discovery.lead is None:
        return ""
    what = _listed(_lead_phrases(discovery))
    errors = _free_run_errors(_as_if_found(discovery, discovery.lead))
    return f"A lead, not an answer: with {what}, {errors}."


def texts(discovery: Discovery) -> Texts:
    """What takes the model to be said, for a file that cannot hold it.

    Args:
        discovery: with its model, or one that was loaded with such texts.
    """
    names, values = _equations(discovery)
    return Texts(
        added=_added_phrases(discovery),
        lead=_lead_phrases(discovery),
        equation=names,
        values=values,
        latex=discovery.latex,
    )


def _added_phrases(discovery: Discovery) -> tuple[str, ...]:
    if discovery.texts is not None:
        return discovery.texts.added
    return tuple(phrase(discovery, one) for one in discovery.added)


def _lead_phrases(discovery: Discovery) -> tuple[str, ...]:
    if discovery.texts is not None or discovery.lead is None:
        return discovery.texts.lead if discovery.texts else ()
    as_if = _as_if_found(discovery, discovery.lead)
    return tuple(phrase(as_if, one) for one in as_if.added)


def _as_if_found(discovery: Discovery, one: Lead) -> Discovery:
    """The lead in place of the answer."""
    return replace(
        discovery, added=one.added, found=one.found, plant=one.found.plant,
        after=one.after, windows_after=one.windows_after,
    )  # fmt: skip


def phrase(discovery: Discovery, added: Added) -> str:
    """One effect with its parameters: ``Coulomb (dry) friction of 20.42 ± 0.08 N``."""
    what, _, _ = added.effect.sentence.partition(":")
    inner = isinstance(added.effect, AbstractInternalEffect)
    channels = discovery.plant.inputs if _on_input(added) else discovery.plant.outputs
    where = f" at {_place(added)}" if len(channels) > 1 or inner else ""
    shown = []
    for (name, value), own in zip(added.parameters.items(), added.effect.parameters, strict=True):
        error = added.standard_errors.get(name, np.nan)
        unit = discovery.plant.units.get(name, "")
        if own.unit == "{f}" and not (_on_input(added) or added.through):
            value, error, unit = _as_input(discovery, added.output, value, error, unit)
        shown.append(
            (own.name, f"{with_error(value, error)} {'' if unit == '1' else unit}".strip())
        )
    if len(shown) == 1:
        return f"{what}{where} of {shown[0][1]}"
    return f"{what}{where} ({', '.join(f'{name} {text}' for name, text in shown)})"


def _place(one: Added | Evidence) -> str:
    beside = f" beside {one.through}" if one.through else ""
    return f"{one.output} towards {one.against}" if one.against else f"{one.output}{beside}"


def change_table(discovery: Discovery) -> str:
    """Parameters with standard errors before and after the effects were added."""
    return columns(change_rows(discovery), "<>>>>><")


def change_rows(discovery: Discovery) -> list[tuple[str, ...]]:
    """The cells of `change_table`, the header first."""
    before, after = discovery.declared, discovery.found
    rows = [("parameter", "nominal", "before", "± std. error", "after", "± std. error", "unit")]
    nominal, units = before.nominal.parameters, discovery.plant.units
    for name, value in after.parameters.items():
        old = before.parameters.get(name)
        rows.append(
            (
                name,
                f"{nominal[name]:.6g}" if name in nominal else "-",
                "-" if old is None else f"{old:.6g}",
                "-" if old is None else _error(before, name),
                f"{value:.6g}",
                _error(after, name),
                units.get(name, ""),
            )
        )
    return rows


def error_table(discovery: Discovery) -> str:
    """Free-run errors and the index, before and after."""
    rows = error_rows(discovery)
    return columns(rows, "<>>><" if discovery.added else "<><")


def error_rows(discovery: Discovery) -> list[tuple[str, ...]]:
    """The cells of `error_table`, the header first."""
    data = "in-sample" if discovery.in_sample else "held-out"
    rows: list[tuple[str, ...]] = [("", "before", "after", "after/before", "unit")]
    runs = (
        ("", discovery.before, discovery.after),
        (" in windows", discovery.windows_before, discovery.windows_after),
    )
    for how, before, after in runs:
        if before is None or after is None:
            continue
        for j, output in enumerate(before.outputs):
            key, unit = f"{output}{how}", before.units[j]
            rows.append(_row(f"{data} RMSE of {key}", before.rmse[j], after.rmse[j], unit))
            fits = (f"{value:.2f}" for value in (before.fit[j], after.fit[j]))
            rows.append((f"{data} fit of {key}", *fits, "", "%"))
    one, other = discovery.declared, discovery.found
    for j, output in enumerate(one.plant.outputs):
        before, after = one.index[one.best_pass, j], other.index[other.best_pass, j]
        rows.append(_row(f"index P of {output}", before, after, ""))
    if not discovery.added:  # both are the declared model's
        rows = [(name, value, unit) for name, value, _, _, unit in rows]
        return [("", "declared", "unit"), *rows[1:]]
    return rows


def candidate_table(discovery: Discovery) -> str:
    """The best candidates that were not added, with the reason; empty if there are none."""
    rows = candidate_rows(discovery)[: 1 + _NEXT]
    return columns(rows, "<<>><") if rows else ""


def candidate_rows(discovery: Discovery) -> list[tuple[str, ...]]:
    """The cells of a table of all candidates that were not added, the header first; or none."""
    added = {(one.effect.name, _place(one)) for one in discovery.added}
    others = [one for one in discovery.ranking if (one.effect, _place(one)) not in added]
    rows = [("other candidate", "at", "explains alone", "score", "")] if others else []
    for one in others:
        share = f"{100 * one.explained:.3g} %"
        score = f"{one.score:.4g}" if np.isfinite(one.score) else "-"
        rows.append((one.effect, _place(one), share, score, one.remark))
    return rows


def _explained(discovery: Discovery) -> str:
    lines = []
    if discovery.explained > 0.0:  # zero where only free runs show what was added
        share = f"{100 * discovery.explained:.3g} %"
        lines.append(f"Of the residual's power above the noise the effects explain {share}.")
    if discovery.ambiguous_with:
        others = _listed([name.replace("_", " ") for name in discovery.ambiguous_with])
        lines.append(f"These records do not tell it from {others}.")
    return "\n".join(filter(None, [*lines, discovery.advice]))


def _equations(discovery: Discovery) -> tuple[str, str]:
    """With names, and with values."""
    if discovery.texts is not None:
        return discovery.texts.equation, discovery.texts.values
    declared, added = discovery.declared_part, discovery.added
    return equation_text(declared, added), equation_text(declared, added, numeric=True)


# -- pieces -----------------------------------------------------------------------------------


def _on_input(added: Added) -> bool:
    return isinstance(added.effect, INPUT_EFFECTS)


def _listed(parts: Sequence[str]) -> str:
    """``a, b and c``."""
    return " and ".join(filter(None, [", ".join(parts[:-1]), *parts[-1:]]))


def _error(result: Any, name: str) -> str:
    if name in result.plant.fixed:
        return "fixed"
    return f"{result.standard_errors.get(name, np.nan):.2g}"


def _row(name: str, before: float, after: float, unit: str) -> tuple[str, ...]:
    good = np.isfinite(before) and np.isfinite(after) and before > 0
    ratio = f"{after / before:.3g}" if good else ""
    shown = (f"{value:.4g}" if np.isfinite(value) else "diverges" for value in (before, after))
    return (name, *shown, ratio, unit)


def told_runs(discovery: Discovery) -> tuple[Validation | None, Validation | None, bool]:
    """Free runs of which the answer speaks, before and after, and whether they are short ones."""
    whole = discovery.before, discovery.after
    short = discovery.windows_before, discovery.windows_after
    if whole[0] is None or whole[1] is None:
        return None, None, False
    if only_short((whole[0], short[0]), (whole[1], short[1])):
        return *short, True
    return *whole, False


def _free_run_errors(discovery: Discovery) -> str:
    """``free-run error on held-out data 95.9 mm before, 6.4 mm after``."""
    before, after, short = told_runs(discovery)
    if before is None or after is None:
        return "no free run was possible"
    data = "the same data (none was held out)" if discovery.in_sample else "held-out data"
    parts = []
    for j, output in enumerate(before.outputs):
        whose = f" of {output}" if len(before.outputs) > 1 else ""
        old, new = (
            quantity(one.rmse[j], one.units[j]) if np.isfinite(one.rmse[j]) else "without bound"
            for one in (before, after)
        )
        parts.append(f"{old}{whose} before, {new} after" if discovery.added else f"{old}{whose}")
    where, rest = (" in windows", _DRIFT) if short else ("", "")
    return f"free-run error on {data}{where} {'; '.join(parts)}{rest}"


def _as_input(
    discovery: Discovery, output: str, value: float, error: float, unit: str
) -> tuple[float, float, str]:
    """An acceleration as the force that makes it, where the model says how: f = … + u/m."""
    plant: Plant = discovery.declared.nominal
    gain = _input_gain(plant, discovery.found.parameters, plant.outputs.index(output))
    drive = plant.units.get(plant.inputs[0], "") if plant.inputs else ""
    # A gain in units of its own (rad/s² per volt) says nothing about forces.
    if gain is None or drive not in ("N", "N m", "Nm", "N·m"):
        return value, error, unit
    return value / gain, error / abs(gain), drive


def _input_gain(plant: Plant, parameters: dict[str, float], output: int) -> float | None:
    """∂f/∂u of a single input, where it is one number everywhere; None where it is not."""
    if len(plant.inputs) != 1 or plant.internal is not None:
        return None
    estimate = plant.with_parameters({name: parameters[name] for name in plant.names})
    draw = np.random.default_rng(0)
    shape = (plant.relative_degree, len(plant.outputs))
    points = [(draw.uniform(0.1, 1.0, shape), draw.uniform(-1, 1, 1)) for _ in range(3)]
    y, u = (np.stack(one) for one in zip(*points, strict=True))
    gains = input_slopes(estimate, np.zeros(3), y, u, 0)[:, output].tolist()
    same = np.ptp(gains) <= 1e-9 * abs(gains[0]) and gains[0] != 0.0
    return gains[0] if same else None
