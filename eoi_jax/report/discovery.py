"""A discovery as text: the answer in one sentence, then the numbers behind it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eoi_jax.data.clipping import AT_END
from eoi_jax.discovery.confirm import drifts, only_short
from eoi_jax.discovery.remarks import RecordNote
from eoi_jax.discovery.result import Added, Discovery, PartialExplanation, Rival, Texts
from eoi_jax.estimation.degrees_of_freedom import freedom_notes
from eoi_jax.models.effects import (
    INPUT_EFFECTS,
    AbstractInternalEffect,
    Curve,
    FreePlay,
    InputCurve,
    LinearStiffness,
    ParameterDependence,
)
from eoi_jax.models.effects.effect import labelled
from eoi_jax.models.equations.display import equation_text
from eoi_jax.models.input_strength import InputStrength, strengths_of
from eoi_jax.report.diagnosis import saturation
from eoi_jax.report.tables import columns, error_text, parameter_table, quantity, with_error
from eoi_jax.simulation.validation import Validation
from eoi_jax.uncertainty.uncertainty import uncertainty

_STOPS = "a spring that acts beyond a gap only, as stops at both ends do"
_FORCES = ("N", "N m", "Nm", "N·m")
_CLIPPED = f"First look at the notes: an output stays at {AT_END}, which may be all there is."
_DRIFT = " (over {} the free run drifts)"


def discovery_text(discovery: Discovery) -> str:
    """A discovery as text.

    Args:
        discovery: of `discover`.

    Returns:
        The answer in a sentence, then parameters and errors before and after, the explained share,
        equally supported alternatives, the equation, the next-best candidates, and notes.
    """
    sentence = answer(discovery)
    notes = *freedom_notes(discovery.found), *discovery.notes, *discovery.engine.notes
    blocks = [
        sentence,
        "" if str(discovery.status) in sentence else str(discovery.status),
        lead(discovery),
        change_table(discovery) if discovery.changed else parameter_table(discovery.declared),
        *(columns(rows, ">>>") for rows in curve_rows(discovery)),
        "\n".join(_strength_lines(discovery)),
        error_table(discovery),
        _explained(discovery),
        probability_table(discovery),
        *_equations(discovery),
        candidate_table(discovery),
        _findings(discovery),
        "\n".join(f"- {note}" for note in notes),
    ]
    return "\n\n".join(block for block in blocks if block)


def _findings(discovery: Discovery) -> str:
    """Findings about the residual where no effect explains it, without what notes say anyway."""
    diagnosis = discovery.diagnosis
    if diagnosis is None:
        return ""
    notes = [note for note in discovery.notes if AT_END in note]
    ends = [end for end in diagnosis.saturation
            if any(note.startswith(f"{end.record}: {end.channel} ") for note in notes)]  # fmt: skip
    repeated = [*saturation(replace(diagnosis, saturation=tuple(ends)))]
    findings = [f"- {finding}" for finding in diagnosis.findings if finding not in repeated]
    return "\n".join(["The residual of the declared model:", *findings])


def answer(discovery: Discovery) -> str:
    """What the model lacks, and the free-run error before and after, in one sentence.

    Before it, what no record tells apart.
    """
    return "".join(f"{text}. " for text in _held_factors(discovery)) + _lacking(discovery)


def _held_factors(discovery: Discovery) -> list[str]:
    """A sentence for each common factor, with the value at which a parameter of it was held."""
    plant = discovery.declared.nominal
    sentences = []
    for factor in discovery.common_factors:
        held = _joined([f"{name} was held at {plant.parameters[name]:g}" for name in factor.fix
                        if name in plant.fixed])  # fmt: skip
        sentences.append(factor.sentence + (f"; here {held}" if held else ""))
    return sentences


def _lacking(discovery: Discovery) -> str:
    phrases = _joined(_added_phrases(discovery))
    lacking = f"lacks {phrases}".replace("lacks possibly", "possibly lacks", 1) if phrases else ""
    code = discovery.status.code
    if code == "nothing_missing":
        start = "The model lacks nothing that the records show"
    elif code == "partial":
        start = f"The model {lacking}, and something that is left"
    elif any(isinstance(note, RecordNote) for note in discovery.notes):
        start = "The model lacks what makes the records ask for different parameters"
    elif code == "unexplained" and lacking:
        start = f"The model {lacking}, and something that none of the tested effects explains"
    elif code == "unexplained" and discovery.in_sample and not discovery.ranking:
        start = "The model lacks something, and no effect was tried"
    elif code == "unexplained":
        start = "The model lacks something that none of the tested effects explains"
        start += " on all records" if discovery.denied else ""
    elif lacking:
        start = f"The model {lacking}"
    else:
        return f"No answer: {discovery.status}"
    errors = f"{start}: {_free_run_errors(discovery)}."
    is_open = code in ("partial", "unexplained")
    is_clipped = is_open and any(AT_END in note for note in discovery.notes)
    return f"{errors} {_CLIPPED}" if is_clipped else errors


def lead(discovery: Discovery) -> str:
    """The free-run errors with the best set of effects that is no answer, in a sentence; or ""."""
    if discovery.lead is None:
        return ""
    effects = _joined(_lead_phrases(discovery))
    errors = _free_run_errors(_with_lead(discovery, discovery.lead))
    return f"Best partial explanation, not an answer: with {effects}, {errors}."


def texts(discovery: Discovery) -> Texts:
    """Texts that need the model, for a file that cannot hold it.

    Args:
        discovery: with its model, or loaded with these texts.
    """
    names, values = _equations(discovery)
    return Texts(
        added=_added_phrases(discovery),
        lead=_lead_phrases(discovery),
        equation=names,
        values=values,
        latex=discovery.latex,
        at_input=_strength_lines(discovery),
    )


def _added_phrases(discovery: Discovery) -> tuple[str, ...]:
    if discovery.texts is not None:
        return discovery.texts.added
    ordered = sorted(_with_stops(discovery.added), key=lambda added: added.is_doubtful)
    return tuple(
        f"{possibly(added, phrase(discovery, added))}{_alternatives(added)}" for added in ordered
    )


def _with_stops(added: Sequence[Added]) -> list[Added]:
    """Effects as they are told: a spring that a gap takes away again goes with the gap.

    Both together do nothing inside of it, and hold beyond: stops at both ends, or a spring with
    free play. Alone such a spring would seem to act everywhere.
    """
    listed = list(added)
    for spring in [item for item in added if isinstance(item.effect, LinearStiffness)]:
        for play in [item for item in added if isinstance(item.effect, FreePlay)]:
            pair = spring, play
            first, second = (next(iter(item.parameters.values())) for item in pair)
            errors = [next(iter(item.standard_errors.values())) for item in pair]
            is_taken = abs(first - second) <= np.linalg.norm(errors)
            if is_taken and spring.position == play.position:
                listed.remove(spring)
                listed[listed.index(play)] = replace(play, sentence=_STOPS)
    return listed


def possibly(added: Added, text: str) -> str:
    """A text on an effect; of one that is less probable than not: ``possibly a leak (48.3 %)``.

    Behind rivals that are more probable.
    """
    if not added.is_doubtful:
        return text
    assert added.probability is not None
    likelier = "".join(
        f"{_in_words(rival)} ({_chance(rival.probability)}) or " for rival in added.likelier
    )
    return f"possibly {likelier}{text} ({_chance(added.probability)})"


def _alternatives(added: Added) -> str:
    """Rivals of an effect that are nearly as probable, to be named behind it."""
    rivals = [rival for rival in added.alternatives if rival not in added.likelier]
    return "".join(f" or {_in_words(rival)}" for rival in rivals)


def _in_words(rival: Rival) -> str:
    return rival.label.replace("_", " ")


def _lead_phrases(discovery: Discovery) -> tuple[str, ...]:
    if discovery.texts is not None or discovery.lead is None:
        return discovery.texts.lead if discovery.texts else ()
    alternative = _with_lead(discovery, discovery.lead)
    return tuple(phrase(alternative, added) for added in alternative.added)


def _with_lead(discovery: Discovery, partial: PartialExplanation) -> Discovery:
    """The discovery with its lead in place of the answer."""
    return replace(
        discovery, added=partial.added, found=partial.found, plant=partial.found.plant,
        after=partial.after, windows_after=partial.windows_after,
    )  # fmt: skip


def phrase(discovery: Discovery, added: Added) -> str:
    """One effect with its parameters: ``Coulomb (dry) friction of 20.42 ± 0.08 N``."""
    name_and_place = described(discovery, added)
    at_inputs, values = strengths(discovery), []
    for (name, value), parameter in zip(
        added.parameters.items(), added.effect.parameters, strict=True
    ):
        error = added.standard_errors.get(name, np.nan)
        unit = discovery.plant.units.get(name, "")
        text = f"{with_error(value, error)} {'' if unit == '1' else unit}".strip()
        if name in at_inputs and at_inputs[name][0].unit:
            strength, *at_input = at_inputs[name]
            quantity_text = f"{with_error(*at_input)} {strength.unit}"
            # An acceleration is told as the force that causes it.
            is_force = strength.unit in _FORCES
            text = quantity_text if is_force else f"{text} ({quantity_text} at the input)"
        if not error > 0 and value in (parameter.lower, parameter.upper):
            text += ", its bound"  # which has no standard error
        values.append((parameter.name, text))
    if isinstance(added.effect, Curve | InputCurve) or not values:
        return name_and_place
    if isinstance(added.effect, ParameterDependence):
        return f"{name_and_place} of {values[0][1]}: {added.effect.law(value)}"
    if len(values) == 1:
        return f"{name_and_place} of {values[0][1]}"
    return f"{name_and_place} ({', '.join(f'{name} {text}' for name, text in values)})"


def described(discovery: Discovery, added: Added) -> str:
    """One effect in words, with what tells it apart from others: form and place."""
    description, _, _ = added.sentence.partition(":")
    # The sentence of a curve, and of a dependence, says its signal.
    with_signal = Curve | InputCurve | ParameterDependence
    form = "" if isinstance(added.effect, with_signal) else added.effect.form
    internal = isinstance(added.effect, AbstractInternalEffect)
    channels = discovery.plant.inputs if _acts_on_input(added) else discovery.plant.outputs
    needs_place = len(channels) > 1 or internal or added.against or added.through
    return labelled(description, form) + (f" at {added.position}" if needs_place else "")


def change_table(discovery: Discovery) -> str:
    """Parameters with standard errors before and after the effects were added."""
    return columns(change_rows(discovery), "<>>>>><")


def strengths(discovery: Discovery) -> dict[str, tuple[InputStrength, float, float]]:
    """Parameters of the effects in the unit of the input: where, value and standard error."""
    outputs, model = discovery.plant.outputs, discovery.declared_part
    at_inputs = {}
    for added in discovery.added:
        on_output = not (_acts_on_input(added) or isinstance(added.effect, AbstractInternalEffect))
        if not on_output or added.through:
            continue
        names, output = list(added.parameters), outputs.index(added.output)
        for strength in strengths_of(model, added.effect, names, output):
            value = added.parameters[strength.parameter] * strength.factor
            error = added.standard_errors.get(strength.parameter, np.nan) * abs(strength.factor)
            at_inputs[strength.parameter] = strength, value, error
    return at_inputs


def _strength_lines(discovery: Discovery) -> tuple[str, ...]:
    """Strengths of the effects in the unit of the input, a line each."""
    if discovery.texts is not None:
        return discovery.texts.at_input
    return tuple(
        f"At the input {strength.input}: {name} {with_error(value, error)} {strength.unit}".rstrip()
        for name, (strength, value, error) in strengths(discovery).items()
    )


def change_rows(discovery: Discovery) -> list[tuple[str, ...]]:
    """The cells of `change_table`, the header first."""
    declared_fit, final_fit = discovery.declared, discovery.found
    rows = [("parameter", "nominal", "before", "± std. error", "after", "± std. error", "unit")]
    nominal, units = declared_fit.nominal.parameters, discovery.plant.units
    for name, value in final_fit.parameters.items():
        declared = declared_fit.parameters.get(name)
        rows.append(
            (
                name,
                f"{nominal[name]:.6g}" if name in nominal else "-",
                "-" if declared is None else f"{declared:.6g}",
                "-" if declared is None else error_text(declared_fit, name),
                f"{value:.6g}",
                error_text(final_fit, name),
                units.get(name, ""),
            )
        )
    return rows


def curve_rows(discovery: Discovery) -> list[list[tuple[str, ...]]]:
    """The cells of a table of the points of each curve that was added, the header first."""
    tables, names = [], list(discovery.found.plant.names)
    for added in discovery.added:
        if not isinstance(added.effect, Curve | InputCurve):
            continue
        certainty = uncertainty(discovery.found)
        parameters, knots = list(added.parameters.values()), np.array(added.effect.knots)
        units = np.eye(len(parameters))
        slopes = np.stack([added.effect.curve(knots, unit) for unit in units], axis=1)
        places = [names.index(name) for name in added.parameters]
        covariance = certainty.covariance[np.ix_(places, places)]
        errors = np.sqrt(np.einsum("ki,ij,kj->k", slopes, covariance, slopes))
        drive = added.through or (*discovery.plant.inputs, "u")[0]
        over = "" if isinstance(added.effect, InputCurve) else added.effect.over
        signal = {"v": f"{added.output}'", "u": drive}.get(over, added.output)
        points = zip(knots, slopes @ np.array(parameters), errors, strict=True)
        rows = [(signal, f"curve({signal})", "± std. error")]
        tables.append([*rows, *((f"{x:.6g}", f"{y:.6g}", f"{e:.2g}") for x, y, e in points)])
    return tables


def error_table(discovery: Discovery) -> str:
    """Free-run errors and the index, before and after."""
    rows = error_rows(discovery)
    return columns(rows, "<>>><" if discovery.changed else "<><")


def error_rows(discovery: Discovery) -> list[tuple[str, ...]]:
    """The cells of `error_table`, the header first."""
    chosen = "in-sample" if discovery.in_sample else "held-out"
    rows: list[tuple[str, ...]] = [("", "before", "after", "after/before", "unit")]
    windows, windowed = " in windows", discovery.test_windows_before
    runs = (
        (chosen, "", discovery.before, discovery.after),
        (chosen, windows, discovery.windows_before, discovery.windows_after),
        ("test", "", discovery.test_before, discovery.test_after),
        ("test", windows, windowed, discovery.test_windows_after),
    )
    for data, suffix, declared, augmented in runs:
        if declared is None or augmented is None:
            continue
        for j, output in enumerate(declared.outputs):
            key, unit = f"{output}{suffix or _extent(declared)}", declared.units[j]
            rows.append(_row(f"{data} RMSE of {key}", declared.rmse[j], augmented.rmse[j], unit))
            fits = (f"{value:.2f}" for value in (declared.fit[j], augmented.fit[j]))
            rows.append((f"{data} fit of {key}", *fits, "", "%"))
    results = (discovery.declared, discovery.found)
    for j, output in enumerate(discovery.declared.plant.outputs):
        initial, final = (fit.index[fit.best_pass, j] for fit in results)
        rows.append(_row(f"index P of {output}", initial, final, ""))
    if not discovery.changed:  # both columns are those of the declared model
        rows = [(name, value, unit) for name, value, _, _, unit in rows]
        return [("", "declared", "unit"), *rows[1:]]
    return rows


def probability_table(discovery: Discovery) -> str:
    """How probable each added effect is, with its rivals; empty if none was compared."""
    rows = probability_rows(discovery)
    if not any(row[-1] for row in rows[1:]):
        rows = [row[:-1] for row in rows]
    return columns(rows, ">" + "<" * (len(rows[0]) - 1)) if rows else ""


def probability_rows(discovery: Discovery) -> list[tuple[str, ...]]:
    """The cells of a table of added effects with their probabilities, the header first; or none."""
    rows = [
        (_chance(added.probability), added.label, added.position, _rivals(added))
        for added in discovery.added
        if added.probability is not None
    ]
    return [("probability", "added effect", "at", "else"), *rows] if rows else []


def _rivals(added: Added) -> str:
    return ", ".join(
        f"{rival.label} at {rival.position} {_chance(rival.probability)}" for rival in added.rivals
    )


def _chance(probability: float) -> str:
    """In percent; what is nearly certain is not written as certain."""
    if probability > 0.999:
        return "> 99.9 %"
    return f"{100 * probability:.3g} %"


def candidate_table(discovery: Discovery, count: int = 5) -> str:
    """The `count` best candidates that were not added, with the reason; empty if none was."""
    rows = candidate_rows(discovery)[: 1 + count]
    return columns(rows, "<<>><") if rows else ""


def candidate_rows(discovery: Discovery) -> list[tuple[str, ...]]:
    """The cells of a table of all candidates that were not added, the header first; or none."""
    added = {(addition.label, addition.position) for addition in discovery.added}
    # A file of an older version has no forms.
    added |= {(addition.effect.name, addition.position) for addition in discovery.added}
    candidates = [
        candidate
        for candidate in discovery.ranking
        if (candidate.label, candidate.position) not in added
    ]
    rows = [("other candidate", "at", "explains alone", "score", "")] if candidates else []
    for candidate in candidates:
        share = f"{100 * candidate.explained:.3g} %"
        score = f"{candidate.score:.4g}" if np.isfinite(candidate.score) else "-"
        rows.append((candidate.label, candidate.position, share, score, candidate.remark))
    return rows


def _explained(discovery: Discovery) -> str:
    lines = []
    if discovery.explained > 0.0:  # zero where only free runs justify the effects
        share = f"{100 * discovery.explained:.3g} %"
        lines.append(f"The effects explain {share} of the residual's power above the noise.")
    if discovery.ambiguous_with:
        alternatives = _joined([name.replace("_", " ") for name in discovery.ambiguous_with])
        lines.append(f"These records do not distinguish it from {alternatives}.")
    return "\n".join(filter(None, [*lines, discovery.advice]))


def _equations(discovery: Discovery) -> tuple[str, str]:
    """The equation with names, and with values."""
    if discovery.texts is not None:
        return discovery.texts.equation, discovery.texts.values
    declared, added = discovery.declared_part, discovery.added
    return equation_text(declared, added), equation_text(declared, added, numeric=True)


# -- pieces -----------------------------------------------------------------------------------


def _acts_on_input(added: Added) -> bool:
    return isinstance(added.effect, INPUT_EFFECTS)


def _joined(parts: Sequence[str]) -> str:
    """``a, b and c``."""
    return " and ".join(filter(None, [", ".join(parts[:-1]), *parts[-1:]]))


def _row(name: str, declared: float, augmented: float, unit: str) -> tuple[str, ...]:
    comparable = np.isfinite(declared) and np.isfinite(augmented) and declared > 0
    ratio = f"{augmented / declared:.3g}" if comparable else ""
    values = (
        f"{value:.4g}" if np.isfinite(value) else "diverges" for value in (declared, augmented)
    )
    return (name, *values, ratio, unit)


def compared_runs(discovery: Discovery) -> tuple[Validation | None, Validation | None, bool]:
    """Free runs that the answer compares, before and after, and whether they are over windows."""
    full = discovery.before, discovery.after
    windowed = discovery.windows_before, discovery.windows_after
    if full[0] is None or full[1] is None:
        return None, None, False
    if only_short((full[0], windowed[0]), (full[1], windowed[1])):
        return *windowed, True
    return *full, False


def _free_run_errors(discovery: Discovery) -> str:
    """``free-run error on held-out data 95.9 mm before, 6.4 mm after``."""
    declared, augmented, windowed = compared_runs(discovery)
    if declared is None or augmented is None:
        return "no free run was possible"
    data = "the same data (no data held out)" if discovery.in_sample else "held-out data"
    errors = _compared(declared, augmented, discovery.changed)
    extent = " in windows" if windowed else _extent(declared)
    first, last = discovery.test_before, discovery.test_after
    if windowed:
        first, last = discovery.test_windows_before, discovery.test_windows_after
    unseen = ""
    if first is not None and last is not None:
        unseen = f"; on test data{extent} {_compared(first, last, discovery.changed)}"
    drift = _drift(discovery.after, augmented) if windowed else ""
    return f"free-run error on {data}{extent} {errors}{unseen}{drift}"


def _drift(long_runs: Validation | None, windows: Validation) -> str:
    """A remark where long free runs of the answer leave the record, and those in windows do not."""
    if long_runs is None or not drifts(long_runs, windows):
        return ""
    return _DRIFT.format(_extent(long_runs).removeprefix(" in ") or "whole records")


def _extent(runs: Validation) -> str:
    """Length of long free runs that are no whole records, as those of an unstable plant."""
    return "" if runs.window is None else f" in windows of {runs.window:.3g} s"


def _compared(declared: Validation, augmented: Validation, changed: bool) -> str:
    """``95.9 mm before, 6.4 mm after``, for each output."""
    errors = []
    for j, output in enumerate(declared.outputs):
        suffix = f" of {output}" if len(declared.outputs) > 1 else ""
        declared_error, augmented_error = (
            quantity(run.rmse[j], run.units[j]) if np.isfinite(run.rmse[j]) else "unbounded"
            for run in (declared, augmented)
        )
        after = f" before, {augmented_error} after" if changed else ""
        errors.append(f"{declared_error}{suffix}{after}")
    return "; ".join(errors)
