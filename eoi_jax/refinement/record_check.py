"""Records that ask for different parameters: the fit of all beside fits of each record by itself.

A load or a temperature that changes from one record to the next is no noise: common parameters then
miss all records, with standard errors that count the differences as noise.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Float

from eoi_jax._status import FitNote
from eoi_jax.data.record import Record
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.result import Refinement
from eoi_jax.refinement.start_check import chance_of_ratio, independent_residuals


@dataclass(frozen=True)
class RecordCheckSettings:
    """When records are said to ask for different parameters."""

    most: int = 8  # records that are compared
    ratio: float = 1.0 / 3.0  # of the error to that with common parameters, at most
    deviations: float = 4.0  # of two records, in standard errors of the difference
    chance: float = 1e-4  # of so much better fits where the parameters are common


_SETTINGS = RecordCheckSettings()


def with_record_check(
    result: Refinement, refit: Callable[[Plant, tuple[Record, ...]], Refinement]
) -> Refinement:
    """A refinement, with a note on the parameters of which the records ask for different values.

    Only where so much more than noise is left that the errors can fall to a third. They do not
    where the model lacks the same in all records.

    Args:
        result: with a fit.
        refit: makes another one from a plant along records, in runs of the same length.
    """
    records = result.records
    if not (result.status.ok and 2 <= len(records) <= _SETTINGS.most):
        return result
    noise = np.max([record.noise for record in records], axis=0)
    if not mean_ratio(noise, result.rmse) < _SETTINGS.ratio:
        return result
    fits = [refit(result.plant, (record,)) for record in records]
    best = min((fit for fit in fits if fit.status.fits), key=lambda fit: fit.cost, default=None)
    if best is None:
        return result
    # From common parameters a record may end in a minimum that the others pass by.
    again = [refit(result.plant.with_parameters(best.parameters), (record,)) for record in records]
    fits = [
        trial if trial.status.fits and not trial.cost >= fit.cost else fit
        for fit, trial in zip(fits, again, strict=True)
    ]
    if not all(fit.status.fits and fit.window == result.window for fit in fits):
        return result
    ratio = mean_ratio(pooled_errors(fits, records), result.rmse)
    names = differing_parameters(fits, _SETTINGS.deviations)
    if not (ratio < _SETTINGS.ratio and names):
        return result
    independent = sum(
        min(independent_residuals(fit, j) for j in range(len(result.rmse))) for fit in fits
    )
    count = (len(records) - 1) * int(np.sum(result.plant.free))
    gain = -2.0 * len(result.rmse) * independent * np.log(ratio)
    if chance_of_ratio(gain, count) >= _SETTINGS.chance:
        return result
    values = ", ".join(f"{name} ({values_by_record(fits, name, records)})" for name in names)
    note = FitNote(_ASK.format(values, ratio))
    return replace(result, notes=(*result.notes, note))


_ASK = (
    "the records ask for different values of {}. With parameters of their own free runs have "
    "{:.2g} of the error that common ones leave. Either what these stand for changes from record "
    "to record, or what the model lacks does"
)


def pooled_errors(
    fits: Sequence[Refinement], records: Sequence[Record]
) -> Float[np.ndarray, " ny"]:
    """Root mean square of the errors of all records together.

    Args:
        fits: one for each record.
        records: their records.
    """
    counts = [record.output_valid.sum(axis=0) for record in records]
    squares = [fit.rmse**2 for fit in fits]
    return np.sqrt(np.average(squares, axis=0, weights=np.array(counts)))


def mean_ratio(errors: Float[np.ndarray, " ny"], rival: Float[np.ndarray, " ny"]) -> float:
    """Ratio of errors to those of a rival, geometric mean of the outputs."""
    return float(np.exp(np.mean(np.log(np.maximum(errors, _TINY) / np.maximum(rival, _TINY)))))


def differing_parameters(fits: Sequence[Refinement], deviations: float) -> tuple[str, ...]:
    """Free parameters of which two records differ by far more than their standard errors.

    Args:
        fits: of one model, one for each record.
        deviations: by how many standard errors of the difference, at least.
    """
    names = []
    for name, free in zip(fits[0].plant.names, fits[0].plant.free, strict=True):
        pairs = combinations([(fit.parameters[name], fit.standard_errors[name]) for fit in fits], 2)
        if free and any(
            0.0 < np.hypot(a[1], b[1]) < abs(a[0] - b[0]) / deviations for a, b in pairs
        ):
            names.append(name)
    return tuple(names)


def values_by_record(fits: Sequence[Refinement], parameter: str, records: Sequence[Record]) -> str:
    """The values of a parameter in each record, as text.

    Args:
        fits: one for each record.
        parameter: its name.
        records: numbered where names repeat.
    """
    unit = fits[0].plant.units.get(parameter)
    return ", ".join(
        f"{fit.parameters[parameter]:.5g} ± {fit.standard_errors[parameter]:.2g}"
        f"{f' {unit}' if unit else ''} in {name}"
        for fit, name in zip(fits, record_names(records), strict=True)
    )


def record_names(records: Sequence[Record]) -> list[str]:
    """Names of records, with numbers where these are not their own."""
    names = [record.name for record in records]
    if len(set(names)) == len(names):
        return names
    return [f"{name} {number}" for number, name in enumerate(names, start=1)]


_TINY = float(np.finfo(float).tiny)
