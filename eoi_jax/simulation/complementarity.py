r"""Dry frictions that act on each other: which outputs stay at rest, and with which friction.

At rest a friction is a share $s_j \in [-1, 1]$ of its level, and the accelerations of all outputs
that stick are affine in the shares, $a = A s + b$, with $A_{jj} < 0$: friction opposes motion. An
output stays at rest within its limits, $a_j = 0$, and leaves at one of them, $s_j a_j > 0$; in one
equation $s = \operatorname{clip}(s + a)$, the linear complementarity problem of Coulomb friction.

**Source.** F. Pfeiffer and C. Glocker, *Multibody Dynamics with Unilateral Contacts* (1996),
chapter 5.
"""

import itertools

import jax
import jax.numpy as jnp
from jaxtyping import Array

from eoi_jax._types import Scalar

Matrix = list[list[Scalar]]


def balanced(matrix: Matrix, rates: list[Scalar], unknown: list[Array]) -> list[Scalar]:
    """s with (A s + b)_j = 0 for the unknown s_j, the others zero: Gauss's elimination.

    Args:
        matrix: A, with negative diagonals: no pivoting. Where one is not negative, s_j is 0.
        rates: b.
        unknown: of which s_j.
    """
    rows, right = [list(row) for row in matrix], [-rate for rate in rates]
    count = len(rates)
    for j in range(count):
        use = unknown[j] & (rows[j][j] < 0)
        rows[j] = [jnp.where(use, value, float(j == k)) for k, value in enumerate(rows[j])]
        right[j] = jnp.where(use, right[j], 0.0)
        for i in range(j + 1, count):
            factor = rows[i][j] / rows[j][j]
            rows[i] = [
                value - factor * pivot for value, pivot in zip(rows[i], rows[j], strict=True)
            ]
            right[i] = right[i] - factor * right[j]
    shares: list[Scalar] = [jnp.zeros(())] * count
    for j in reversed(range(count)):
        eliminated = sum((rows[j][k] * shares[k] for k in range(j + 1, count)), jnp.zeros(()))
        shares[j] = (right[j] - eliminated) / rows[j][j]
    return shares


def leaving(matrix: Matrix, rates: list[Scalar], resting: list[Array]) -> list[Scalar]:
    """Which way each of two outputs leaves rest: +1, −1, or 0 where it stays.

    Both stay, or one of them is at a limit and the other one wherever that leaves it: of these five
    the one that agrees with its accelerations best.

    Args:
        matrix: A.
        rates: b.
        resting: which outputs are at rest; of the others columns of A are zero.
    """

    def limited(shares: list[Scalar]) -> tuple[list[Scalar], list[Scalar], Scalar]:
        """Shares within their limits, accelerations, and |clip(s + a) - s|."""
        s = [jnp.clip(share, -1.0, 1.0) for share in shares]
        a = [rate + sum(map(jnp.multiply, row, s)) for rate, row in zip(rates, matrix, strict=True)]
        mismatch = (
            jnp.where(rests, jnp.abs(jnp.clip(share + rate, -1.0, 1.0) - share), 0.0)
            for rests, share, rate in zip(resting, s, a, strict=True)
        )
        return s, a, sum(mismatch, jnp.zeros(()))

    best = limited(balanced(matrix, rates, resting))
    for j, limit in itertools.product(range(len(rates)), (-1.0, 1.0)):
        moved = [rate + limit * row[j] for rate, row in zip(rates, matrix, strict=True)]
        shares = balanced(matrix, moved, [share & (i != j) for i, share in enumerate(resting)])
        shares[j] = jnp.where(resting[j], limit, 0.0)
        trial = limited(shares)
        better = trial[2] < best[2]
        best = jax.tree.map(lambda new, old, use=better: jnp.where(use, new, old), trial, best)
    return [
        jnp.where((jnp.abs(s) == 1.0) & (s * a > 0), s, 0.0) for s, a in zip(*best[:2], strict=True)
    ]
