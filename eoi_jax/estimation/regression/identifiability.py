r"""What of the parameters can be told, in words, where not all of them can.

Along a direction d of θ nothing shows (or next to nothing). Parameters that scale together have the
same d_i/θ_i: of a model that knows them by their ratios only, d = θ, and what can be told are the
ratios. So d is looked at twice, as relative changes, whose small whole numbers are exponents of
products, and as it is, whose small whole numbers are factors of sums.
"""

from collections.abc import Sequence
from fractions import Fraction

import numpy as np
from jaxtyping import Float

_WHOLE = 3  # the largest exponent that is taken for one
_BELONGS = 0.02  # of the largest weight, below which a parameter is no part of a direction


def told(
    directions: Float[np.ndarray, "np k"],
    theta: Float[np.ndarray, " np"],
    names: Sequence[str],
    tolerance: float,
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Which parameters some directions move, and what stays as it is along all of them.

    Args:
        directions: of θ, in which nothing can be told; linearly independent.
        theta: the parameters [their units].
        names: of the parameters.
        tolerance: by which a weight may differ from a whole number.

    Returns:
        Names of the parameters that cannot be told on their own, and what can: ``("a/c", "b/c")``,
        or ``("a + b",)``; empty where neither products nor sums say it, or both do (then one point
        does not tell which it is).
    """
    inside = np.max(np.abs(_scaled(directions, theta)), axis=1) > _BELONGS
    involved = tuple(name for name, one in zip(names, inside, strict=True) if one)
    some = directions[inside]
    forms = []
    if np.all(theta[inside] != 0):
        forms.append(_kept(some / theta[inside][:, None], tolerance, involved, _product))
    forms.append(_kept(some, tolerance, involved, _sum))
    found = [one for one in forms if one is not None]
    return involved, found[0] if len(found) == 1 else ()


def in_weights(
    direction: Float[np.ndarray, " np"], theta: Float[np.ndarray, " np"], names: Sequence[str]
) -> str:
    """A direction of θ as text, in the parameters' own units: ``+1·a -0.5·b``."""
    inside = np.abs(_scaled(direction[:, None], theta)[:, 0]) > _BELONGS
    weights = direction / np.max(np.abs(direction[inside]))
    weights = weights * np.sign(weights[inside][0])
    return " ".join(
        f"{weight:+.2g}·{name}"
        for weight, name, one in zip(weights, names, inside, strict=True)
        if one
    )


def _scaled(directions: np.ndarray, theta: np.ndarray) -> Float[np.ndarray, "np k"]:
    """Relative changes of the parameters, the largest one; of a zero, as it is."""
    relative = directions / np.where(theta != 0, np.abs(theta), 1.0)[:, None]
    return relative / np.max(np.abs(relative), axis=0)


def _kept(
    directions: np.ndarray, tolerance: float, names: Sequence[str], written: object
) -> tuple[str, ...] | None:
    """What is constant along the directions, if small whole numbers say it."""
    rows, pivots = _reduced(directions.T)
    others = [i for i in range(len(names)) if i not in pivots]
    forms = []
    for i in others:
        fractions = [_fraction(float(value), tolerance) for value in rows[:, i]]
        if any(one is None for one in fractions):
            return None
        common = int(np.lcm.reduce([one.denominator for one in fractions if one is not None]))
        exponents = {i: common}
        for pivot, one in zip(pivots, fractions, strict=True):
            exponents[pivot] = -int((one or Fraction(0)) * common)
        if max(abs(one) for one in exponents.values()) > _WHOLE:
            return None
        terms = [(names[j], exponents[j]) for j in sorted(exponents) if exponents[j]]
        forms.append(written(terms))  # type: ignore[operator]
    return tuple(forms)


def _reduced(rows: Float[np.ndarray, "k n"]) -> tuple[Float[np.ndarray, "k n"], list[int]]:
    """Reduced echelon form from the right, and its pivots: the last parameters become divisors."""
    rows, pivots = np.array(rows), []
    for k in range(len(rows)):
        size = np.max(np.abs(rows[k:]), axis=0)
        size[pivots] = 0.0
        # The last column that is not small: a small pivot would blow up what is only rounding.
        pivot = int(np.flatnonzero(size > 0.1 * np.max(size))[-1])
        best = k + int(np.argmax(np.abs(rows[k:, pivot])))
        rows[[k, best]] = rows[[best, k]]
        rows[k] /= rows[k, pivot]
        others = np.arange(len(rows)) != k
        rows[others] -= np.outer(rows[others, pivot], rows[k])
        pivots.append(pivot)
    return rows, pivots


def _fraction(value: float, tolerance: float) -> Fraction | None:
    near = Fraction(value).limit_denominator(_WHOLE)
    return near if abs(float(near) - value) <= tolerance * max(1.0, abs(value)) else None


def _product(terms: Sequence[tuple[str, int]]) -> str:
    """``a·b²/c``; the first name stands above the line."""
    sign = 1 if terms[0][1] > 0 else -1
    above = [_power(name, sign * one) for name, one in terms if sign * one > 0]
    below = [_power(name, -sign * one) for name, one in terms if sign * one < 0]
    line = "·".join(above)
    if not below:
        return line
    return f"{line}/{below[0]}" if len(below) == 1 else f"{line}/({'·'.join(below)})"


def _power(name: str, exponent: int) -> str:
    return name + {1: "", 2: "²", 3: "³"}[exponent]


def _sum(terms: Sequence[tuple[str, int]]) -> str:
    """``a + 2 b - c``."""
    sign = 1 if terms[0][1] > 0 else -1
    text = ""
    for name, one in terms:
        factor = "" if abs(one) == 1 else f"{abs(one)} "
        join = (" + " if sign * one > 0 else " - ") if text else ""
        text += f"{join}{factor}{name}"
    return text
