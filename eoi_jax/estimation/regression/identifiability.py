r"""Which combinations of parameters the data determine, as text, where not all of them are.

Along a direction d of θ the data change not at all, or hardly. Parameters that scale together have
the same d_i/θ_i: of a model that depends on ratios only, d = θ, and the ratios are identifiable. So
d is examined twice: as relative changes, whose small integers are exponents of products, and
unscaled, whose small integers are factors of sums.
"""

from collections.abc import Callable, Sequence
from fractions import Fraction

import numpy as np
from jaxtyping import Bool, Float, Int

_MAX_EXPONENT = 3  # of a product, or factor of a sum: `_power` writes no other


def identifiable_combinations(
    directions: Float[np.ndarray, "np k"],
    theta: Float[np.ndarray, " np"],
    names: Sequence[str],
    tolerance: float,
    accept: Callable[[Float[np.ndarray, " np"]], bool] | None = None,
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Parameters that are not identifiable, and combinations of them that are.

    Args:
        directions: of θ, along which the data do not change; linearly independent.
        theta: the parameters [their units].
        names: of the parameters.
        tolerance: by which a weight may differ from an integer.
        accept: of the derivatives of a combination by θ, relative ones of a product, whether it is
            worth naming; None: every one is.

    Returns:
        Names of the parameters that are not identifiable by themselves, and the combinations that
        are: ``("a/c", "b/c")`` or ``("a + b",)``; empty where neither products nor sums fit, or
        both do (one point cannot decide between them).
    """
    is_involved = _is_involved(directions, theta)
    involved = tuple(name for name, flag in zip(names, is_involved, strict=True) if flag)
    rows, place = directions[is_involved], np.flatnonzero(is_involved)
    forms = []
    if np.all(theta[is_involved] != 0):
        scale = theta[is_involved]
        forms.append((_product, scale, _invariants(rows / scale[:, None], tolerance)))
    forms.append((_sum, np.ones(len(place)), _invariants(rows, tolerance)))
    unique = [(write, scale, weights) for write, scale, weights in forms if weights is not None]
    if len(unique) != 1:
        return involved, ()
    ((write, scale, combinations),) = unique
    texts = []
    for weights in combinations:
        slope = np.zeros(len(theta))
        slope[place] = weights / scale
        if accept is None or accept(slope):
            terms = zip(involved, weights.tolist(), strict=True)
            texts.append(write([(name, weight) for name, weight in terms if weight]))
    return involved, tuple(texts)


def format_direction(
    direction: Float[np.ndarray, " np"], theta: Float[np.ndarray, " np"], names: Sequence[str]
) -> str:
    """A direction of θ as text, in the parameters' own units: ``+1·a -0.5·b``."""
    is_involved = _is_involved(direction[:, None], theta)
    weights = direction / np.max(np.abs(direction[is_involved]))
    weights = weights * np.sign(weights[is_involved][0])
    return " ".join(
        f"{weight:+.2g}·{name}"
        for weight, name, is_part in zip(weights, names, is_involved, strict=True)
        if is_part
    )


def groups_of(directions: Float[np.ndarray, "np k"]) -> list[list[int]]:
    """Directions that share parameters, together."""
    groups: list[tuple[set[int], list[int]]] = []
    for k, direction in enumerate(directions.T):
        parameters, members = set(np.flatnonzero(direction).tolist()), [k]
        for group in [group for group in groups if group[0] & parameters]:
            groups.remove(group)
            parameters, members = parameters | group[0], group[1] + members
        groups.append((parameters, members))
    return [members for _, members in groups]


def _is_involved(
    directions: Float[np.ndarray, "np k"], theta: np.ndarray, min_weight: float = 0.02
) -> Bool[np.ndarray, " np"]:
    """Which parameters change along a direction by a share `min_weight` of the largest change.

    Changes are relative ones, of parameters that are zero absolute ones.
    """
    relative = np.abs(directions) / np.where(theta != 0, np.abs(theta), 1.0)[:, None]
    return np.max(relative / np.max(relative, axis=0), axis=1) > min_weight


def _invariants(
    directions: Float[np.ndarray, "n k"], tolerance: float
) -> list[Int[np.ndarray, " n"]] | None:
    """Weights of combinations that are constant along the directions; None if no small integers."""
    rows, pivots = reduced(directions.T)
    remaining = [column for column in range(len(directions)) if column not in pivots]
    forms = []
    for column in remaining:
        fractions = [_fraction(float(value), tolerance) for value in rows[:, column]]
        if any(fraction is None for fraction in fractions):
            return None
        common = int(
            np.lcm.reduce([fraction.denominator for fraction in fractions if fraction is not None])
        )
        weights = np.zeros(len(directions), int)
        weights[column] = common
        for pivot, fraction in zip(pivots, fractions, strict=True):
            weights[pivot] = -int((fraction or Fraction(0)) * common)
        if np.max(np.abs(weights)) > _MAX_EXPONENT:
            return None
        forms.append(weights)
    return forms


def reduced(rows: Float[np.ndarray, "k n"]) -> tuple[Float[np.ndarray, "k n"], list[int]]:
    """Reduced echelon form from the right, and its pivots: the last parameters become divisors."""
    rows, pivots = np.array(rows), []
    for k in range(len(rows)):
        size = np.max(np.abs(rows[k:]), axis=0)
        size[pivots] = 0.0
        # The last column that is not small: a small pivot would amplify rounding errors.
        pivot = int(np.flatnonzero(size > 0.1 * np.max(size))[-1])
        best = k + int(np.argmax(np.abs(rows[k:, pivot])))
        rows[[k, best]] = rows[[best, k]]
        rows[k] /= rows[k, pivot]
        other_rows = np.arange(len(rows)) != k
        rows[other_rows] -= np.outer(rows[other_rows, pivot], rows[k])
        pivots.append(pivot)
    return rows, pivots


def _fraction(value: float, tolerance: float) -> Fraction | None:
    rational = Fraction(value).limit_denominator(_MAX_EXPONENT)
    return rational if abs(float(rational) - value) <= tolerance * max(1.0, abs(value)) else None


def _product(terms: Sequence[tuple[str, int]]) -> str:
    """``a·b²/c``; the first name is in the numerator."""
    sign = 1 if terms[0][1] > 0 else -1
    numerator = [_power(name, sign * exponent) for name, exponent in terms if sign * exponent > 0]
    denominator = [
        _power(name, -sign * exponent) for name, exponent in terms if sign * exponent < 0
    ]
    text = "·".join(numerator)
    if not denominator:
        return text
    return (
        f"{text}/{denominator[0]}" if len(denominator) == 1 else f"{text}/({'·'.join(denominator)})"
    )


def _power(name: str, exponent: int) -> str:
    return name + {1: "", 2: "²", 3: "³"}[exponent]


def _sum(terms: Sequence[tuple[str, int]]) -> str:
    """``a + 2 b - c``."""
    sign = 1 if terms[0][1] > 0 else -1
    text = ""
    for name, value in terms:
        factor = "" if abs(value) == 1 else f"{abs(value)} "
        join = (" + " if sign * value > 0 else " - ") if text else ""
        text += f"{join}{factor}{name}"
    return text
