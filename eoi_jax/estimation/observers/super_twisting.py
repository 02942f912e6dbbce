r"""Super-twisting observer for outputs of relative degree two.

    x̂₁' = x̂₂ + λ₁ |e|^½ sign e,    x̂₂' = f + α sign e,    e = y - x̂₁

Implicit form: with s = y[k+1] - x₁ - h (x₂ + h f) and T = h² α, solve for ξ ∈ Sign(e₊)

    |s| ≤ T:  ξ = s/T, e₊ = 0      else:  ξ = sign s,  r² + h λ₁ r + T = |s|,  e₊ = r² ξ
    x₂ ← x₂ + h (f + α ξ)          x₁ ← y[k+1] - e₊          injection α ξ

In sliding mode x₂ is the measured increment (y[k+1] - y[k])/h, and f + α ξ the second difference of
y.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from eoi_jax._types import Output, Rates, Scalar
from eoi_jax.estimation.observers.observer import AbstractObserver, Observation, check_gains, gain


class SuperTwistingState(eqx.Module):
    """x̂₁ and x̂₂, each (ny,)."""

    x1: Output
    x2: Output


class SuperTwisting(AbstractObserver):
    """Super-twisting observer.

    Args:
        alpha: α, relay of the velocity [unit of ÿ]; must exceed the model's error.
        lambda1: λ₁ [√(unit of ÿ)]; default: 1.5 √α.
        scheme: ``"implicit"``, or ``"explicit"`` (Euler) as published.

    Raises:
        ValueError: a gain that is not positive and finite, an unknown scheme.

    Source:
        Davila, Fridman, Poznyak (2006).
    """

    alpha: Any
    lambda1: Any
    scheme: str = eqx.field(static=True)

    def __init__(self, alpha: Any, lambda1: Any = None, scheme: str = "implicit"):
        if lambda1 is None:
            lambda1 = 1.5 * jnp.sqrt(jnp.asarray(alpha))
        check_gains(scheme, alpha=alpha, lambda1=lambda1)
        self.alpha, self.lambda1, self.scheme = gain(alpha), gain(lambda1), scheme

    @property
    def relative_degree(self) -> int:
        """Two."""
        return 2

    @property
    def kernel(self) -> tuple[float, ...]:
        """The second difference averages ÿ over two steps."""
        return (0.5, 0.5) if self.scheme == "implicit" else (1.0,)

    def init(self, y: Output, rates: Rates) -> SuperTwistingState:
        """Start on the measurement with its rough velocity."""
        return SuperTwistingState(y, rates[0])

    def rates(self, state: SuperTwistingState) -> Rates:
        """x̂₂."""
        return state.x2[None]

    def step(
        self,
        state: SuperTwistingState,
        y: Output,
        y_next: Output,
        drift: Output,
        sample_period: Scalar,
    ) -> tuple[SuperTwistingState, Observation]:
        """One step."""
        advance = self._implicit if self.scheme == "implicit" else self._explicit
        return advance(state, y, y_next, drift, sample_period)

    def _implicit(self, state, y, y_next, drift, h):
        del y
        s = y_next - state.x1 - h * (state.x2 + h * drift)
        width = h**2 * self.alpha
        sliding = jnp.abs(s) <= width
        xi = jnp.where(sliding, s / width, jnp.sign(s))
        excess = jnp.maximum(jnp.abs(s) - width, 0.0)
        r = 0.5 * (jnp.sqrt((h * self.lambda1) ** 2 + 4.0 * excess) - h * self.lambda1)
        injection = self.alpha * xi
        x2 = state.x2 + h * (drift + injection)
        new = SuperTwistingState(y_next - r**2 * xi, x2)
        return new, Observation(injection, injection + drift, x2[None], sliding)

    def _explicit(self, state, y, y_next, drift, h):
        del y_next
        e = y - state.x1
        injection = self.alpha * jnp.sign(e)
        x1 = state.x1 + h * (state.x2 + self.lambda1 * jnp.sqrt(jnp.abs(e)) * jnp.sign(e))
        x2 = state.x2 + h * (drift + injection)
        sliding = jnp.abs(e) <= 2.0 * h**2 * self.alpha
        new = SuperTwistingState(x1, x2)
        return new, Observation(injection, injection + drift, state.x2[None], sliding)
