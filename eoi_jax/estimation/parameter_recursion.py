r"""The recursion (12)–(13) over the rows of an estimate, compiled as the passes are.

Each sample is one `RecursiveLeastSquares.step`, and J ← λ² J + ζᵀζ beside it, of which the
covariance of Δ̂ is made (`parameter_history.py`).
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from eoi_jax.compiler.graph import Untranslatable
from eoi_jax.compiler.loop import AbstractLoop, shapes_of
from eoi_jax.compiler.programs import jit
from eoi_jax.compiler.runtime import compiled_loop, numbers
from eoi_jax.estimation.regression.recursive_least_squares import (
    RecursiveLeastSquares,
    RecursiveState,
    information_inverse,
)
from eoi_jax.estimation.regression.sample_rows import SampleRows


@dataclass(frozen=True)
class RecursionSettings:
    """When the recursion is compiled whole, and which parameters the samples so far leave open."""

    max_products: int = 1000  # rows of a sample times np²: LLVM takes a second for as many
    chunk: int = 4096  # samples at a time
    inflation: float = 1e8  # of a variance, over that with all other parameters fixed


_SETTINGS = RecursionSettings()


def recursion_over_rows(
    estimator: RecursiveLeastSquares, rows: SampleRows, settings: RecursionSettings = _SETTINGS
) -> tuple[Float[np.ndarray, "samples np"], Float[np.ndarray, "samples np"]]:
    """Δ̂ after each sample, and its variances for σ² = 1; infinite where it is left open.

    Args:
        estimator: with its forgetting factor.
        rows: of all records, one after the other.
        settings: of the loop.
    """
    dtype = np.dtype(jnp.result_type(float))
    parts = (rows.error, rows.regressors, rows.instruments, rows.scored)
    row = _Row(*(None if part is None else np.asarray(part, dtype) for part in parts))
    fixed = _Fixed(estimator, settings.inflation)
    products = row.phi[:1].size * row.phi.shape[2]
    try:
        if 0 < products <= settings.max_products:
            return _compiled(fixed, row, settings.chunk)
    except Untranslatable:  # many parameters
        pass
    values, variances = _scanned(fixed, row)
    return np.asarray(values), np.asarray(variances)


class _Row(eqx.Module):
    """The rows of one sample, or of all; `counts` is 1 where one counts, else 0."""

    error: Any
    phi: Any
    zeta: Any
    counts: Any


class _Fixed(eqx.Module):
    """What all samples share."""

    estimator: RecursiveLeastSquares
    inflation: Any


class _Carry(eqx.Module):
    """State of the recursion, and J."""

    recursion: RecursiveState
    spread: Float[Array, "np np"]


def _init(fixed: _Fixed, size: int) -> _Carry:
    return _Carry(fixed.estimator.init(size), jnp.zeros((size, size)))


def _step(fixed: _Fixed, carry: _Carry, row: _Row) -> tuple[_Carry, tuple[Array, Array]]:
    """One sample; returns Δ̂ and its variances beside what is carried."""
    estimator = fixed.estimator
    state, _ = estimator.step(carry.recursion, row.phi, row.error, row.counts, row.zeta)
    remembered = jnp.where(row.counts > 0, estimator.forgetting, 1.0) ** 2
    zeta = row.phi if row.zeta is None else row.zeta
    spread = remembered * carry.spread + zeta.T @ zeta
    gamma = information_inverse(state.information, row.zeta is None)
    variance = jnp.einsum("ab,bc,ac->a", gamma, spread, gamma)
    diagonal = jnp.abs(jnp.diagonal(state.information))
    determined = (diagonal > 0.0) & (jnp.abs(jnp.diagonal(gamma)) * diagonal < fixed.inflation)
    return _Carry(state, spread), (state.increment, jnp.where(determined, variance, jnp.inf))


@jit
def _scanned(fixed: _Fixed, rows: _Row) -> Any:
    start = _init(fixed, rows.phi.shape[2])
    return jax.lax.scan(partial(_step, fixed), start, rows)[1]


# -- compiled ---------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _RowLoop(AbstractLoop):
    """What is traced; there is a single lane, which has nothing of its own."""

    shared: _Fixed
    lane: Any
    step: _Row
    dtype: np.dtype

    @property
    def fixed(self) -> _Fixed:
        """What all samples share."""
        return self.shared

    def begin(self, lane: Any, fixed: _Fixed) -> _Carry:
        """Without information."""
        del lane
        return _init(fixed, self.step.phi.shape[1])

    def advance(
        self, lane: Any, fixed: _Fixed, carry: _Carry, row: _Row
    ) -> tuple[_Carry, tuple[Array, Array]]:
        """One sample."""
        del lane
        return _step(fixed, carry, row)

    def result(self, carry: _Carry) -> Any:
        """Nothing: all is put out on the way."""
        del carry
        return ()


def _compiled(fixed: _Fixed, rows: _Row, chunk: int) -> tuple[np.ndarray, np.ndarray]:
    """Through all samples, a chunk at a time."""
    (samples, _, size), dtype = rows.phi.shape, rows.phi.dtype
    first_row = jax.tree.map(lambda leaf: leaf[0], rows)
    shared, lane, step = shapes_of((fixed, np.zeros(()), first_row), dtype)
    loop = _RowLoop(shared, lane, step, dtype)
    columns = sum(leaf.size for leaf in jax.tree.leaves(first_row))
    code = compiled_loop(loop, columns, 1, True)
    run = code.begin(np.zeros((1, 1)), numbers(fixed, dtype))
    series = np.empty((samples, 2 * size), dtype)
    places = [place.start for place in code.outputs]
    with np.errstate(over="ignore", invalid="ignore"):
        for first in range(0, samples, chunk):
            part = slice(first, first + chunk)
            leaves = [leaf[part] for leaf in jax.tree.leaves(rows)]
            table = np.concatenate([leaf.reshape(len(leaf), -1) for leaf in leaves], axis=1)
            (outputs,) = run.outputs(table, len(table))
            series[part] = outputs[:, places]
    return series[:, :size], series[:, size:]
