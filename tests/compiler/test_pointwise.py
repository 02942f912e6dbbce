"""Functions of one instant along a record: as `jax.vmap` has them, by NumPy or by XLA."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eoi_jax.compiler.pointwise import Along, along, slopes_along

DRAW = np.random.default_rng(0)
THETA, ROWS, GRID = DRAW.normal(size=2), DRAW.normal(size=(50, 3)), DRAW.normal(size=(4, 2))


def arithmetic(theta, row, point):
    return jnp.sin(theta[0] * row) * point[0], jnp.where(row[0] > 0, theta[1], point[1])


def factorised(theta, row, point):
    """No arithmetic of scalars: a matrix is factorised."""
    matrix = jnp.eye(3) + jnp.outer(row, row)
    return jnp.linalg.cholesky(matrix) @ row * point[0], theta[1] * point[1]


@pytest.mark.parametrize("function", [arithmetic, factorised])
def test_values_are_those_of_vmap(function):
    rows = jax.vmap(function, (None, 0, None))
    wanted = jax.vmap(rows, (None, None, 0))(THETA, ROWS, GRID)
    found = Along(function, ("fixed", "rows", "grid"), THETA, ROWS, GRID)
    for part in (slice(None), slice(10, 31)):
        for one, other in zip(found(part), wanted, strict=True):
            np.testing.assert_allclose(one, other[:, part], rtol=1e-12, atol=1e-14)


def test_without_a_grid_there_is_no_axis_of_it():
    found = along(lambda theta, row: theta @ row[:2], ("fixed", "rows"), THETA, ROWS)
    np.testing.assert_allclose(found, ROWS[:, :2] @ THETA, rtol=1e-12, atol=1e-14)


def test_an_argument_may_have_both_axes():
    both = DRAW.normal(size=(4, 50))
    axes = ("rows", "grid", "grid rows")
    found = along(lambda row, point, one: row[0] * point[0] + one, axes, ROWS, GRID, both)
    np.testing.assert_allclose(found, GRID[:, :1] * ROWS[:, 0] + both, rtol=1e-12, atol=1e-14)


@jax.custom_jvp
def smooth(x):
    return jnp.abs(x)


smooth.defjvp(lambda primals, tangents: (smooth(*primals), 3.0 * tangents[0]))


def by_scalars(theta, row):
    return jnp.stack([jnp.sin(theta[0] * row[0]) / theta[1], jnp.maximum(row[1], theta[0] ** 2)])


def by_its_author(theta, row):
    return jnp.stack([smooth(theta[0]) * row[0], theta[1] * smooth(row[1])])


@pytest.mark.parametrize("function", [by_scalars, by_its_author])
@pytest.mark.parametrize("argument", [0, 1])
def test_slopes_are_those_of_jacfwd(function, argument):
    """Of the scalar program, or, where an author says what a derivative is, of JAX."""
    wanted = jax.vmap(jax.jacfwd(function, argument), (None, 0))(THETA, ROWS)
    found = slopes_along(function, ("fixed", "rows"), argument, THETA, ROWS)
    np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-14)


def test_slopes_of_what_no_scalar_program_expresses_are_those_of_jacfwd():
    def factor(row):
        return factorised(THETA, row, GRID[0])[0]

    found = slopes_along(factor, ("rows",), 0, ROWS)
    np.testing.assert_allclose(found, jax.vmap(jax.jacfwd(factor))(ROWS), rtol=1e-12)
