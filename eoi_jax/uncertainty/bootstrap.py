r"""Block bootstrap of an identification: estimates from blocks of scores drawn with replacement.

A block is longer than the filter remembers, so that blocks are nearly independent. All resamples
are lanes of one sweep, plain passes: what depends on the records alone is computed once.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eoi_jax._checks import Whole, check, check_count, check_kind
from eoi_jax.data.record import Record
from eoi_jax.estimation.identify import Identification
from eoi_jax.estimation.sweep.sweep import sweep
from eoi_jax.models.check_records import check_records
from eoi_jax.uncertainty.uncertainty import Uncertainty, uncertainty

_MIN_RESAMPLES = 20  # quantiles of fewer say nothing


def bootstrap(
    identification: Identification,
    records: Record | Sequence[Record],
    *,
    resamples: Whole = 500,
    seed: int = 0,
    transient: float | None = None,
    substeps: int | None = None,
    smoothing: float | bool | None = None,
) -> Uncertainty:
    """How sure an identification is, by estimating it anew from resampled blocks of its records.

    Args:
        identification: result of `identify` by plain passes (``instruments=False``, where the
            records are noisy); its observer and filter are kept.
        records: that it was made from, as they were given.
        resamples: how many. 500 are enough for a 95 % interval.
        seed: of the draws.
        transient: as it was given to `identify` [s].
        substeps: the same.
        smoothing: the same [rad/s].

    Returns:
        The uncertainty with the covariance of the resamples, and intervals from their quantiles:
        of an estimate that is not normal they are not symmetric.

    Raises:
        ValueError: too few resamples, or too few that have an answer; an estimate by instrumental
            variables, which no resample is.

    Source:
        H. Künsch, Annals of Statistics 17 (1989) 1217, with blocks that do not overlap.
    """
    resamples = check_count("resamples", resamples, _MIN_RESAMPLES)
    check_kind("identification", identification, Identification, "what `identify` returned")
    base = uncertainty(identification)
    check(
        not np.any(identification.correction),
        "identification",
        "must be of plain passes: resamples are, and scatter around another estimate than this",
        "one by instrumental variables",
        "`uncertainty` has its intervals, `refine` and `profile` a likelihood; or resample "
        "`identify(…, instruments=False)`, which leaves the bias of noise in.",
    )
    drawn = sweep(
        identification.plant,
        [list(check_records(identification.plant, records))],
        identification.observer,
        identification.lowpass,
        resamples=resamples,
        seed=seed,
        transient=transient,
        substeps=substeps,
        smoothing=smoothing,
    ).isel(record=0, lowpass=0, observer=0, start=0, resample=slice(1, None))
    draws = np.asarray(drawn["parameters"].values)[drawn["ok"].values]
    check(
        len(draws) >= max(_MIN_RESAMPLES, resamples // 2),
        "records",
        "must give an answer for at least half of the resamples",
        f"{len(draws)} of {resamples}",
        "Blocks without excitation say nothing alone: use longer records.",
    )
    covariance = np.atleast_2d(np.cov(draws, rowvar=False))
    # What a resample draws are blocks, and one is taken by the estimate.
    freedom = np.full(len(covariance), max(float(drawn["blocks"][0]) - 1.0, 1.0))
    return replace(base, covariance=covariance, degrees_of_freedom=freedom, draws=draws)
