"""Slices, gathers, scatters and pads by NumPy, beside JAX's own."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eoi_jax.compiler import indexing
from eoi_jax.compiler.jax_private import called

X = np.arange(24, dtype=np.int32).reshape(2, 3, 4)
FUNCTIONS = {
    "rows": lambda x: x[np.array([1, 0, 1])],
    "pairs": lambda x: x[np.array([1, 0]), np.array([2, 1])],
    "apart": lambda x: x[np.array([1, 0]), :, np.array([3, 1])],
    "block": lambda x: x[:, np.array([[0, 2], [1, 1]])],
    "clipped": lambda x: x.at[np.array([0, 7])].get(mode="clip"),
    "taken": lambda x: jnp.take(x, np.array([2, 0]), axis=1),
    "along": lambda x: jnp.take_along_axis(x, np.array([[[1], [0], [3]]] * 2), axis=2),
    "set": lambda x: x.at[1].set(-5),
    "set pairs": lambda x: x.at[np.array([1, 0]), np.array([2, 1])].set(x[:, 0] + 100),
    "set column": lambda x: x.at[:, 1].set(x[:, 2]),
    "dropped": lambda x: x.at[np.array([0, 9])].set(-7),
    "slice": lambda x: jax.lax.dynamic_slice(x, (1, 2, 3), (1, 2, 2)),
    "update": lambda x: jax.lax.dynamic_update_slice(x, x[:, :2, :2] + 50, (0, 2, 1)),
    "pad": lambda x: jax.lax.pad(x, np.int32(9), ((1, 2, 0), (0, -1, 2), (-1, 1, 0))),
    "many": lambda x: jax.vmap(lambda row, i: row[i])(x, jnp.array([2, 0])),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_indexing_is_that_of_jax(name):
    """Every equation of the traced function that moves components, on the values JAX gives it."""
    function = FUNCTIONS[name]
    closed = jax.make_jaxpr(function)(X)
    counts: dict[str, int] = {}
    result = _run(closed.jaxpr, closed.consts, [X], counts)
    assert sum(counts.values()) > 0
    np.testing.assert_array_equal(result[0], function(jnp.asarray(X)))


def _run(jaxpr, consts, args, counts):
    known = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*consts, *args], strict=True))

    def read(atom):
        return np.asarray(atom.val) if hasattr(atom, "val") else np.asarray(known[atom])

    for equation in jaxpr.eqns:
        values = [read(atom) for atom in equation.invars]
        inner, name = called(equation), equation.primitive.name
        if inner is not None:
            out = _run(inner.jaxpr, inner.consts, values, counts)
        elif hasattr(indexing, name):
            counts[name] = counts.get(name, 0) + 1
            out = [getattr(indexing, name)(equation.params, *values)]
        else:
            out = equation.primitive.bind(*values, **equation.params)
            out = out if equation.primitive.multiple_results else [out]
        known.update(zip(equation.outvars, out, strict=True))
    return [read(atom) for atom in jaxpr.outvars]
