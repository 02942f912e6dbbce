"""How sure standard errors are: intervals by Student's t, and a note where degrees are few."""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from eoi_jax.estimation.common_factors import listed


@runtime_checkable
class Estimate(Protocol):
    """An `Identification` or a `Refinement`."""

    @property
    def parameters(self) -> dict[str, float]:
        """Estimates by name."""
        ...

    @property
    def standard_errors(self) -> dict[str, float]:
        """By name."""
        ...

    @property
    def degrees_of_freedom(self) -> Float[np.ndarray, " np"] | None:
        """Of the variance of each parameter; None where they were not kept."""
        ...


def student(level: float, freedom: Float[np.ndarray, " np"]) -> Float[np.ndarray, " np"]:
    """Half widths of symmetric intervals in standard errors: quantiles of Student's t."""
    from scipy.special import ndtri, stdtrit

    upper = 0.5 * (1.0 + level)
    return np.where(np.isinf(freedom), ndtri(upper), stdtrit(freedom, upper))


def freedom_notes(estimate: Estimate) -> tuple[str, ...]:
    """A sentence where standard errors have so few degrees of freedom that ±2 of them mislead.

    Args:
        estimate: with an answer or without.
    """
    if estimate.degrees_of_freedom is None:
        return ()
    freedom = np.asarray(estimate.degrees_of_freedom)
    errors = np.asarray(list(estimate.standard_errors.values()))
    scarce = (freedom < FEW) & np.isfinite(errors) & (errors > 0)
    if not np.any(scarce):
        return ()
    names = [
        name for name, is_scarce in zip(estimate.standard_errors, scarce, strict=True) if is_scarce
    ]
    ends = [np.min(freedom[scarce]), np.max(freedom[scarce])]
    numbers = list(dict.fromkeys(f"{end:.2g}" for end in ends))
    reach = list(dict.fromkeys(f"{size:.2g}" for size in student(0.95, np.asarray(ends))[::-1]))
    note = _FEW.format(listed(names), " to ".join(numbers), " to ".join(reach))
    values = np.asarray(list(estimate.parameters.values()))
    is_open = scarce & (np.abs(values) < student(0.95, freedom) * errors)
    pairs = zip(estimate.standard_errors, is_open, strict=True)
    open_names = [name for name, flag in pairs if flag]
    return (f"{note}; that of {listed(open_names)} holds zero" if open_names else note,)


FEW = 5.0  # degrees of freedom, at which a 95 % interval reaches 2.6 standard errors in place of 2
_FEW = (
    "the ± of {} rests on {} degrees of freedom: the 95 % interval reaches {} times as far to each "
    "side (`uncertainty`), as few independent parts of the records tell of it"
)
