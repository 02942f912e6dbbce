r"""Least squares from normal equations, eq. (11), also where the data do not determine all of Δθ.

    Δθ = [∫ φᵀφ]⁻¹ ∫ φᵀ u_eq        (11)

Columns are scaled to unit length first, so that parameters of different size and unit have equal
weight. θ does not move in directions without information (the smallest Δθ), which are reported.
"""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from eoi_jax.compiler.programs import jit

Host = Array | np.ndarray


class Solution(eqx.Module):
    """Δθ and the directions in which the data determine it; of several systems on leading axes.

    Attributes:
        increment: Δθ, shape (np,); zero for fixed parameters.
        inverse: [Σ φᵀφ]⁻¹ in the identified directions, shape (np, np).
        eigenvalues: of the information matrix with columns scaled to one, ascending.
        directions: its eigenvectors in scaled parameters, as columns.
        identified: which of them carry information.
        scale: length of each regressor column [unit of y^(r) per unit of the parameter].
    """

    increment: Float[Host, "*systems np"]
    inverse: Float[Host, "*systems np np"]
    eigenvalues: Float[Host, "*systems np"]
    directions: Float[Host, "*systems np np"]
    identified: Bool[Host, "*systems np"]
    scale: Float[Host, "*systems np"]


def least_squares(
    information: Float[Host, "*systems np np"],
    rhs: Float[Host, "*systems np"],
    free: Float[Host, "*#systems np"],
    damping: float | Float[Host, "*#systems"] = 0.0,
) -> Solution:
    r"""Solve $\sum\varphi^\top\varphi\,\Delta\theta = \sum\varphi^\top u_{eq}$, eq. (11).

    Args:
        information: Σ φᵀφ over scored samples.
        rhs: Σ φᵀ u_eq.
        free: 1 for an estimated parameter, 0 for a fixed one.
        damping: added to the eigenvalues in the increment, which it shortens where they are
            small (Levenberg); for a model that is not affine in θ.

    Returns:
        Δθ, and the directions of θ that the data determine. NumPy arrays give NumPy arrays.
    """
    arguments = information, rhs, free, damping
    if any(isinstance(array, jax.Array) for array in arguments):
        return _compiled(*arguments)
    with np.errstate(all="ignore"):  # of what is not finite
        return _solved(np, _eigen, *arguments)


@jit(static=())
def _compiled(information: Any, rhs: Any, free: Any, damping: Any) -> Solution:
    return _solved(jnp, jnp.linalg.eigh, information, rhs, free, damping)


def _solved(
    xp: Any,
    eigen: Callable,
    information: Any,
    rhs: Any,
    free: Any,
    damping: Any,
    rounding_errors: float = 100.0,
) -> Solution:
    """`least_squares` by NumPy or JAX; eigenvalues of so many rounding errors count as zero."""
    length = xp.sqrt(xp.maximum(xp.diagonal(information, axis1=-2, axis2=-1), 0.0)) * free
    scale = xp.where(length > 0, length, 1.0)
    active = free * (length > 0)
    sizes, both_active = _outer(scale), _outer(active)
    # Fixed parameters: directions of their own.
    fixed = (1.0 - free)[..., None] * xp.eye(free.shape[-1], dtype=information.dtype)
    eigenvalues, directions = eigen(information / sizes * both_active + fixed)
    threshold = rounding_errors * information.shape[-1] * xp.finfo(information.dtype).eps
    identified = eigenvalues > threshold * xp.maximum(eigenvalues[..., -1:], 0.0)
    identified &= eigenvalues > 0
    safe = xp.where(identified, eigenvalues, 1.0)
    # Only rounding puts a parameter without information into an identified direction.
    unscale = both_active / sizes

    def inverted(values: Any) -> Any:
        weighed = directions * xp.where(identified, 1.0 / values, 0.0)[..., None, :]
        return weighed @ xp.swapaxes(directions, -1, -2) * unscale

    damped = safe + xp.asarray(damping)[..., None]
    increment = (inverted(damped) @ rhs[..., None])[..., 0]
    return Solution(increment, inverted(safe), eigenvalues, directions, identified, scale)


def _outer(values: Any) -> Any:
    return values[..., :, None] * values[..., None, :]


def _eigen(matrix: Float[np.ndarray, "*systems np np"]) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues and directions; NaN of a matrix that is not finite."""
    finite = np.all(np.isfinite(matrix), axis=(-1, -2))
    values, vectors = np.linalg.eigh(np.where(finite[..., None, None], matrix, 0.0))
    values = np.where(finite[..., None], values, np.nan)
    return values, np.where(finite[..., None, None], vectors, np.nan)


def untraced(solution: Solution, names: Sequence[str], free: Float[np.ndarray, " np"]) -> list[str]:
    """Combinations of free parameters that left no trace in the data, as text.

    Args:
        solution: of the least squares.
        names: of the parameters.
        free: 1 for an estimated parameter, 0 for a fixed one, as it was solved with.

    Returns:
        For example ``["mass"]`` or ``["0.71 b + 0.70 c"]``, in parameters' own units; empty if
        every direction was identified.
    """
    combinations = []
    for value, direction in zip(
        np.asarray(solution.identified), np.asarray(solution.directions).T, strict=True
    ):
        if value:
            continue
        # Undone scaling: a direction in scaled parameters moves θ by direction / scale.
        vector = direction / np.asarray(solution.scale) * free
        vector = vector / np.max(np.abs(vector))
        terms = [
            (weight, name) for weight, name in zip(vector, names, strict=True) if abs(weight) > 1e-3
        ]
        if len(terms) == 1:
            combinations.append(terms[0][1])
        else:
            combinations.append(" ".join(f"{weight:+.2g}·{name}" for weight, name in terms))
    return combinations


def unidentified_directions(
    information: Float[np.ndarray, "np np"], free: Float[np.ndarray, " np"]
) -> Float[np.ndarray, "np k"]:
    """Directions of θ without information, each with a largest component of 1.

    Args:
        information: Σ φᵀφ.
        free: 1 for an estimated parameter, 0 for a fixed one.

    Returns:
        One direction a column.
    """
    solution = least_squares(information, np.zeros(len(free)), free)
    unidentified = ~np.asarray(solution.identified)
    scaled = np.asarray(solution.directions)[:, unidentified]
    # Remove rounding errors.
    scaled = np.where(np.abs(scaled) > 1e-6, scaled, 0.0)
    directions = scaled / np.asarray(solution.scale)[:, None] * free[:, None]
    return directions / np.max(np.abs(directions), axis=0, initial=1e-300)


def standard_errors(
    covariance: Float[np.ndarray, "np np"],
    information: Float[np.ndarray, "np np"],
    free: Float[np.ndarray, " np"],
) -> Float[np.ndarray, " np"]:
    """Square roots of the variances; infinite for parameters that the data do not determine.

    Args:
        covariance: in the identified directions.
        information: Σ φᵀφ.
        free: 1 for an estimated parameter, 0 for a fixed one, or one on its bound.
    """
    errors = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    if not np.all(np.isfinite(information)):
        return errors
    return np.where(np.any(unidentified_directions(information, free) != 0, axis=1), np.inf, errors)
