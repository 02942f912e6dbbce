r"""Instrumental variables: the normal equations of (11) with instruments free of noise.

    Δθ = [Σ ζᵀψ]⁻¹ Σ ζᵀe

Source: P. C. Young, *Recursive Estimation and Time-Series Analysis*, 2nd ed., chapters 7 and 8;
T. Söderström, P. Stoica, *Instrumental Variable Methods for System Identification*, eq. (4.33).
"""

import numpy as np
from jaxtyping import Float

from eoi_jax.estimation.regression.orthonormal import informative_directions


def instrumental_variables(
    cross: Float[np.ndarray, "np np"],
    information: Float[np.ndarray, "np np"],
    rhs: Float[np.ndarray, " np"],
    free: Float[np.ndarray, " np"],
) -> tuple[Float[np.ndarray, " np"], Float[np.ndarray, "np np"]]:
    r"""Solve $\sum\zeta^\top\psi\,\Delta\theta = \sum\zeta^\top e$ where ζ carries information.

    Args:
        cross: Σ ζᵀψ, instruments by rows.
        information: Σ ζᵀζ.
        rhs: Σ ζᵀe.
        free: 1 for an estimated parameter, 0 for a fixed one.

    Returns:
        Δθ, and [Σ ζᵀψ]⁻¹ in the identified directions; zero for fixed parameters. Not finite where
        the instruments do not determine Δθ.
    """
    basis, _ = informative_directions(information * np.outer(free, free))
    inner = basis.T @ cross @ basis
    try:
        inverse = basis @ np.linalg.inv(inner) @ basis.T
    except np.linalg.LinAlgError:
        inverse = np.full_like(cross, np.nan)
    return inverse @ rhs, inverse


def within_bounds(
    cross: Float[np.ndarray, "np np"],
    information: Float[np.ndarray, "np np"],
    rhs: Float[np.ndarray, " np"],
    free: Float[np.ndarray, " np"],
    room: tuple[Float[np.ndarray, " np"], Float[np.ndarray, " np"]],
) -> tuple[Float[np.ndarray, " np"], Float[np.ndarray, "np np"]]:
    """`instrumental_variables` within bounds: parameters beyond a bound are fixed on it.

    Args:
        cross: Σ ζᵀψ.
        information: Σ ζᵀζ.
        rhs: Σ ζᵀe.
        free: 1 for an estimated parameter, 0 for a fixed one.
        room: smallest and largest Δθ, each (np,).

    Returns:
        Δθ, and [Σ ζᵀψ]⁻¹ of the parameters inside their bounds.
    """
    moved, active = np.zeros_like(rhs), free.copy()
    while True:  # each round fixes at least one parameter
        increment, inverse = instrumental_variables(cross, information, rhs - cross @ moved, active)
        violated = (active > 0) & ((increment < room[0]) | (increment > room[1]))
        if not np.any(violated):
            return moved + increment, inverse
        moved = np.where(violated, np.clip(increment, *room), moved)
        active = np.where(violated, 0.0, active)
