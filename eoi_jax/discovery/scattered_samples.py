"""Outputs of scattered samples that are functions of the states: their free runs decide.

Between samples that are further apart than the steps of the grid, passes follow a spline. Its
errors are no noise of the samples and are alike along many steps, so that what the passes leave of
a right model may count as more than noise. Free runs are compared with the samples alone.
"""

from dataclasses import replace

from eoi_jax._status import Status
from eoi_jax.data.record import Record
from eoi_jax.data.windows import steps_between_samples
from eoi_jax.discovery.confirm import leave_noise
from eoi_jax.discovery.in_free_runs import begun_search
from eoi_jax.discovery.refined import refined_passes
from eoi_jax.discovery.result import Discovery
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.preparation import prepare_records


def unless_samples_are_met(
    discovery: Discovery, records: tuple[Record, ...], lowpass: LowPass | None
) -> Discovery:
    """An answer without effects, which lacks nothing where free runs leave noise at the samples.

    Of outputs that are states effects are searched in free runs, which say the same
    (`in_free_runs.py`).

    Args:
        discovery: the answer of the injection.
        records: to fit, as given.
        lowpass: F of the fits; None: chosen from the records.
    """
    is_open = discovery.status.code == "unexplained" and not discovery.added
    if not is_open or discovery.in_sample or not discovery.plant.has_algebraic:
        return discovery
    search = begun_search(discovery, records) if steps_between_samples(records) > 1.0 else None
    model = None if search is None else search.settled_base
    if search is None or model is None or model.fit_runs is None:
        return discovery
    runs = model.runs[0], model.fit_runs[0]
    if not (model.refinement.status.ok and leave_noise(runs)):
        return discovery
    nothing = Status("nothing_missing", _AT_SAMPLES)
    outcome = replace(discovery, status=nothing, lead=None, diagnosis=None)
    prepared = prepare_records(discovery.declared.nominal, search.records, lowpass)
    return refined_passes(outcome, model.refinement, prepared)


_AT_SAMPLES = (
    "at the samples free runs of the refined model leave no more than white noise, on the records "
    "of the fit and on held-out ones; what passes leave between scattered samples is no evidence"
)
