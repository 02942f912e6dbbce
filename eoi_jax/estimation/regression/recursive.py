r"""The recursive form of the least squares, eqs. (12)–(13), one sample at a time.

    Γ' = -Γ φᵀφ Γ        (12)            Δ̂' = Γ φᵀ (u_eq - φ Δ̂)        (13)

Sampled exactly: Γ₊ = (Γ⁻¹ + φᵀφ)⁻¹ by the matrix inversion lemma. Started from Γ = ∞ it is the
batch solution of `least_squares`; started from a large Γ it differs by the weight of that start.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from eoi_jax._checks import check_positive
from eoi_jax._types import Output, Regressor


class RecursiveState(eqx.Module):
    """Δ̂ and Γ, its covariance for unit noise."""

    increment: Float[Array, " np"]
    covariance: Float[Array, "np np"]


def init(size: int, covariance: float = 1e12) -> RecursiveState:
    """Initial state without information: Δ̂ = 0 and a large Γ.

    Args:
        size: number of parameters.
        covariance: diagonal of Γ, against regressors scaled to order one.
    """
    check_positive("covariance", covariance)
    return RecursiveState(jnp.zeros(size), covariance * jnp.eye(size))


def step(state: RecursiveState, phi: Regressor, target: Output) -> tuple[RecursiveState, Output]:
    """One sample: the new state, and the innovation u_eq - φ Δ̂ it was corrected with."""
    innovation = target - phi @ state.increment
    gain = jnp.linalg.solve(
        jnp.eye(phi.shape[0]) + phi @ state.covariance @ phi.T, phi @ state.covariance
    ).T
    # Joseph form: stays symmetric and positive when Γ falls by many orders of magnitude.
    complement = jnp.eye(phi.shape[1]) - gain @ phi
    covariance = complement @ state.covariance @ complement.T + gain @ gain.T
    return RecursiveState(state.increment + gain @ innovation, covariance), innovation


def recursive_least_squares(
    Phi: Float[Array, "time ny np"], target: Float[Array, "time ny"], covariance: float = 1e12
) -> tuple[Float[Array, "time np"], RecursiveState]:
    """Eqs. (12)–(13) over a record.

    Args:
        Phi: filtered regressors F[φ].
        target: filtered injection F[u_eq].
        covariance: starting Γ for regressors scaled to order one (scaling is done inside).

    Returns:
        Δ̂ after every sample, and the last state.
    """
    scale = jnp.sqrt(jnp.sum(Phi**2, axis=(0, 1)))
    scale = jnp.where(scale > 0, scale, 1.0)

    def body(state: RecursiveState, sample: tuple) -> tuple[RecursiveState, Array]:
        state, _ = step(state, sample[0] / scale, sample[1])
        return state, state.increment / scale

    last, history = jax.lax.scan(body, init(Phi.shape[-1], covariance), (Phi, target))
    return history, RecursiveState(
        last.increment / scale, last.covariance / jnp.outer(scale, scale)
    )
