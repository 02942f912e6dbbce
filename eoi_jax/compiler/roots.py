r"""Roots whose derivative is finite where they reach zero.

The derivative of $\sqrt x$, of $\sqrt[3]{x}$ and of $x^p$ with $0 < p < 1$ has no bound at zero,
and 0·∞ is not a number: one sample of a vessel that is empty, or of a solid that is dissolved,
leaves a free run without derivatives. These have the derivative zero there, and below zero where
they are no real number; their values are those of JAX.

    with_safe_roots(function)(x)  # the same values, such derivatives

They are primitives, so that a scalar program (`trace.py`) has the plain operation in their place,
whose derivative (`derivatives.py`) is the same.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from eoi_jax.compiler.jax_private import elementwise, jaxpr_as_fun, with_primitives


def _power_by_base(dx: Any, x: Any, p: Any) -> Any:
    flat = (x <= 0) & (p > 0) & (p < 1)
    slope = p * _safe_pow.bind(jnp.where(flat, 1.0, x), jnp.where(p == 0, 1.0, p - 1.0))
    return dx * jnp.where(flat | (p == 0), 0.0, slope)


def _power_by_exponent(dp: Any, x: Any, p: Any) -> Any:
    positive = x > 0
    base = jnp.where(positive, x, 1.0)
    return dp * jnp.where(positive, jnp.log(base) * _safe_pow.bind(base, p), 0.0)


def _square_root(dx: Any, x: Any) -> Any:
    positive = x > 0
    return dx * jnp.where(positive, 0.5 / _safe_sqrt.bind(jnp.where(positive, x, 1.0)), 0.0)


def _cube_root(dx: Any, x: Any) -> Any:
    safe = jnp.where(x == 0, 1.0, x)
    return dx * jnp.where(x == 0, 0.0, _safe_cbrt.bind(safe) / (3.0 * safe))


_safe_pow = elementwise("safe_pow", lax.pow, _power_by_base, _power_by_exponent)
_safe_sqrt = elementwise("safe_sqrt", lax.sqrt, _square_root)
_safe_cbrt = elementwise("safe_cbrt", lax.cbrt, _cube_root)

_SAFE = {"pow": _safe_pow, "sqrt": _safe_sqrt, "cbrt": _safe_cbrt}


def with_safe_roots(function: Callable) -> Callable:
    """The same function with such roots in place of those of JAX.

    Functions whose author gave the derivative keep it.

    Args:
        function: of trees of arrays, gives one array; traced once in each call.
    """

    def safe(*args: Any) -> Any:
        closed = with_primitives(jax.make_jaxpr(function)(*args), _SAFE)
        return jaxpr_as_fun(closed)(*jax.tree.leaves(args))[0]

    return safe
