"""How sure an estimate is, worked out where somebody asks: as the start of another nobody does."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eoi_jax.models.stored_classes import stored_form


@dataclass(frozen=True)
class Certainty:
    """What is known of the errors of an estimate.

    Attributes:
        covariance: of the parameters, shape (np, np).
        degrees_of_freedom: of the variance of each, shape (np,); None where they are not known.
        standard_errors: by name.
    """

    covariance: Float[np.ndarray, "np np"]
    degrees_of_freedom: Float[np.ndarray, " np"] | None
    standard_errors: dict[str, float]


class Deferred:
    """A certainty that is worked out once, when it is first asked for.

    Args:
        work: what gives it; let go afterwards, with all that it holds.
    """

    def __init__(self, work: Callable[[], Certainty]):
        self._work: Callable[[], Certainty] | None = work
        self._found: Certainty | None = None

    @property
    def found(self) -> Certainty:
        """The certainty."""
        work = self._work
        if work is not None:
            self._found, self._work = work(), None
        assert self._found is not None
        return self._found


def settled(one: Certainty | Deferred) -> Certainty:
    """A certainty, worked out if it has not been."""
    return one.found if isinstance(one, Deferred) else one


@stored_form.register
def _found(one: Deferred) -> Certainty:
    return one.found
