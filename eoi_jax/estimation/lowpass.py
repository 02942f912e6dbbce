r"""The low-pass filter of eq. (19), of any order, applied to both sides of a regression.

    ÿ_f + √2 ω_c ẏ_f + ω_c² y_f = ω_c² u_f        (19)

is the Butterworth filter of order two. The least squares use F[u_eq] and F[φ]: the *same* filter on
both, so that F[u_eq] = F[φ] Δθ holds whatever the filter's phase.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from eoi_jax._checks import check_count, check_positive
from eoi_jax.compiler.jax_private import Tracer


class DiscreteFilter(eqx.Module):
    """One sampled filter: ``state ← transition @ state + entry * input``; output is state[0].

    Attributes:
        transition: shape (order, order).
        entry: shape (order,).
    """

    transition: Float[Array | np.ndarray, "order order"]
    entry: Float[Array | np.ndarray, " order"]

    def step(
        self, state: Float[Array, "order *signal"], value: Float[Array, "*signal"]
    ) -> Float[Array, "order *signal"]:
        """One sample for any number of signals at once; ``state[0]`` is the output."""
        columns = (-1,) + (1,) * value.ndim
        transition, entry = jnp.asarray(self.transition), jnp.asarray(self.entry)
        # Not as a matrix product: from eight columns on XLA calls a library for it, which makes the
        # loop thirty times slower.
        moved = sum(transition[:, k].reshape(columns) * row for k, row in enumerate(state))
        return moved + entry.reshape(columns) * value


class LowPass(eqx.Module):
    r"""Butterworth low-pass of any order; order two is eq. (19).

    Args:
        cutoff: ω_c [rad/s]; inside JAX code also a traced number.
        order: number of poles, 1 or more.

    Raises:
        ValueError: a cut-off that is not positive, an order below 1.
    """

    cutoff: Any
    order: int = eqx.field(static=True)

    def __init__(self, cutoff: Any, order: int = 2):
        if not isinstance(cutoff, Tracer):
            check_positive("cutoff", cutoff, "It is an angular frequency in rad/s.")
            cutoff = float(cutoff)
        self.cutoff = cutoff
        self.order = check_count("order", order)

    def denominator(self) -> Float[np.ndarray, " order_plus_1"]:
        """Coefficients of the denominator in s/ω_c, highest power first."""
        k = np.arange(self.order)
        poles = np.exp(1j * np.pi * (2 * k + self.order + 1) / (2 * self.order))
        return np.real(np.poly(poles))

    def discretise(self, sample_period: Any) -> DiscreteFilter:
        """Sampled filter, exact for an input that is constant over each step (as step means are).

        Args:
            sample_period: h [s], also a traced number.

        Returns:
            The sampled filter, in the companion form of time scaled by ω_c (well conditioned at
            any order and any ω_c h).
        """
        n = self.order
        a = np.zeros((n + 1, n + 1))
        a[: n - 1, 1:n] = np.eye(n - 1)
        a[n - 1, :n] = -self.denominator()[:0:-1]
        a[n - 1, n] = 1.0  # the input, held over the step, as one more state
        exponent = a * self.cutoff * sample_period
        if isinstance(exponent, jax.Array):
            discrete = jax.scipy.linalg.expm(exponent)
        else:
            from scipy.linalg import expm  # slow to import

            discrete = expm(exponent)
        return DiscreteFilter(discrete[:n, :n], discrete[:n, n])

    @property
    def memory(self) -> float:
        """Time after which the impulse response has decayed to about 1 % [s]."""
        slowest = np.cos(np.pi * (self.order - 1) / (2 * self.order))
        return float(np.log(100.0) / (self.cutoff * slowest))
