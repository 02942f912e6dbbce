r"""Comparisons inside a function, read off and decided from outside.

A function that jumps compares something with something, $a > b$: its jump is where $a - b$ changes
sign. The function is evaluated operation by operation, as its jaxpr has them; what is compared is
noted, and where the outcome is given from outside, that is taken instead. So the function can be
continued smoothly beyond its jump.

    differences, signs = comparisons(function, x, u)     # of all that depend on x
    with_signs(function, (0, 2), jnp.array([1.0, -1.0]), x, u)  # the first and the third decided

Functions whose author gave the derivative, branches and loops are left as they are: what they
compare is neither read nor decided.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from eoi_jax._types import Scalar
from eoi_jax.compiler.jax_private import ClosedJaxpr, Literal, called, results_of

_GREATER, _SMALLER = frozenset({"gt", "ge"}), frozenset({"lt", "le"})
COMPARED = _GREATER | _SMALLER | {"sign"}

Differences = Float[Array, " comparisons"]


def comparisons(function: Callable, x: Any, *args: Any) -> tuple[Differences, Differences]:
    """What a function compares, of what depends on its first argument.

    Args:
        function: of trees of arrays, gives a tree of arrays.
        x: its first argument.
        *args: the others.

    Returns:
        a - b of each comparison, number by number, in the order of evaluation: of a > b and a >= b,
        of b < a and b <= a, and of sign(a), where b = 0; and its outcome, 1.0 or -1.0, of a sign
        also 0.0.
    """
    evaluation = _Evaluation({})
    evaluation.result(function, x, args)
    pairs = evaluation.differences, evaluation.signs
    differences, signs = (jnp.stack(part) if part else jnp.zeros(0) for part in pairs)
    return differences, signs


def with_signs(
    function: Callable, numbers: Sequence[int], signs: Differences, x: Any, *args: Any
) -> Any:
    """A function with the outcome of some comparisons given from outside.

    Args:
        function: as of `comparisons`.
        numbers: of these comparisons, in the order of `comparisons`.
        signs: their outcome, positive or negative. Zero of a sign: it is not decided.
        x: as of `comparisons`.
        *args: likewise.
    """
    decided = dict(zip(numbers, jnp.unstack(signs), strict=True))
    return _Evaluation(decided).result(function, x, args)


@dataclass
class _Evaluation:
    """One evaluation of a function.

    Attributes:
        decided: outcome by number of the comparison.
        differences: of all comparisons up to now.
        signs: their outcomes.
    """

    decided: dict[int, Scalar]
    differences: list[Scalar] = field(default_factory=list)
    signs: list[Scalar] = field(default_factory=list)

    def result(self, function: Callable, x: Any, args: tuple) -> Any:
        """The result of the function."""
        closed, shape = jax.make_jaxpr(function, return_shape=True)(x, *args)
        moving, fixed = jax.tree.leaves(x), jax.tree.leaves(args)
        moves = [True] * len(moving) + [False] * len(fixed)
        results = self._run(closed, [*map(jnp.asarray, (*moving, *fixed))], moves)[0]
        return jax.tree.unflatten(jax.tree.structure(shape), results)

    def _run(
        self, closed: ClosedJaxpr, operands: Sequence[Any], moves: Sequence[bool]
    ) -> tuple[list[Any], list[bool]]:
        """The results of a jaxpr, and which of them depend on the first argument."""
        jaxpr = closed.jaxpr
        values = dict(zip(jaxpr.constvars, closed.consts, strict=True))
        values.update(zip(jaxpr.invars, operands, strict=True))
        moving = {var for var, move in zip(jaxpr.invars, moves, strict=True) if move}

        def read(atoms: Sequence[Any]) -> tuple[list[Any], list[bool]]:
            flags = [not isinstance(atom, Literal) and atom in moving for atom in atoms]
            return [a.val if isinstance(a, Literal) else values[a] for a in atoms], flags

        for equation in jaxpr.eqns:
            results, flags = self._equation(equation, *read(equation.invars))
            values.update(zip(equation.outvars, results, strict=True))
            moving |= {var for var, flag in zip(equation.outvars, flags, strict=True) if flag}
        return read(jaxpr.outvars)

    def _equation(
        self, equation: Any, operands: list[Any], moves: list[bool]
    ) -> tuple[list[Any], list[bool]]:
        name = equation.primitive.name
        inner = None if name.startswith("custom_") else called(equation)
        if inner is not None:
            return self._run(inner, operands, moves)
        results = results_of(equation, operands)
        real = equation.invars[0].aval.dtype.kind == "f" if equation.invars else False
        if name in COMPARED and real and any(moves):
            results = [self._compared(name, operands, results[0])]
        return results, [any(moves)] * len(results)

    def _compared(self, name: str, operands: list[Any], outcome: Array) -> Array:
        """The outcome of a comparison, of numbers or arrays, as it is or as it is decided."""
        if name == "sign":
            difference, signs = operands[0], outcome
        else:
            a, b = operands if name in _GREATER else operands[::-1]
            difference, signs = a - b, jnp.where(outcome, 1.0, -1.0)
        first, parts = len(self.signs), [*jnp.ravel(signs)]
        self.differences += [*jnp.ravel(difference)]
        self.signs += parts
        if self.decided.keys().isdisjoint(range(first, len(self.signs))):
            return outcome
        chosen = [jnp.asarray(self.decided.get(i, part)) for i, part in enumerate(parts, first)]
        if name == "sign":
            pairs = zip(chosen, parts, strict=True)
            chosen = [jnp.where(new == 0, old, new) for new, old in pairs]
            return jnp.reshape(jnp.stack(chosen), outcome.shape)
        return jnp.reshape(jnp.stack([new > 0 for new in chosen]), outcome.shape)
