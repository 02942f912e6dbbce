r"""First-order disturbance observer with leak, eqs. (5)–(7), for outputs of relative degree one.

    x̂' = f + ω₁ |e|^½ sign e + ω₂ p,    p' = -T p + sign e,    e = y - x̂        (5)

with ω₁ = 1.5 √δ, ω₂ = 1.1 δ for a disturbance whose rate is bounded by δ. The injection
v = ω₁ |e|^½ sign e + ω₂ p is continuous and equals the disturbance in finite time, eq. (7).

Implicit form: sign(e) is taken at the *end* of the step, e₊ = y₊ - x̂₊, as the set-valued map
it is. With κ = h² ω₂/(1 + hT) and b = y₊ - x̂ - h (f + ω₂ p/(1 + hT)), the step solves
e₊ + h ω₁ |e₊|^½ s + κ s = b for s ∈ Sign(e₊):

    |b| ≤ κ:  s = b/κ, r = 0        else:  s = sign b,  r² + h ω₁ r + κ = |b|,   e₊ = r² s
    p₊ = (p + h s)/(1 + hT),        v = ω₁ r s + ω₂ p₊,        x̂₊ = y₊ - e₊

In sliding mode v = (y₊ - y)/h - f: the mean of the model's error over the step.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from eoi_jax._types import Output, Rates, Scalar
from eoi_jax.estimation.observers.observer import AbstractObserver, Observation, check_gains, gain


class FirstOrderState(eqx.Module):
    """x̂ and the relay's leaky integral p, each (ny,)."""

    x: Output
    p: Output


class FirstOrder(AbstractObserver):
    """First-order observer with leak, eq. (5).

    Args:
        delta: bound δ on the rate of the disturbance [unit of y / s²].
        leak: T [1/s].
        scheme: ``"implicit"``, or ``"explicit"`` (Euler) as published.

    Raises:
        ValueError: a gain that is not positive and finite, an unknown scheme.

    Source:
        Bu et al. (2015), Wang et al. (2015), as used in section 3.1 of the paper.
    """

    delta: Any
    leak: Any
    scheme: str = eqx.field(static=True)

    def __init__(self, delta: Any, leak: Any = 1.0, scheme: str = "implicit"):
        check_gains(scheme, delta=delta, leak=leak)
        self.delta, self.leak, self.scheme = gain(delta), gain(leak), scheme

    @property
    def relative_degree(self) -> int:
        """One."""
        return 1

    @property
    def kernel(self) -> tuple[float, ...]:
        """The injection belongs to the step itself."""
        return (1.0,)

    def init(self, y: Output, rates: Rates) -> FirstOrderState:
        """Start on the measurement with an empty integral."""
        del rates
        return FirstOrderState(y, jnp.zeros_like(y))

    def rates(self, state: FirstOrderState) -> Rates:
        """None: shape (0, ny)."""
        return jnp.zeros((0, *state.x.shape), state.x.dtype)

    def step(
        self,
        state: FirstOrderState,
        y: Output,
        y_next: Output,
        drift: Output,
        sample_period: Scalar,
    ) -> tuple[FirstOrderState, Observation]:
        """One step of eq. (5)."""
        advance = self._implicit if self.scheme == "implicit" else self._explicit
        new, injection, sliding = advance(state, y, y_next, drift, sample_period)
        return new, Observation(injection, injection + drift, self.rates(state), sliding)

    def _implicit(self, state, y, y_next, drift, h):
        del y
        omega1, omega2 = 1.5 * jnp.sqrt(self.delta), 1.1 * self.delta
        decay = 1.0 / (1.0 + h * self.leak)
        kappa = h**2 * omega2 * decay
        b = y_next - state.x - h * (drift + omega2 * state.p * decay)
        sliding = jnp.abs(b) <= kappa
        s = jnp.where(sliding, b / kappa, jnp.sign(b))
        excess = jnp.maximum(jnp.abs(b) - kappa, 0.0)
        r = 0.5 * (jnp.sqrt((h * omega1) ** 2 + 4.0 * excess) - h * omega1)
        p = (state.p + h * s) * decay
        return FirstOrderState(y_next - r**2 * s, p), omega1 * r * s + omega2 * p, sliding

    def _explicit(self, state, y, y_next, drift, h):
        del y_next
        omega1, omega2 = 1.5 * jnp.sqrt(self.delta), 1.1 * self.delta
        e = y - state.x
        injection = omega1 * jnp.sqrt(jnp.abs(e)) * jnp.sign(e) + omega2 * state.p
        x = state.x + h * (drift + injection)
        p = state.p + h * (jnp.sign(e) - self.leak * state.p)
        return FirstOrderState(x, p), injection, jnp.abs(e) <= h**2 * omega1**2
