"""Covariance and standard errors of an estimate, computed when they are first read.

An estimate that only starts another one never needs them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from eoi_jax.models.stored_classes import stored_form


@dataclass(frozen=True)
class Certainty:
    """Uncertainty of an estimate.

    Attributes:
        covariance: of the parameters, shape (np, np).
        degrees_of_freedom: of the variance of each, shape (np,); None where they are not known.
        standard_errors: by name.
    """

    covariance: Float[np.ndarray, "np np"]
    degrees_of_freedom: Float[np.ndarray, " np"] | None
    standard_errors: dict[str, float]


class DeferredCertainty:
    """A `Certainty` that is computed once, when `value` is first read.

    Args:
        compute: returns it; dropped afterwards, with the signals that it holds.
    """

    def __init__(self, compute: Callable[[], Certainty]):
        self._compute: Callable[[], Certainty] | None = compute

    @cached_property
    def value(self) -> Certainty:
        """The certainty."""
        assert self._compute is not None
        certainty, self._compute = self._compute(), None
        return certainty


def computed(certainty: Certainty | DeferredCertainty) -> Certainty:
    """A certainty, computed now if it was deferred."""
    return certainty.value if isinstance(certainty, DeferredCertainty) else certainty


@stored_form.register
def _stored_value(certainty: DeferredCertainty) -> Certainty:
    return certainty.value
