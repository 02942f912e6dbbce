r"""No observer: for outputs of relative degree zero, which are functions of the states.

    y = h(t, x, u; θ)

Nothing is differentiated, so nothing has to be followed: the measurement itself is what the model
is compared with, and the injection is u_eq = y - h.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from eoi_jax._checks import check_choice
from eoi_jax._types import Output, Rates, Scalar
from eoi_jax.estimation.observers.observer import SCHEMES, AbstractObserver, Observation


class Measurement(AbstractObserver):
    """The measurement in the place of an observer; it has no gains.

    Args:
        scheme: that of the observers beside it in a `PerOutput`.

    Raises:
        ValueError: an unknown scheme.

    Source: derived above.
    """

    scheme: str = eqx.field(static=True)

    def __init__(self, scheme: str = "implicit"):
        check_choice("scheme", scheme, SCHEMES)
        self.scheme = scheme

    @property
    def relative_degree(self) -> int:
        """Zero."""
        return 0

    @property
    def kernel(self) -> tuple[float, ...]:
        """The injection belongs to the sample itself."""
        return (1.0,)

    def init(self, y: Output, rates: Rates) -> Output:
        """The measurement."""
        del rates
        return y

    def rates(self, state: Output) -> Rates:
        """None: shape (0, ny)."""
        return jnp.zeros((0, *state.shape), state.dtype)

    def step(
        self, state: Output, y: Output, y_next: Output, drift: Output, sample_period: Scalar
    ) -> tuple[Any, Observation]:
        """The injection y - h at the start of the step."""
        del sample_period
        sliding = jnp.ones(y.shape, bool)
        return y_next, Observation(y - drift, y, self.rates(state), sliding)
