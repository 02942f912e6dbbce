r"""The recursive form of the least squares, eqs. (12)–(13), one sample at a time.

    Γ' = -Γ φᵀφ Γ        (12)            Δ̂' = Γ φᵀ (u_eq - φ Δ̂)        (13)

Sampled exactly, Γ₊⁻¹ = λ Γ⁻¹ + φᵀ W φ and Δ̂₊ = Δ̂ + Γ₊ φᵀ W (u_eq - φ Δ̂), with the weights W of
the outputs and the forgetting factor λ; (12) has W = 1 and λ = 1. Kept here is the information Γ⁻¹
and Γ⁻¹Δ̂ = Σ φᵀ W u_eq (the information form), not Γ: it starts from Γ = ∞ without a large number
that would cost digits, and without forgetting it ends with the sums of the batch form (11).

With instrumental variables ζ in place of the first φ of both products, Γ₊⁻¹ = λ Γ⁻¹ + ζᵀ W φ and
Δ̂₊ = Δ̂ + Γ₊ ζᵀ W (u_eq - φ Δ̂): recursive instrumental variables (P. C. Young, Automatica 6 (1970)
271).
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_factor, cho_solve, solve_triangular
from jaxtyping import Array, Float

from eoi_jax._checks import check, check_shape, real
from eoi_jax._types import Output, Regressor
from eoi_jax.compiler.jax_private import Tracer


class RecursiveState(eqx.Module):
    """The estimate after a sample.

    Attributes:
        increment: Δ̂, shape (np,); zero in directions of θ without information so far.
        information: Γ⁻¹ = Σ φᵀ W φ, shape (np, np).
        rhs: Σ φᵀ W u_eq, shape (np,).
        lost: what both sums lack by rounding, with compensated sums.
    """

    increment: Float[Array, " np"]
    information: Float[Array, "np np"]
    rhs: Float[Array, " np"]
    lost: tuple[Float[Array, "np np"], Float[Array, " np"]] | None = None

    @property
    def covariance(self) -> Float[Array, "np np"]:
        """Γ: the covariance of Δ̂ where W is that of the noise, inverted; large without data."""
        return information_inverse(self.information)


class RecursiveLeastSquares(eqx.Module):
    r"""Recursive least squares, eqs. (12)–(13), for a loop of one's own: `init`, `step` by sample.

    Pure functions of arrays, for `jit`, `vmap`, `grad`, `jvp` and `lax.scan`. `recursive` runs over
    a whole record.

    Args:
        forgetting: λ in (0, 1], by which the weight of all samples so far falls with each new one:
            the estimate remembers about 1/(1 - λ) samples. 1: all of them, as the batch form does.
        compensated: whether sums keep what rounding takes from them (W. Kahan, Communications of
            the ACM 8 (1965) 40): in single precision a million samples add up to more than one
            sample can change.

    Raises:
        ValueError: a factor outside (0, 1].

    Source:
        Eqs. (12) and (13) of the paper; forgetting as in L. Ljung, *System Identification*, 2nd
        ed., section 11.2.
    """

    forgetting: Any
    compensated: bool = eqx.field(static=True)

    def __init__(self, forgetting: Any = 1.0, compensated: bool = False):
        if not isinstance(forgetting, Tracer):
            valid = 0.0 < real(forgetting) <= 1.0
            advice = "1 forgets nothing, 0.999 remembers about a thousand samples."
            check(valid, "forgetting", "must lie in (0, 1]", forgetting, advice)
        self.forgetting, self.compensated = forgetting, compensated

    def init(self, size: int) -> RecursiveState:
        """State without information.

        Args:
            size: number of parameters np.
        """
        sums = jnp.zeros((size, size)), jnp.zeros(size)
        return RecursiveState(jnp.zeros(size), *sums, sums if self.compensated else None)

    def step(
        self,
        state: RecursiveState,
        phi: Regressor,
        target: Output,
        weights: Any = 1.0,
        instruments: Regressor | None = None,
    ) -> tuple[RecursiveState, Output]:
        """One sample.

        Args:
            state: before it.
            phi: regressors F[φ], shape (ny, np).
            target: injection F[u_eq], shape (ny,).
            weights: of the outputs, a number or (ny,): the inverse variances of their noise, up to
                a factor; 0 for what does not count. Where nothing counts, nothing is forgotten.
            instruments: ζ, shape (ny, np), for recursive instrumental variables; by default φ.

        Returns:
            The state after the sample, and the innovation u_eq - φ Δ̂ that it was corrected with.
        """
        w = jnp.broadcast_to(jnp.asarray(weights, phi.dtype), target.shape)
        remembered = jnp.where(jnp.any(w > 0), self.forgetting, 1.0)
        weighted = (phi if instruments is None else instruments).T * w
        added, lost = (weighted @ phi, weighted @ target), state.lost
        if lost is not None:
            added = tuple(new + remembered * old for new, old in zip(added, lost, strict=True))
        past = remembered * state.information, remembered * state.rhs
        information, rhs = past[0] + added[0], past[1] + added[1]
        if lost is not None:
            lost = added[0] - (information - past[0]), added[1] - (rhs - past[1])
        solve, scale = _solver(information, instruments is None)
        increment = solve(rhs / scale) / scale
        return RecursiveState(increment, information, rhs, lost), target - phi @ state.increment


def recursive(
    regressors: Any, injection: Any, weights: Any = None, *, forgetting: Any = 1.0
) -> tuple[Float[Array, "time np"], RecursiveState]:
    r"""Recursive least squares (12)–(13) over a record, a pure function of arrays.

    With what `observe` returns at θ, ``theta + recursive(p.regressors, p.injection, p.score)[0]``
    are the parameters over time. Without forgetting the last ones are the batch estimate.

    Args:
        regressors: F[φ], shape (N, ny, np).
        injection: F[u_eq], shape (N, ny).
        weights: of the samples, shape (N, ny) or (N,): `ObserverPass.score`, where there are
            several outputs times the inverse variance of the noise of each. None: ones.
        forgetting: λ in (0, 1]; the estimate remembers about 1/(1 - λ) samples.

    Returns:
        Δ̂ after every sample, shape (N, np), and the last state.

    Raises:
        ValueError: a wrong shape, a factor outside (0, 1].

    Source:
        Eqs. (12) and (13) of the paper; forgetting as in L. Ljung, *System Identification*, 2nd
        ed., section 11.2.
    """
    estimator = RecursiveLeastSquares(forgetting)
    Phi, target = jnp.asarray(regressors, float), jnp.asarray(injection, float)
    check_shape("regressors", Phi, (None, None, None), "samples, outputs, parameters")
    check_shape("injection", target, Phi.shape[:2], "one row a sample, a column an output")
    w = jnp.ones(target.shape) if weights is None else jnp.asarray(weights, float)
    w = jnp.repeat(w[:, None], target.shape[1], axis=1) if w.ndim == 1 else w
    check_shape("weights", w, target.shape, "one row a sample, a column an output")

    def body(state: RecursiveState, sample: tuple) -> tuple[RecursiveState, Array]:
        state, _ = estimator.step(state, *sample)
        return state, state.increment

    last, history = jax.lax.scan(body, estimator.init(Phi.shape[2]), (Phi, target, w))
    return history, last


def information_inverse(
    information: Float[Array, "np np"], symmetric: bool = True
) -> Float[Array, "np np"]:
    """Γ of an information matrix Σ φᵀφ, or Σ ζᵀφ, which is not symmetric; large without data."""
    solve, scale = _solver(information, symmetric)
    return solve(jnp.eye(len(scale), dtype=scale.dtype)) / jnp.outer(scale, scale)


def _solver(information: Float[Array, "np np"], symmetric: bool) -> tuple[Any, Float[Array, " np"]]:
    """Solution of systems with an information matrix, in parameters scaled to a diagonal of one.

    A small number is added to the diagonal, so that directions without information keep zero; one
    step of refinement takes its influence out of the others.

    Args:
        information: Σ φᵀφ, or Σ ζᵀφ.
        symmetric: whether it is the former.

    Returns:
        The function that solves for scaled right-hand sides, and the scale of each parameter.
    """
    diagonal = jnp.abs(jnp.diagonal(information))
    scale = jnp.sqrt(jnp.where(diagonal > 0, diagonal, 1.0))
    scaled = information / jnp.outer(scale, scale)
    # Between rounding, which it divides, and the directions that are to be identified.
    ridge = jnp.finfo(information.dtype).eps ** (2.0 / 3.0)
    regular = scaled + ridge * jnp.eye(len(scale), dtype=scale.dtype)
    solved = _factorised(regular, symmetric)

    def solve(rhs: Array) -> Array:
        solution = solved(rhs)
        return solution + solved(rhs - scaled @ solution)

    return solve, scale


def _factorised(matrix: Float[Array, "np np"], symmetric: bool) -> Callable[[Array], Array]:
    """Solution of systems with a matrix, symmetric and positive definite or any."""
    if symmetric:
        return partial(cho_solve, cho_factor(matrix))
    factors, _, order = jax.lax.linalg.lu(matrix)

    def solved(rhs: Array) -> Array:
        forward = solve_triangular(factors, rhs[order], lower=True, unit_diagonal=True)
        return solve_triangular(factors, forward)

    return solved
