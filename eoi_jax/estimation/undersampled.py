"""Whether the samples resolve an estimate: whether it has a mode that is faster than they are."""

import numpy as np

from eoi_jax._status import Status
from eoi_jax.data.record import Record
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.step_size import fastest_mode

_UNDERSAMPLED = (
    "the estimate has a mode with a time constant of {:.2g} s, shorter than the sample period of "
    "{:.2g} s{}: the passes cannot resolve it, and parameters that set it are biased by more than "
    "their standard errors. Use `refine`, which simulates between the samples, sample faster, or "
    "replace the fast state by its steady state"
)


def resolved(status: Status, nominal: Plant, plant: Plant, records: tuple[Record, ...]) -> Status:
    """The status of an estimate, which the samples may not resolve.

    Between two samples a pass knows outputs by interpolation only. Of a mode whose time constant is
    shorter than that it sees the quasi-static response, whatever its parameters are.

    Args:
        status: of the passes.
        nominal: the plant as it was passed to them.
        plant: with the estimate.
        records: that were fitted.

    Returns:
        `undersampled`, with the parameters that set the mode, or the status itself.
    """
    if not status.ok:
        return status
    for record in records:
        rate = fastest_mode(plant, record, quantile=0.5)  # the mode is there half of the time
        if rate * record.sample_period > 1.0:
            fast = _set_by(nominal, plant, record, rate)
            text = _UNDERSAMPLED.format(1.0 / rate, record.sample_period, fast)
            return Status("undersampled", text)
    return status


def _set_by(
    nominal: Plant, plant: Plant, record: Record, rate: float, min_exponent: float = 0.5
) -> str:
    """Which parameters set the fastest mode: λ changes with such a power of them, at least."""
    texts = []
    for i in np.flatnonzero(plant.free).tolist():
        theta = np.array(plant.theta, dtype=float)
        theta[i] *= 1.01
        moved = fastest_mode(plant.with_parameters(theta), record, quantile=0.5)
        if abs(np.log(max(moved, 1e-300) / rate) / np.log(1.01)) >= min_exponent:
            start = nominal.parameters[plant.names[i]]
            texts.append(f"{plant.names[i]} ({start:.3g} at first, now {plant.theta[i]:.3g})")
    return f", set by {' and '.join(texts)}" if texts else ""
