"""Outputs of relative degree 0: what they may depend on, found by evaluating a model at points."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Array, Bool, Float

from eoi_jax._checks import check

Points = tuple[Array, Array, Array, Array, Array]
Model = Callable[..., tuple[Array, Array]]


def apart(values: Any) -> Any:
    """Each column moved by an amount of its own: a model may read differences of states only.

    Args:
        values: on the last axis.
    """
    return values + 0.1 * np.sqrt(1.0 + np.arange(values.shape[-1]))


def highest_derivative(degrees: Sequence[int]) -> str:
    """What y^(r) is called: the output itself where all relative degrees are zero."""
    return "highest derivative" if any(degrees) else "output"


def check_algebraic(
    outputs: Sequence[str], algebraic: Bool[np.ndarray, " ny"], model: Model, points: Points
) -> None:
    """Check that nothing reads outputs of relative degree 0, and that each depends on something.

    Args:
        outputs: names.
        algebraic: which of them have relative degree 0.
        model: f and g of t, y, z, u and θ, at several points on a leading axis.
        points: where they are evaluated; y is anything for outputs of relative degree 0.

    Raises:
        ValueError: a model that reads such an output, which is no state; or such an output that
            depends on no state and on no parameter.
    """
    t, y, z, u, theta = points
    states = np.where(algebraic, 0.0, y)

    def values(y: Any, z: Any, theta: Any) -> tuple[np.ndarray, np.ndarray]:
        f, g = model(t, y, z, u, theta)
        return np.asarray(f), np.asarray(g)

    f, g = values(states, z, theta)
    moved, _ = values(apart(1.1 * states) * ~algebraic, apart(1.1 * z), theta)
    fitted, _ = values(states, z, apart(1.1 * theta))
    for j, name in enumerate(outputs):
        if not algebraic[j]:
            continue
        raised = np.where(np.arange(len(outputs)) == j, y, states)
        changed_f, changed_g = values(raised, z, theta)
        readers = [key for i, key in enumerate(outputs) if _differ(f[:, i], changed_f[:, i])]
        readers += ["an internal state"] if _differ(g, changed_g) else []
        check(
            not readers,
            "relative_degree",
            f"must be 1 or more for an output that the model reads; with 0, {name} is no state",
            f"0, and {'itself' if readers == [name] else ', '.join(readers)} depends on {name}",
            "Write out the formula of the output instead.",
        )
        check(
            _differ(f[:, j], moved[:, j]) or _differ(f[:, j], fitted[:, j]),
            "dynamics",
            f"must give an output {name} that depends on a state or a parameter",
            "a function of the inputs and of the time alone",
        )


def _differ(a: Float[np.ndarray, "..."], b: Float[np.ndarray, "..."]) -> bool:
    return not np.array_equal(a, b, equal_nan=True)
