r"""The interface of the sliding-mode observers, section 3 of the paper.

An observer follows the measured output; the injection that this takes is the model's error. Every
observer is a recursion over the steps k → k+1 of a record, written for all outputs at once (arrays
of shape (ny,); gains are scalars or one value per output).

**Time alignment.** In sliding mode, an implicit observer of relative degree r reproduces the
measured output exactly, and its injection plus its model is a moving average of y^(r) over the last
r steps: the r-th backward difference ∇^r y / h^r, whose weights per step are those of the B-spline
of degree r - 1, (1), (½, ½), (⅙, ⅔, ⅙), … (`kernel`). The pass applies the same average to the
model and the regressors, so that both sides of the regression belong to the same instant.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from eoi_jax._checks import check_choice, check_positive
from eoi_jax._types import Output, Rates, Scalar
from eoi_jax.compiler.jax_private import Tracer

SCHEMES = ("implicit", "explicit")


class Observation(eqx.Module):
    """Output of one step of an observer.

    Attributes:
        injection: added to the model to follow the measurement [unit of y^(r)].
        observed: injection plus model: the observer's estimate of y^(r), averaged over the last
            steps with the weights of `kernel`.
        rates: ẏ, …, y^(r-1) in the middle of the step.
        sliding: whether the relay is inside its set-valued part (implicit), or its error inside
            the band of the sampled relay (explicit).
    """

    injection: Float[Array, " ny"]
    observed: Float[Array, " ny"]
    rates: Float[Array, "rates ny"]
    sliding: Bool[Array, " ny"]


class AbstractObserver(eqx.Module):
    """Interface of every observer; a new one is one file with these five members."""

    scheme: eqx.AbstractVar[str]

    @property
    @abc.abstractmethod
    def relative_degree(self) -> int | tuple[int, ...]:
        """Relative degree r of the outputs: one number, or one per output."""

    @property
    @abc.abstractmethod
    def kernel(self) -> tuple[Any, ...]:
        """Weights, newest step first, of the average in `Observation.observed`.

        One tuple for all outputs, or a tuple of tuples, one per output.
        """

    @abc.abstractmethod
    def init(self, y: Output, rates: Rates) -> Any:
        """State at a first sample with measured y and rough rates (r - 1, ny)."""

    @abc.abstractmethod
    def rates(self, state: Any) -> Rates:
        """Rates (r - 1, ny) with which the model is evaluated before the step is known."""

    @abc.abstractmethod
    def step(
        self, state: Any, y: Output, y_next: Output, drift: Output, sample_period: Scalar
    ) -> tuple[Any, Observation]:
        """Step from sample k to k+1.

        Args:
            state: of sample k.
            y: measured outputs at k.
            y_next: at k+1; known offline, so the relay may be implicit.
            drift: the model f over the step.
            sample_period: h [s].
        """


def check_gains(scheme: str, **gains: Any) -> None:
    """Gains must be positive and finite, the scheme known; traced gains pass unchecked."""
    check_choice("scheme", scheme, SCHEMES)
    for name, value in gains.items():
        if not isinstance(value, Tracer):
            check_positive(name, value, "Leave the observer out to have gains chosen.")


def gain(value: Any) -> Any:
    """A gain as an array: a number, or one value per output."""
    return value if isinstance(value, jax.Array) else np.asarray(value, dtype=float)
