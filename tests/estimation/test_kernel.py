"""The fused pass: against a NumPy loop, over batches, masks, padding, and at its order in h."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import (
    SWAY,
    first_order_loop,
    grid,
    moved_level,
    moved_mass_spring,
    pushed_double_integrator,
    second_order_loop,
)
from scipy.signal import cont2discrete

from eoi_jax.data.record import Record
from eoi_jax.estimation.kernel import run_pass
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.observers import FirstOrder, SecondOrder
from eoi_jax.estimation.preparation import prepare_steps, step_inputs
from eoi_jax.estimation.regression import least_squares, recursive
from eoi_jax.models.library import Plant, level_tank, mass_spring_damper

TRUE = mass_spring_damper(true=True).parameters
NOMINAL = mass_spring_damper()
LOWPASS = LowPass(40.0)
OBSERVER = SecondOrder(20.0, 100.0, 500.0)


def swaying(samples=801, h=2e-3, hold="smooth"):
    u, y = moved_mass_spring(grid(samples, h), TRUE)
    return Record.from_period(h, u, y, hold=hold)


def steps_of(plant, records, observer, transient=0.2, memory=0.1, taper=0.02) -> Any:
    noise = [np.zeros(len(plant.outputs))] * len(records)
    explicit = observer.scheme == "explicit"
    taps = len(np.atleast_2d(np.asarray(observer.kernel))[0])
    inputs = [step_inputs(record, explicit) for record in records]
    return prepare_steps(plant, records, inputs, taps, transient, memory, noise, explicit, taper)


def filters_of(records, lowpass=LOWPASS):
    sampled = [lowpass.discretise(record.sample_period) for record in records]
    return jax.tree.map(lambda *leaves: np.stack(leaves), *sampled)


def passed(
    plant,
    records,
    observer: Any = OBSERVER,
    theta: Any = None,
    store="nothing",
    steps: Any = None,
    **kwargs,
) -> Any:
    """Sums (each with records as leading axis) and traces of one pass."""
    steps = steps_of(plant, records, observer) if steps is None else steps
    theta = jnp.asarray(plant.theta if theta is None else theta, dtype=float)
    return run_pass(plant, observer, filters_of(records), steps, theta, store=store, **kwargs)


def added(sums) -> Any:
    return jax.tree.map(lambda leaf: np.sum(np.asarray(leaf), axis=0), sums)


def increment_of(sums):
    total = added(sums)
    size = total.rhs.shape[-1]
    information, rhs = total.information.sum(axis=0), total.rhs.sum(axis=0)
    solution = least_squares(jnp.asarray(information), jnp.asarray(rhs), jnp.ones(size))
    return np.asarray(solution.increment)


def close(one, other, rtol=1e-9):
    """Sums agree; the scale of each kind of sum bounds its rounding."""
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(a, b, rtol=rtol, atol=rtol * np.max(np.abs(b), initial=1e-300))


def test_a_parameter_without_trace_is_in_no_other_direction_either():
    """Beside collinear columns rounding would give it a share in theirs, and a variance."""
    rows = np.random.default_rng(0).standard_normal((50, 6))
    rows[:, [2, 5]] = 0.0
    rows[:, 4] = rows[:, 0] + rows[:, 1]
    solution = least_squares(jnp.asarray(rows.T @ rows), jnp.ones(6), jnp.ones(6))
    silent, heard = np.asarray(solution.inverse)[[2, 5]], np.asarray(solution.increment)
    np.testing.assert_array_equal(silent, 0.0)
    np.testing.assert_array_equal(heard == 0, [False, False, True, False, False, True])


# -- against plain loops ----------------------------------------------------------------------


def lag_filter_loop(cutoff, h, rows):
    """Eq. (19) for an input held over each step, by scipy; rows (S, columns)."""
    entry = np.array([[0.0], [cutoff**2]])
    A = np.array([[0.0, 1.0], [-(cutoff**2), -np.sqrt(2.0) * cutoff]])
    system = (A, entry, np.array([[1.0, 0.0]]), np.zeros((1, 1)))
    sampled: Any = cont2discrete(system, h, method="zoh")
    A, B = sampled[:2]
    state, shown = np.zeros((2, rows.shape[1])), []
    for row in rows:
        state = A @ state + B * row
        shown.append(state[0])
    return np.array(shown)


def normal_equations(u_eq, phi, transient_steps):
    """Σ φᵀφ, Σ φᵀ u_eq and Σ u_eq² of filtered signals after the transient."""
    late = slice(transient_steps, None)
    filtered = lag_filter_loop(LOWPASS.cutoff, 2e-3, np.column_stack([u_eq, phi]))[late]
    return filtered[:, 1:].T @ filtered[:, 1:], filtered[:, 1:].T @ filtered[:, 0], filtered[:, 0]


def test_second_order_pass_equals_a_numpy_loop():
    samples, h, transient = 120, 2e-3, 40
    record = swaying(samples, h, "zero")
    y, u = record.outputs[:, 0], record.inputs[:-1, 0]
    alpha, beta, rho = NOMINAL.theta
    middle = 0.5 * (y[:-1] + y[1:])
    # The model before the step is known uses the observer's own rate, so the loop is unrolled here.
    x1, x2, injections, rates, drifts = y[0], (y[1] - y[0]) / h, [], [], []
    c1, c2, c3 = 20.0, 100.0, 500.0
    for k in range(samples - 1):
        drift = -alpha * middle[k] - beta * x2 + rho * u[k]
        loop = second_order_loop(y[k : k + 2], [drift], h, (c1, c2, c3), x1, x2)
        w, e = loop.injection[0], y[k] - x1
        x1, x2 = y[k + 1] - loop.error[0], x2 + h * (drift + c2 * e + w)
        injections.append(w)
        drifts.append(drift)
        rates.append(x2 - 0.5 * h * (drift + c2 * e))  # middle of the step
    rates, drifts = np.array(rates), np.array(drifts)
    phi = np.column_stack([-middle, -rates, u])
    f = phi @ NOMINAL.theta

    def mean_of_two(values):
        return 0.5 * (values + np.concatenate([np.zeros_like(values[:1]), values[:-1]]))

    u_eq = np.array(injections) + mean_of_two(drifts) - mean_of_two(f)
    weights = np.where(np.arange(samples - 1) < 2 + 3, 0.0, 1.0)  # the start: taps and three steps
    phi, u_eq = mean_of_two(phi) * weights[:, None], u_eq * weights
    information, rhs, injection = normal_equations(u_eq, phi, transient)
    steps = steps_of(NOMINAL, [record], OBSERVER, transient * h, taper=0.0)
    sums, trace = passed(NOMINAL, [record], store="signals", steps=steps)
    # Second differences: the rounding of y over h².
    np.testing.assert_allclose(sums.information[0, 0], information, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(sums.rhs[0, 0], rhs, rtol=1e-8)
    np.testing.assert_allclose(sums.square[0, 0], np.sum(injection**2), rtol=1e-8)
    np.testing.assert_allclose(trace.injection[0, transient:, 0], injection, atol=1e-8)
    assert sums.count[0, 0] == samples - 1 - transient
    assert sums.sliding[0, 0] == sums.count[0, 0]


def test_first_order_pass_equals_a_numpy_loop():
    plant = Plant(lambda t, x, u, p: -p.a * x.y[0] + p.b * u, {"a": 1.0, "b": 2.0})
    samples, h, transient = 120, 2e-3, 40
    t = grid(samples, h)
    record = Record.from_period(h, np.sin(5.0 * t), SWAY(t), hold="zero")
    middle = 0.5 * (record.outputs[:-1, 0] + record.outputs[1:, 0])
    phi = np.column_stack([-middle, record.inputs[:-1, 0]])
    f = phi @ plant.theta
    start = record.outputs[0, 0]
    u_eq = first_order_loop(record.outputs[:, 0], f, h, (300.0, 1.0), start, 0.0).injection
    weights = np.where(np.arange(samples - 1) < 1 + 3, 0.0, 1.0)
    information, rhs, injection = normal_equations(
        u_eq * weights, phi * weights[:, None], transient
    )
    observer = FirstOrder(300.0)
    steps = steps_of(plant, [record], observer, transient * h, taper=0.0)
    sums, _ = passed(plant, [record], observer, steps=steps)
    np.testing.assert_allclose(sums.information[0, 0], information, rtol=1e-9)
    np.testing.assert_allclose(sums.rhs[0, 0], rhs, rtol=1e-9)
    np.testing.assert_allclose(sums.square[0, 0], np.sum(injection**2), rtol=1e-9)


# -- over batches -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def three():
    """Three records of one length, different parts of one motion."""
    whole = swaying(1600)
    return [whole[start : start + 800] for start in (0, 300, 800)]


def test_a_batch_of_records_equals_each_alone(three):
    together, _ = passed(NOMINAL, three)
    assert together.rhs.shape == (3, 1, 3)
    for i, record in enumerate(three):
        alone, _ = passed(NOMINAL, [record])
        close(jax.tree.map(lambda leaf, i=i: leaf[i], together), added(alone))


def test_padding_to_the_longest_record_changes_nothing(three):
    short = three[1][:500]
    padded, trace = passed(NOMINAL, [three[0], short], store="signals")
    alone, own = passed(NOMINAL, [short], store="signals")
    padded, alone = (
        eqx.tree_at(lambda sums: sums.meat, one, None)  # its blocks depend on the total length
        for one in (jax.tree.map(lambda leaf: leaf[1], padded), added(alone))
    )
    close(padded, alone)
    np.testing.assert_allclose(trace.injection[1, :499], own.injection[0], atol=1e-9)


def test_records_of_different_periods_share_one_batch():
    records = [swaying(801, 2e-3), swaying(801, 3e-3)]
    together, _ = passed(NOMINAL, records)
    for i, record in enumerate(records):
        close(
            jax.tree.map(lambda leaf, i=i: leaf[i], together), added(passed(NOMINAL, [record])[0])
        )


def test_nothing_is_stored_unless_asked(three):
    sums, trace = passed(NOMINAL, three)
    assert trace is None
    assert max(leaf.size for leaf in jax.tree.leaves(sums)) <= 3 * 9  # no time axis anywhere
    _, trace = passed(NOMINAL, three, store="signals")
    assert trace.injection.shape == (3, 799, 1)
    assert trace.Phi.shape == (3, 799, 1, 3)


def test_stored_signals_give_the_sums(three):
    steps = steps_of(NOMINAL, three, OBSERVER)
    sums, trace = passed(NOMINAL, three, store="signals", steps=steps)
    score = np.asarray(steps.score)
    weighted = score[..., None] * trace.Phi
    np.testing.assert_allclose(
        sums.information, np.einsum("rsja,rsjb->rjab", weighted, trace.Phi), rtol=1e-10, atol=1e-12
    )
    rhs = np.einsum("rsja,rsj->rja", weighted, trace.injection)
    np.testing.assert_allclose(sums.rhs, rhs, rtol=1e-10)
    np.testing.assert_allclose(sums.square, (score * trace.injection**2).sum(axis=1), rtol=1e-10)


def test_meat_is_the_sum_of_squared_block_scores(three):
    """S = Σ over blocks of s sᵀ with s = Σ weight φᵀ (u_eq - φ Δθ), for the sandwich."""
    record, increment, weight = three[0], jnp.asarray([1.0, 0.2, 0.1]), 3.0
    steps = steps_of(NOMINAL, [record], OBSERVER, memory=0.3)
    _, trace = passed(NOMINAL, [record], store="signals", steps=steps)
    weights = jnp.asarray([weight])
    sums, _ = passed(
        NOMINAL, [record], store="scores", steps=steps, increment=increment, weights=weights
    )
    phi, r = (np.asarray(one)[0, :, 0] for one in
              (trace.Phi, trace.injection - trace.Phi @ increment))  # fmt: skip
    window = np.asarray(steps.block_weight)[0, :, None]
    scores = weight * np.asarray(steps.score)[0] * phi * r[:, None] * window
    ends = np.flatnonzero(np.asarray(steps.block_end)[0])
    assert len(ends) == 5  # 1.6 s in blocks of 0.3 s
    blocks = np.add.reduceat(scores[: ends[-1] + 1], [0, *(ends[:-1] + 1)], axis=0)
    np.testing.assert_allclose(sums.meat[0], blocks.T @ blocks, rtol=1e-9)


def test_recursive_equals_batch_on_the_regressors_of_a_pass(three):
    steps = steps_of(NOMINAL, three, OBSERVER)
    sums, trace = passed(NOMINAL, three, store="signals", steps=steps)
    counts = np.asarray(steps.score)[..., 0] > 0
    Phi, target = np.asarray(trace.Phi)[counts], np.asarray(trace.injection)[counts]
    history, _ = recursive(jnp.asarray(Phi), jnp.asarray(target))
    # Scaled columns have a condition number of about ten here.
    np.testing.assert_allclose(history[-1], increment_of(sums), rtol=1e-6)


def test_one_trace_serves_all_parameters_gains_and_records():
    calls = []

    def dynamics(t, x, u, p):
        calls.append(type(p.a))
        return -p.a * x.y[0] - p.b * x.y[1] + u

    plant = Plant(dynamics, {"a": 100.0, "b": 5.0}, relative_degree=2)
    passed(plant, [swaying()])
    traced = len(calls)
    assert traced > 0
    other = plant.with_parameters({"a": 50.0})
    faster = SecondOrder(10.0, 50.0, 900.0)
    passed(other, [swaying(h=1e-3)], faster, theta=[3.0, 2.0])
    assert len(calls) == traced
    passed(plant, [swaying(700)])
    assert len(calls) == traced
    passed(Plant(dynamics, {"a": 100.0, "b": 5.0, "c": 1.0}, relative_degree=2), [swaying()])
    assert len(calls) > traced  # other parameters are another trace: the count can fail


# -- masks ------------------------------------------------------------------------------------


def integrator(t, x, u, p):
    return p.gain * u + p.offset


PUSHED = Plant(integrator, {"gain": 1.0, "offset": 0.0}, relative_degree=2)


def pushed(hole=None):
    """A plant without any discretisation error; `hole` is a slice of missing samples."""
    h, samples = 5e-3, 1201
    u = np.sign(np.sin(4.0 * grid(samples, h))) + 0.5 * np.sin(1.3 * grid(samples, h))
    y = pushed_double_integrator(u, h, 3.0, -0.4)
    if hole is None:
        return Record.from_period(h, u, y, hold="zero")
    y[hole] = np.nan
    with pytest.warns(UserWarning, match="not finite"):
        return Record.from_period(h, u, y, hold="zero")


@pytest.mark.parametrize("hole", [None, slice(500, 501), slice(400, 700)])
@pytest.mark.parametrize("taper", [0.0, 0.05])
def test_a_masked_gap_leaves_the_noise_free_estimate_exact(hole, taper):
    record = pushed(hole)
    steps = steps_of(PUSHED, [record], OBSERVER, taper=taper)
    sums, _ = passed(PUSHED, [record], steps=steps)
    # Rounding of y = 4 m over h², averaged by the filter.
    np.testing.assert_allclose(increment_of(sums), [2.0, -0.4], rtol=1e-8)
    if hole is not None:
        assert sums.count[0, 0] < passed(PUSHED, [pushed()])[0].count[0, 0]


def test_masked_samples_do_not_reach_the_sums():
    """Whatever stands in the hole: values that no model would survive."""
    record = pushed(slice(500, 600))
    clean = passed(PUSHED, [record])[0]
    y = np.array(record.outputs)
    y[500:600] = 1e6
    steps = steps_of(PUSHED, [record], OBSERVER)
    spoilt = [np.array(steps.y), np.array(steps.y_next)]
    spoilt[0][0, 500:600], spoilt[1][0, 499:599] = y[500:600], y[500:600]
    steps = eqx.tree_at(lambda one: (one.y, one.y_next), steps, tuple(spoilt))
    close(passed(PUSHED, [record], steps=steps)[0], clean)


def test_a_model_that_is_undefined_where_it_does_not_count_does_not_spread():
    plant = Plant(lambda t, x, u, p: -p.a * jnp.sqrt(x.y[0]) + u, {"a": 1.0})
    h = 5e-3
    y = 1.0 + 0.3 * np.sin(grid(600, h))
    y[200:250] = np.nan
    with pytest.warns(UserWarning, match="not finite"):
        record = Record.from_period(h, np.zeros(600), y)
    observer = FirstOrder(100.0)
    steps = steps_of(plant, [record], observer)
    spoilt = [np.array(steps.y), np.array(steps.y_next)]
    spoilt[0][0, 201:249] = spoilt[1][0, 201:248] = -1.0
    steps = eqx.tree_at(lambda one: (one.y, one.y_next), steps, tuple(spoilt))
    sums, _ = passed(plant, [record], observer, steps=steps)
    assert np.all(np.isfinite(sums.rhs))
    assert np.all(np.isfinite(sums.information))


# -- derivatives and order --------------------------------------------------------------------


def tank_above(t, x, u, p):
    return p.k2 * jnp.sqrt(x.z) - p.k3 * jnp.sqrt(x.y[0])


def tank_above_rate(t, x, u, p):
    return -p.k1 * jnp.sqrt(x.z) + p.k4 * u


def test_regressor_through_internal_states_is_the_total_derivative():
    """F[φ] = -dF[u_eq]/dθ, because in sliding what is observed does not depend on θ."""
    plant = Plant(
        tank_above,
        {"k1": 0.5, "k2": 0.4, "k3": 0.6, "k4": 0.3, "z0": 1.5},
        internal=tank_above_rate,
        internal_initial=lambda p: jnp.stack([p.z0]),
    )
    h = 0.01
    t = grid(500, h)
    record = Record.from_period(h, 2.0 + np.sin(2.0 * t), 1.0 + 0.2 * np.sin(t), hold="linear")
    observer = FirstOrder(2000.0)
    _, trace = passed(plant, [record], observer, store="signals")
    late = slice(50, None)
    step = 1e-5
    for i in range(5):
        shift = step * np.eye(5)[i]
        pair = [
            passed(plant, [record], observer, plant.theta + sign * shift, "signals")[1].injection
            for sign in (1.0, -1.0)
        ]
        want = -(pair[0] - pair[1])[0, late, 0] / (2.0 * step)
        # Central differences: step² and rounding/step, both about 1e-9.
        np.testing.assert_allclose(trace.Phi[0, late, 0, i], want, atol=1e-7)
        assert np.max(np.abs(want)) > 1e-3


def test_estimate_converges_at_order_two_in_the_sample_period():
    """One pass suffices: the plant is affine and its motion prescribed."""
    errors = []
    for h in (4e-3, 2e-3, 1e-3):
        record = swaying(round(4.0 / h) + 1, h)
        steps = steps_of(NOMINAL, [record], OBSERVER, transient=1.0)
        estimate = NOMINAL.theta + increment_of(passed(NOMINAL, [record], steps=steps)[0])
        errors.append(np.abs(estimate / np.array(list(TRUE.values())) - 1.0))
    assert np.all(errors[0] < 1e-2)
    order = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert np.all((order > 1.8) & (order < 2.3))


def test_first_order_estimate_converges_at_order_two_in_the_sample_period():
    truth, nominal, errors = level_tank(true=True).parameters, level_tank(), []
    for h in (0.02, 0.01):
        u, y = moved_level(grid(round(8.0 / h) + 1, h), truth)
        record, observer = Record.from_period(h, u, y, hold="smooth"), FirstOrder(1e4)
        steps = steps_of(nominal, [record], observer, transient=1.0)
        estimate = nominal.theta + increment_of(passed(nominal, [record], observer, steps=steps)[0])
        errors.append(np.abs(estimate / np.array(list(truth.values())) - 1.0))
    order = np.log2(errors[0] / errors[1])
    assert np.all(errors[0] < 1e-2)
    assert np.all((order > 1.8) & (order < 2.3))
