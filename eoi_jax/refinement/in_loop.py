"""Refinement with the controller in the loop: of a closed loop, answered for the plant alone.

Where the loop is not stable at the parameters from which a fit starts, its free runs say nothing,
and least squares of them finds a way back slowly or not at all. The fit of the plant alone, driven
by the recorded input (in windows, where it is unstable), does not know of that: it comes first.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from eoi_jax.data.record import Record
from eoi_jax.models.controller import Controller
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.fit import log_cost
from eoi_jax.refinement.result import Refinement
from eoi_jax.simulation.closed_loop import ClosedLoop, closed_loop
from eoi_jax.simulation.error_growth import is_lost
from eoi_jax.simulation.validate import judged_runs
from eoi_jax.simulation.validation import Validation

# `refine` with its settings, of a plant along records; held-out ones are `validation`.
Refine = Callable[..., Refinement]


def refined_in_loop(
    refine: Refine,
    plant: Plant,
    records: Record | Sequence[Record],
    validation: Record | Sequence[Record] | None,
    controller: Controller,
    open_loop: Refine | None,
) -> Refinement:
    """The refinement of a plant whose controller is in the loop of all runs.

    Args:
        refine: of the closed loop.
        plant: the plant alone, with the parameters to start from.
        records: with the references of the controller among their inputs.
        validation: held-out ones; None: none.
        controller: of the plant.
        open_loop: of the plant alone, for a start where the loop is lost; None: no other start.
    """
    loop = closed_loop(plant, records, controller)
    held_out = None
    if validation is not None:
        held_out = closed_loop(plant, validation, controller).records
    if open_loop is not None:
        runs = judged_runs(loop.plant, loop.records)
        if is_lost(runs.nrmse, np.ones_like(runs.nrmse)):
            start = open_loop(plant, loop.originals)
            if start.status.ok:
                nearer = loop.plant.with_parameters(start.plant.theta)
                result = refine(nearer, loop.records, validation=held_out)
                if result.status.ok:
                    return _opened(_begun_at(result, loop, runs, start), loop)
    return _opened(refine(loop.plant, loop.records, validation=held_out), loop)


def _begun_at(
    result: Refinement, loop: ClosedLoop, runs: Validation, start: Refinement
) -> Refinement:
    """A result compared with the plant's own parameters, from which no fit of the loop started."""
    before = np.nan_to_num(runs.rmse, nan=np.inf, posinf=np.inf)
    length = "whole records" if start.window is None else f"windows of {start.window:.3g} s"
    note = (
        f"The loop is lost with the parameters of the start: the fit began at that of {length} "
        "driven by the recorded input."
    )
    return replace(
        result,
        nominal=loop.plant,
        before=before,
        cost_before=log_cost(before),
        residual_before=tuple(
            np.where(np.isfinite(residual), record.outputs - simulated.outputs, np.nan)
            for residual, record, simulated in zip(
                result.residual, loop.originals, runs.predictions, strict=True
            )
        ),
        steps=start.steps + result.steps,
        notes=(*result.notes, note),
    )


def _opened(result: Refinement, loop: ClosedLoop) -> Refinement:
    """The refinement of a closed loop as one of the plant in it."""
    states = len(loop.opened.initial_internal)
    return replace(
        result,
        plant=loop.opened_at(result.plant),
        nominal=loop.opened_at(result.nominal),
        starts=tuple(replace(start, z=start.z[:states]) for start in result.starts),
        notes=(*result.notes, loop.note),
        records=loop.originals,
        in_loop=True,
    )
