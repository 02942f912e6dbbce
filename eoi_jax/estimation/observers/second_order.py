r"""Discontinuous second-order observer, eq. (9), for outputs of relative degree two.

    x̂₁' = x̂₂ + c₁ e,    x̂₂' = f + c₂ e + c₃ sign e,    e = y - x̂₁        (9)

In sliding mode the mean of c₃ sign e is the model's error, eq. (10) and below; a low-pass filter
recovers it.

Implicit form, e = y[k] - x₁ at the start of the step, relay at its end:

    A   = f + c₂ e            x₁⁻ = x₁ + h x₂ + ½ h² A + h c₁ e        x₂⁻ = x₂ + h A
    w   = clip((y[k+1] - x₁⁻)/h², -c₃, c₃)             |w| < c₃  ⇔  in sliding mode
    x₁ ← x₁⁻ + h² w                                     x₂ ← x₂⁻ + h w

In sliding mode x₁ = y exactly. With γ = ÿ - f the model's error, ẏ - x₂ = ½ h γ follows after one
step and so w[k] = ½ (γ[k] + γ[k-1]): hence `kernel`, and a middle velocity x₂[k+1] - ½ h A, which
is the measured increment (y[k+1] - y[k])/h, free of that bias.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from eoi_jax._types import Output, Rates, Scalar
from eoi_jax.estimation.observers.observer import AbstractObserver, Observation, check_gains, gain


class SecondOrderState(eqx.Module):
    """x̂₁, x̂₂ and the model's value over the previous step, each (ny,)."""

    x1: Output
    x2: Output
    drift: Output


class SecondOrder(AbstractObserver):
    """Discontinuous observer, eq. (9).

    Args:
        c1: position gain [1/s].
        c2: linear gain [1/s²].
        c3: relay [unit of ÿ]; must exceed the model's error, and h² c3 the measurement noise
            tenfold.
        scheme: ``"implicit"``, or ``"explicit"`` (Euler) as published.

    Raises:
        ValueError: a gain that is not positive and finite, an unknown scheme.

    Source:
        Almeida et al. (2007), section 3.2 of the paper.
    """

    c1: Any
    c2: Any
    c3: Any
    scheme: str = eqx.field(static=True)

    def __init__(self, c1: Any, c2: Any, c3: Any, scheme: str = "implicit"):
        check_gains(scheme, c1=c1, c2=c2, c3=c3)
        self.c1, self.c2, self.c3, self.scheme = gain(c1), gain(c2), gain(c3), scheme

    @property
    def relative_degree(self) -> int:
        """Two."""
        return 2

    @property
    def kernel(self) -> tuple[float, ...]:
        """w[k] = ½ (γ[k] + γ[k-1]) in the implicit form."""
        return (0.5, 0.5) if self.scheme == "implicit" else (1.0,)

    def init(self, y: Output, rates: Rates) -> SecondOrderState:
        """Start on the measurement with its rough velocity."""
        return SecondOrderState(y, rates[0], jnp.zeros_like(y))

    def rates(self, state: SecondOrderState) -> Rates:
        """x̂₂."""
        return state.x2[None]

    def step(
        self,
        state: SecondOrderState,
        y: Output,
        y_next: Output,
        drift: Output,
        sample_period: Scalar,
    ) -> tuple[SecondOrderState, Observation]:
        """One step of eq. (9)."""
        advance = self._implicit if self.scheme == "implicit" else self._explicit
        return advance(state, y, y_next, drift, sample_period)

    def _implicit(self, state, y, y_next, drift, h):
        e = y - state.x1
        a = drift + self.c2 * e
        x1 = state.x1 + h * state.x2 + 0.5 * h**2 * a + h * self.c1 * e
        w = jnp.clip((y_next - x1) / h**2, -self.c3, self.c3)
        new = SecondOrderState(x1 + h**2 * w, state.x2 + h * (a + w), drift)
        observed = w + 0.5 * (drift + state.drift)
        rates = (new.x2 - 0.5 * h * a)[None]
        return new, Observation(w, observed, rates, jnp.abs(w) < self.c3)

    def _explicit(self, state, y, y_next, drift, h):
        del y_next
        e = y - state.x1
        injection = self.c3 * jnp.sign(e)
        x1 = state.x1 + h * (state.x2 + self.c1 * e)
        x2 = state.x2 + h * (drift + self.c2 * e + injection)
        # The sampled relay ends in a limit cycle at ω² = c₁/h, where its delay h cancels the
        # damping: amplitude 4 c₃/(π ω²). An error within twice that counts as sliding.
        sliding = jnp.abs(e) <= 8.0 / np.pi * self.c3 * h / self.c1
        new = SecondOrderState(x1, x2, drift)
        return new, Observation(injection, injection + drift, state.x2[None], sliding)
