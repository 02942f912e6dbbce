r"""Levant's homogeneous observer for outputs of any relative degree r ≥ 1.

    x̂ᵢ' = x̂ᵢ₊₁ + kᵢ |e|^((r-i)/r) sign e   (i < r),     x̂ᵣ' = f + kᵣ sign e,     kᵢ = λᵢ L^(i/r)

r = 2 is the super-twisting observer. Implicit form: the whole chain at the end of the step. With
ρ = |e₊|^(1/r), s ∈ Sign(e₊) and b = y[k+1] - (x₁ + h x₂ + … + h^(r-1) xᵣ + h^r f),

    |b| ≤ h^r kᵣ:  ρ = 0, s = b/(h^r kᵣ)
    else:          ρ^r + h k₁ ρ^(r-1) + … + h^(r-1) kᵣ₋₁ ρ + h^r kᵣ = |b|,  s = sign b

The polynomial is convex and increasing for ρ ≥ 0, so Newton's method from ρ = |b|^(1/r), which
lies above the root, converges to it from above. In sliding mode xᵢ₊₁ = ∇ⁱy/hⁱ, i backward
differences.
"""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from eoi_jax._checks import check, check_count
from eoi_jax._types import Output, Rates, Scalar
from eoi_jax.estimation.observers.observer import AbstractObserver, Observation, check_gains, gain

# Gains λ for L = 1, Levant's in the non-recursive form.
_LAMBDAS = {
    1: (1.1,),
    2: (1.5, 1.1),
    3: (2.0, 2.12, 1.1),
    4: (3.0, 4.16, 3.06, 1.1),
    5: (5.0, 10.03, 9.30, 4.57, 1.1),
}


class HighOrder(AbstractObserver):
    """Homogeneous observer of relative degree r; implicit only.

    Args:
        bound: L, above the model's error [unit of y^(r)].
        degree: r.
        lambdas: λ₁ … λᵣ; default for r ≤ 5: Levant's.

    Raises:
        ValueError: a gain that is not positive and finite, a degree below 1, not r gains λ.

    Source:
        Levant (2003), *Higher-order sliding modes, differentiation and output-feedback control*.
    """

    bound: Any
    degree: int = eqx.field(static=True)
    lambdas: tuple[float, ...] = eqx.field(static=True)
    scheme: str = eqx.field(static=True)

    def __init__(self, bound: Any, degree: int, lambdas: tuple[float, ...] | None = None):
        check_gains("implicit", bound=bound)
        degree = check_count("degree", degree)
        check(
            lambdas is not None or degree in _LAMBDAS,
            "lambdas",
            f"must be given for a relative degree above {max(_LAMBDAS)}",
            f"degree {degree}",
        )
        chosen = _LAMBDAS[degree] if lambdas is None else tuple(lambdas)
        check(len(chosen) == degree, "lambdas", f"must be {degree} gains", chosen)
        check_gains("implicit", lambdas=chosen)
        self.bound, self.degree, self.lambdas = gain(bound), degree, chosen
        self.scheme = "implicit"

    @property
    def relative_degree(self) -> int:
        """r."""
        return self.degree

    @property
    def kernel(self) -> tuple[float, ...]:
        """Weights per step of the r-th backward difference: Eulerian numbers over r!."""
        r = self.degree
        eulerian = [
            sum((-1) ** j * math.comb(r + 1, j) * (i + 1 - j) ** r for j in range(i + 1))
            for i in range(r)
        ]
        return tuple(number / math.factorial(r) for number in eulerian)

    def init(self, y: Output, rates: Rates) -> Float[Array, "r ny"]:
        """Start on the measurement with its rough rates."""
        return jnp.concatenate([y[None], rates[: self.degree - 1]])

    def rates(self, state: Float[Array, "r ny"]) -> Rates:
        """x̂₂ … x̂ᵣ."""
        return state[1:]

    def step(
        self,
        state: Float[Array, "r ny"],
        y: Output,
        y_next: Output,
        drift: Output,
        sample_period: Scalar,
    ) -> tuple[Float[Array, "r ny"], Observation]:
        """One implicit step of the chain."""
        del y
        r, h = self.degree, sample_period
        gains = [lam * self.bound ** ((i + 1) / r) for i, lam in enumerate(self.lambdas)]
        b = y_next - drift * h**r - sum(state[i] * h**i for i in range(r))
        width = h**r * gains[-1]
        sliding = jnp.abs(b) <= width
        s = jnp.where(sliding, b / width, jnp.sign(b))
        rho = jnp.where(sliding, 0.0, self._root(jnp.abs(b), gains, h))
        injection = gains[-1] * s
        chain = [state[r - 1] + h * (drift + injection)]
        for i in range(r - 2, -1, -1):
            chain.insert(0, state[i] + h * chain[0] + h * gains[i] * rho ** (r - 1 - i) * s)
        new = jnp.stack(chain)
        observed = injection + drift
        return new, Observation(injection, observed, self._middle(new, observed, h), sliding)

    def _root(self, b: Output, gains: list, h: Scalar, iterations: int = 12) -> Output:
        """ρ of an error beyond the sliding set, by a fixed number of Newton steps from above."""
        r = self.degree

        def newton(_: Any, rho: Output) -> Output:
            value, slope = jnp.ones_like(rho), jnp.zeros_like(rho)
            for i in range(r):  # Horner, highest power first
                slope = slope * rho + value
                value = value * rho + h ** (i + 1) * gains[i]
            return jnp.maximum(rho - (value - b) / slope, 0.0)

        start = jnp.maximum(b, jnp.finfo(b.dtype).tiny) ** (1.0 / r)
        return jax.lax.fori_loop(0, iterations, newton, start)

    def _middle(self, new: Float[Array, "r ny"], observed: Output, h: Scalar) -> Rates:
        """∇ⁱy/hⁱ lags the middle of the step by (i-1)h/2, and is extrapolated by its rate."""
        rows = jnp.concatenate([new, observed[None]])
        lag = 0.5 * h * jnp.arange(self.degree - 1)[:, None]
        return rows[1:-1] + lag * rows[2:]
