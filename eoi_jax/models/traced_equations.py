"""The equations of a model inside functions that are traced: once for all of these.

A step of Runge-Kutta evaluates them four times; its derivatives, the fastest mode of the model and
the scales of its parameters are programs of their own. What JAX remembers of a function it uses
again where the function is the same: here it is the same for equal equations. Their roots have
finite derivatives where they reach zero (`roots.py`).
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from eoi_jax._types import Scalar
from eoi_jax.compiler.jax_private import tracing
from eoi_jax.compiler.roots import with_safe_roots
from eoi_jax.models.parameters import parameter_type


def evaluated(
    function: Callable, names: tuple[str, ...], t: Scalar, x: Any, u: Any, theta: Any
) -> Float[Array, "..."]:
    """A function of the model, f or g, at an instant.

    Args:
        function: equal to what computes the same; traced anew each time where it has no hash.
        names: of the parameters.
        t: the instant [s].
        x: state there.
        u: inputs there.
        theta: values of the parameters, shape (np,).
    """
    if not tracing():
        return _equations(function, names)(t, x, u, theta)
    traced = _traced_once if has_hash(function) else _traced
    return traced(function, names)(t, x, u, theta)


def has_hash(function: Callable) -> bool:
    """Whether a function can be compared with others.

    Args:
        function: of the model.
    """
    try:
        hash(function)
    except TypeError:
        return False
    return True


def _equations(function: Callable, names: tuple[str, ...]) -> Callable:
    def equations(t: Any, x: Any, u: Any, theta: Any) -> Array:
        return jnp.asarray(function(t, x, u, parameter_type(names)(*theta)))

    return equations


def _traced(function: Callable, names: tuple[str, ...]) -> Callable:
    return with_safe_roots(_equations(function, names))


@functools.lru_cache(maxsize=64)
def _traced_once(function: Callable, names: tuple[str, ...]) -> Callable:
    """For the models that were used last; what JAX remembers of a function goes with it."""
    return jax.jit(_traced(function, names))
