"""What passes add up to, where they went wrong."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import eoi_jax as eoi
from eoi_jax.estimation.iteration import _solve, iterate
from eoi_jax.estimation.kernel import Sums

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
    np.testing.assert_array_equal(rest.is_stationary, [True])
    lost = _solve(PLANT, theta, sums(np.diag([np.inf, 1.0])), damping)
    unbound = dataclasses.replace(lost, increment=np.zeros((1, 2)))
    for one in (lost, unbound):  # warnings are errors here
        np.testing.assert_array_equal(one.is_stationary, [False])
        np.testing.assert_array_equal(one.cost, [np.inf])


def test_passes_follow_a_bent_valley_in_which_full_steps_overshoot():
    """Rosenbrock's function: r = (10 (θ₂ − θ₁²), 1 − θ₁), and a power that no θ takes away."""
    bent = eoi.Plant(lambda t, x, u, p: -p.a * p.b * x.y[0] + p.b * u, {"a": -1.2, "b": 1.0}, 1)

    def run(which, theta, number):
        del which, number
        lanes = []
        for a, b in theta:
            residual = np.array([10.0 * (b - a**2), 1.0 - a])
            phi = np.array([[20.0 * a, -10.0], [1.0, 0.0]])  # −∂r/∂θ
            one = jnp.ones(1)
            lanes.append(
                Sums(
                    jnp.asarray(phi.T @ phi)[None], jnp.asarray(phi.T @ residual)[None],
                    jnp.asarray([residual @ residual + 1e-3]), one, one, one, one,
                    jnp.zeros((2, 2)),
                )
            )  # fmt: skip
        return jax.tree.map(lambda *leaves: np.stack(leaves), *lanes)

    found = iterate(run, bent, np.array([[-1.2, 1.0]]), 60)
    assert found.codes == ["converged"]
    np.testing.assert_allclose(found.best.theta, [[1.0, 1.0]], atol=1e-3)


def test_passes_that_fall_short_of_what_least_squares_promises_are_not_converged():
    """An affine model whose index does not fall: the observer does not show what it lacks."""

    def run(which, theta, number):
        del which, number
        one = jnp.ones(1)
        lane = Sums(
            jnp.eye(2)[None], 0.5 * jnp.ones((1, 2)), one, one, one, one, one, jnp.zeros((2, 2))
        )
        return jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[None], len(theta), 0), lane)

    assert PLANT.is_affine
    found = iterate(run, PLANT, np.array([[1.0, 2.0]]), 10)
    np.testing.assert_allclose(found.best.predicted_reduction, 0.5)
    assert found.codes == ["stalled"]


def test_what_is_settled_does_not_depend_on_units():
    """An increment that moves f by a thousandth of what was observed is none too small."""
    for size in (1e-9, 1.0, 1e9):
        square = np.full((1, 1), size**2)
        observed = eqx.tree_at(lambda one: one.observed_square, sums(np.eye(2)), square)
        one = _solve(PLANT, np.array([[1.0, 2.0]]), observed, np.zeros(1))
        # Outputs are weighed by 1/P, which has the unit of the output, squared.
        weighed = dataclasses.replace(one, weights=np.ones((1, 1)))
        for share, settled in ((1e-3, False), (1e-12, True)):
            moved = np.full((1, 2), share * size) / weighed.solution.scale
            moved = dataclasses.replace(weighed, increment=moved)
            np.testing.assert_array_equal(moved.is_stationary, [settled])


def test_an_output_without_scored_samples_has_no_part_in_the_cost():
    plant = eoi.Plant(
        lambda t, x, u, p: jnp.stack([-p.k * x.y[0, 0], p.b * u[0]]), {"k": 1.0, "b": 2.0}, 1,
        outputs=("y", "w"),
    )  # fmt: skip
    one, both = np.array([1.0, 0.0]), np.array([2.0, 0.0])
    alone = Sums(np.stack([np.eye(2), 0 * np.eye(2)]), np.zeros((2, 2)), both, both, one, 9 * one,
                 one, np.zeros((2, 2)))  # fmt: skip
    alone = jax.tree.map(lambda leaf: np.asarray(leaf)[None], alone)
    found = _solve(plant, np.array([[1.0, 2.0]]), alone, np.zeros(1))
    assert found.index[0, 0] > 0.0
    np.testing.assert_allclose(found.cost, np.log(found.index[:, 0]))


def test_a_bound_of_one_lane_does_not_touch_the_other():
    values, bounds = {"k": 1.0, "b": 2.0}, {"k": (-np.inf, 1.0)}
    plant = eoi.Plant(lambda t, x, u, p: -p.k * x.y[0] + p.b * u, values, 1, bounds=bounds)
    one = sums(np.array([[2.0, 0.5], [0.5, 1.0]]))
    both = jax.tree.map(lambda leaf: np.concatenate([leaf, leaf]), one)
    both = eqx.tree_at(lambda each: each.rhs, both, np.array([[[-5.0, 1.0]], [[5.0, 1.0]]]))
    theta = np.array([[1.0, 2.0], [1.0, 2.0]])  # the second lane would leave the bound
    found = _solve(plant, theta, both, np.zeros(2))
    np.testing.assert_array_equal(found.bound, [[False, False], [True, False]])
    inverse = np.linalg.inv([[2.0, 0.5], [0.5, 1.0]])
    np.testing.assert_allclose(found.solution.inverse[1], [[0.0, 0.0], [0.0, 1.0]], atol=1e-12)
    np.testing.assert_allclose(found.solution.inverse[0], inverse)


def low_passed(nominal: float) -> eoi.Identification:
    """Of 0.2 s, from a time constant T of which 1/T is all that f knows."""
    draw, period = np.random.default_rng(3), 0.02
    u, y = np.repeat(draw.uniform(-1.0, 1.0, 60), 10), np.zeros(600)
    for k in range(599):
        y[k + 1] = u[k] + (y[k] - u[k]) * np.exp(-period / 0.2)
    record = eoi.Record.from_period(period, u, y, hold="zero")
    return eoi.identify(eoi.Plant(lambda t, x, u, p: (u - x.y[0]) / p.T, {"T": nominal}, 1), record)


def test_steps_cut_to_the_largest_change_are_no_convergence():
    """From far off the index stands still while T falls by a factor of eight in each pass."""
    far, near = low_passed(2e8), low_passed(2.0)
    np.testing.assert_allclose(far.parameters["T"], 2e8 / 8.0 ** (len(far.index) - 1))
    assert far.status.code == "stalled"
    assert "promises to lower it by 100% more" in far.status.message
    assert near.status.code == "converged"
    np.testing.assert_allclose(near.parameters["T"], 0.2, rtol=1e-3)


def test_passes_that_still_lower_the_index_at_the_last_are_not_converged():
    """Least squares expects nothing more, and each pass lowers the index by a tenth."""

    def run(which, theta, number):
        del which
        one = jnp.ones(1)
        power = jnp.full(1, 0.9**number)
        lane = Sums(
            jnp.eye(2)[None], jnp.full((1, 2), 1e-3), power, one, one, one, one, jnp.zeros((2, 2))
        )
        return jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[None], len(theta), 0), lane)

    found = iterate(run, PLANT, np.array([[1.0, 2.0]]), 10)
    assert found.passes == [10]
    assert found.codes == ["passes_exhausted"]
