"""Inputs with next to no influence, and inputs that count in the other direction: by free runs."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from eoi_jax.data.holds import moves, with_hold
from eoi_jax.data.record import Record
from eoi_jax.discovery.judge import error_ratio
from eoi_jax.discovery.remarks import FitNote
from eoi_jax.discovery.result import Discovery
from eoi_jax.discovery.rules import RULES
from eoi_jax.models.plant import Plant
from eoi_jax.models.used_inputs import used_inputs
from eoi_jax.refinement.refine import refine_once
from eoi_jax.simulation.validate import runs_in

_RULES = RULES.questions


def input_notes(discovery: Discovery, records: Sequence[Record]) -> list[str]:
    """A note on each input that counts in the other direction, and on those without influence.

    A heater that is not connected, or a column of another record: parameters then run to where such
    an input does nothing, and the other ones follow them. So they do, up to their bounds, with an
    input of the wrong sign.

    Args:
        discovery: the answer.
        records: of the fit, as given.
    """
    used = np.flatnonzero(np.any(used_inputs(discovery.plant), axis=0)).tolist()
    inputs = [j for j in used if any(moves(record, j) for record in discovery.held_out)]
    if not inputs or discovery.after is None:
        return []
    if _on_bound(discovery.declared.plant):
        notes = [note for j in inputs for note in _reversed_notes(discovery, records, j)]
        if notes:
            return notes
    return _influence_notes(discovery, inputs)


def _on_bound(plant: Plant) -> bool:
    """Whether a free parameter is on a bound of its own."""
    limits = zip(plant.names, plant.theta, plant.lower, plant.upper, strict=True)
    return any(name not in plant.fixed and value in (low, high)
               for name, value, low, high in limits)  # fmt: skip


def _reversed_notes(discovery: Discovery, records: Sequence[Record], j: int) -> list[str]:
    """Where the declared model with an input in the other direction predicts far better."""
    runs, judging, nominal = (discovery.windows_after or discovery.after, discovery.held_out,
                              discovery.declared.nominal)  # fmt: skip
    assert runs is not None
    made_alike = with_hold(tuple(records), judging[0].hold, judging[0].skew)
    fitted, judged = (
        tuple(_with_input(record, j, -record.inputs[:, j]) for record in group)
        for group in (made_alike, judging)
    )
    fit = refine_once(nominal, fitted, runs.window)
    if not fit.status.fits or _on_bound(fit.plant):
        return []
    ratio = error_ratio(runs_in(runs.window, fit.plant, judged), runs)
    if not ratio < RULES.answer.confirmed:
        return []
    return [FitNote(_REVERSED.format(nominal.inputs[j], ratio))]


def _influence_notes(discovery: Discovery, inputs: Sequence[int]) -> list[str]:
    """A note on each input without which free runs of the answer miss the records hardly more.

    Runs that say nothing of the records tell nothing of inputs either.
    """
    long_runs, plant, records = discovery.after, discovery.plant, discovery.held_out
    if long_runs is None or not np.all(long_runs.nrmse < _RULES.follows):
        return []
    window, substeps = long_runs.window, long_runs.substeps
    runs = runs_in(window, plant, records, substeps)
    notes = []
    for j in inputs:
        replaced = [
            _with_input(record, j, np.mean(record.inputs[record.input_valid, j]))
            for record in records
        ]
        trial = runs_in(window, plant, replaced, substeps)
        if (ratio := error_ratio(trial, runs)) < _RULES.no_influence:
            notes.append(FitNote(_NO_INFLUENCE.format(plant.inputs[j], ratio)))
    return notes


def _with_input(record: Record, j: int, values: Float[np.ndarray, " time"] | np.floating) -> Record:
    """The record with other values of an input: of each sample, or one for all."""
    inputs = record.inputs.copy()
    inputs[:, j] = values
    return record.with_inputs(inputs, record.input_names, record.skew, record.hold)


_NO_INFLUENCE = (
    "the records show next to no influence of {}: with its mean in its place free runs have {:.3g} "
    "times the error; check that it acts on the plant, and that it is the right column"
)
_REVERSED = (
    "{0} seems to count in the other direction: with its sign changed no parameter of the declared "
    "model is on its bound, and free runs have {1:.2g} of the error; check the sign of {0} in the "
    "equations and in its column"
)
