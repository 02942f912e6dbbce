"""What passes add up to, where they went wrong."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

import eoi_jax as eoi
from eoi_jax.iteration import _solve
from eoi_jax.passes import Sums

PLANT = eoi.Plant(lambda t, x, u, p: -p.k * x.y[0] + p.b * u, {"k": 1.0, "b": 2.0}, 1)


def sums(information) -> Sums:
    """One lane and one output."""
    one = jnp.ones(1)
    alone = Sums(
        jnp.asarray(information)[None], jnp.zeros((1, 2)), one, one, one, one, one,
        jnp.zeros((2, 2)),
    )  # fmt: skip
    return jax.tree.map(lambda leaf: np.asarray(leaf)[None], alone)


def test_a_lane_without_bound_is_not_settled_and_one_at_rest_is():
    theta, damping = np.array([[1.0, 2.0]]), np.zeros(1)
    rest = _solve(PLANT, theta, sums(np.eye(2)), damping)
    np.testing.assert_array_equal(rest.settled, [True])
    lost = _solve(PLANT, theta, sums(np.diag([np.inf, 1.0])), damping)
    unbound = dataclasses.replace(lost, increment=np.zeros((1, 2)))
    for one in (lost, unbound):  # warnings are errors here
        np.testing.assert_array_equal(one.settled, [False])
        np.testing.assert_array_equal(one.cost, [np.inf])
