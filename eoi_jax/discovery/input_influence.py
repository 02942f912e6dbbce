"""Inputs of which records show next to no influence: free runs with their means in their place."""

import numpy as np

from eoi_jax.data.holds import moves
from eoi_jax.data.record import Record
from eoi_jax.discovery.judge import error_ratio
from eoi_jax.discovery.remarks import FitNote
from eoi_jax.discovery.result import Discovery
from eoi_jax.discovery.rules import RULES
from eoi_jax.models.used_inputs import used_inputs
from eoi_jax.simulation.validate import judged_runs

_RULES = RULES.questions


def influence_notes(discovery: Discovery) -> list[str]:
    """A note on each input without which free runs of the answer miss the records hardly more.

    A heater that is not connected, or a column of another record: parameters then run to where such
    an input does nothing, and the other ones follow them. Runs that say nothing of the records tell
    nothing of inputs either.

    Args:
        discovery: the answer.
    """
    long_runs, plant = discovery.after, discovery.plant
    if long_runs is None or not np.all(long_runs.nrmse < _RULES.follows):
        return []
    records, used = discovery.held_out, np.flatnonzero(np.any(used_inputs(plant), axis=0)).tolist()
    inputs = [j for j in used if any(moves(record, j) for record in records)]
    if not inputs:
        return []
    window, substeps = long_runs.window, long_runs.substeps
    runs = judged_runs(plant, records, window=window, substeps=substeps)
    notes = []
    for j in inputs:
        replaced = [_at_mean(record, j) for record in records]
        trial = judged_runs(plant, replaced, window=window, substeps=substeps)
        if (ratio := error_ratio(trial, runs)) < _RULES.no_influence:
            notes.append(FitNote(_NO_INFLUENCE.format(plant.inputs[j], ratio)))
    return notes


def _at_mean(record: Record, j: int) -> Record:
    """The record with the mean of an input in its place."""
    inputs = record.inputs.copy()
    inputs[:, j] = np.mean(inputs[record.input_valid, j])
    return record.with_inputs(inputs, record.input_names, record.skew, record.hold)


_NO_INFLUENCE = (
    "the records show next to no influence of {}: with its mean in its place free runs have {:.3g} "
    "times the error; check that it acts on the plant, and that it is the right column"
)
