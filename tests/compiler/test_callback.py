"""Functions of the host inside compiled code."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eoi_jax.compiler.callback import on_host


def scaled(pair, factor):
    """Sums over the last axis, times a factor; of several lanes, too."""
    one, other = pair
    return np.asarray((one + other).sum(axis=-1) * factor)


def called(one, other, factor):
    result = jax.ShapeDtypeStruct((), jnp.result_type(float))
    return on_host(scaled, result, (one, other), factor)


@pytest.mark.parametrize("backend", ["cpu", "another"])
def test_it_gives_what_the_function_gives(monkeypatch, backend):
    """On another backend by the way that copies."""
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    one, other = jnp.arange(3.0), jnp.ones(3)
    assert jax.jit(called)(one, other, jnp.asarray(2.0)) == 12.0


@pytest.mark.parametrize("backend", ["cpu", "another"])
def test_all_lanes_go_in_one_call(monkeypatch, backend):
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    lanes, shared = jnp.arange(12.0).reshape(4, 3), jnp.ones(3)
    found = jax.vmap(called, in_axes=(0, None, None))(lanes, shared, jnp.asarray(2.0))
    np.testing.assert_array_equal(found, 2.0 * np.sum(np.asarray(lanes) + 1.0, axis=1))


def test_it_runs_anew_in_each_round_of_a_loop():
    def halved(_, value):
        result = jax.ShapeDtypeStruct((), value.dtype)
        return on_host(lambda one: np.asarray(0.5 * one), result, value)

    assert jax.jit(lambda start: jax.lax.fori_loop(0, 5, halved, start))(64.0) == 2.0
