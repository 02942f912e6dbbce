"""Free runs on test records, which neither the fit nor the choice of effects has seen."""

from collections.abc import Sequence
from dataclasses import replace

from eoi_jax.data.holds import made_alike
from eoi_jax.data.record import Record
from eoi_jax.data.windows import window_length
from eoi_jax.discovery.refit import not_simulated
from eoi_jax.discovery.result import Discovery
from eoi_jax.estimation.holdout import longest_start
from eoi_jax.simulation.validate import whole_and_windows


def with_test_errors(
    discovery: Discovery,
    test: Sequence[Record],
    records: Sequence[Record],
    window: float | None,
) -> Discovery:
    """The answer with its errors on test records, before and after.

    Args:
        discovery: the answer.
        test: records that nothing has seen.
        records: of the fit, as they were read; their hold is that of the test records too.
        window: length of re-initialised runs [s]; None: chosen from the records.
    """
    models = discovery.plant_before, discovery.plant
    if not discovery.declared.status.fits or any(not_simulated(model) for model in models):
        return discovery
    unseen = made_alike(test, records, discovery.found.records)
    if window is None:
        window = window_length(unseen, 2 * longest_start(discovery.plant, unseen))
    longest = None if discovery.before is None else discovery.before.window
    before, after = (whole_and_windows(model, unseen, window, longest) for model in models)
    return replace(
        discovery,
        test_before=before[0],
        test_after=after[0],
        test_windows_before=before[1],
        test_windows_after=after[1],
    )
