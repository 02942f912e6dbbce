"""One step of the classical fourth-order Runge-Kutta rule, and the state in its middle.

Source: E. Hairer, S. P. Nørsett, G. Wanner, *Solving Ordinary Differential Equations I*, section
II.1, and section II.6 on dense output.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax

from eoi_jax._types import Scalar

X = TypeVar("X")  # arrays, in any pytree


def runge_kutta_step(
    rate: Callable[[X, Any], X], x: X, h: Scalar | float, signals: tuple[Any, Any, Any]
) -> tuple[X, tuple[X, X]]:
    """The state at the end of a step.

    Args:
        rate: dx/dt of a state and the signals at one instant.
        x: state at the start, arrays in any pytree.
        h: length of the step [s].
        signals: what else the rate depends on (time, inputs) at the start, in the middle and at
            the end of the step.

    Returns:
        The state at the end, and the slopes of the first and of the last stage: dx/dt at the start
        and, to third order in h, at the end.
    """
    start, middle, end = signals
    k1 = rate(x, start)
    k2 = rate(_moved(x, 0.5 * h, k1), middle)
    k3 = rate(_moved(x, 0.5 * h, k2), middle)
    k4 = rate(_moved(x, h, k3), end)
    slope = jax.tree.map(lambda a, b, c, d: a + 2.0 * b + 2.0 * c + d, k1, k2, k3, k4)
    return _moved(x, h / 6.0, slope), (k1, k4)


def middle_of_step(x: X, end: X, slopes: tuple[X, X], h: Scalar | float) -> X:
    """The state in the middle of a step, on the cubic through both ends with their slopes.

    Args:
        x: state at the start.
        end: state at the end, like `slopes` of `runge_kutta_step`.
        slopes: dx/dt at both.
        h: length of the step [s].
    """
    first, last = slopes
    return jax.tree.map(
        lambda x, end, first, last: 0.5 * (x + end) + h / 8.0 * (first - last), x, end, first, last
    )


def _moved(x: X, h: Scalar | float, slope: X) -> X:
    return jax.tree.map(lambda x, slope: x + h * slope, x, slope)
