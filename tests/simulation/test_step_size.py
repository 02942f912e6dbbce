"""Steps of free runs, from the fastest mode of the model."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

import eoi_jax as eoi
from eoi_jax.simulation.step_size import RULES, choose_steps, fastest_mode, settled_steps

PERIOD = 0.01


def two_modes(slow, fast):
    """ẏ = slow (z − y), ż = fast (u − z): eigenvalues −slow and −fast."""
    return eoi.Plant(
        lambda t, x, u, p: p.slow * (x.z[0] - x.y[0]),
        {"slow": slow, "fast": fast},
        internal=lambda t, x, u, p: jnp.stack([p.fast * (u[0] - x.z[0])]),
        internal_initial=(0.0,),
        bounds={"slow": (1e-3, 1e6), "fast": (1e-3, 1e6)},
    )


def record_of(slow, fast, noise=1e-4, count=600, seed=0):
    """The exact response to a held input, by the matrix exponential."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 0.0, 1.0], count // 20), 20)
    block = np.array([[-slow, slow, 0.0], [0.0, -fast, fast], [0.0, 0.0, 0.0]])
    step = expm(PERIOD * block)[:2]
    x, y = np.zeros(2), np.zeros(count)
    for k in range(count):
        y[k] = x[0]
        x = step @ [*x, u[k]]
    y += noise * rng.standard_normal(count)
    return eoi.Record.from_period(PERIOD, u, y, hold="zero")


def test_the_fastest_mode_is_the_largest_eigenvalue():
    assert fastest_mode(two_modes(3.0, 500.0), record_of(3.0, 500.0)) == pytest.approx(500.0)


@pytest.mark.parametrize("ratio", [0.1, 1.0, 10.0, 100.0])
def test_the_true_parameters_leave_only_the_noise(ratio):
    """A time constant of the sample period over `ratio`."""
    slow, fast = 3.0, ratio / PERIOD
    run = eoi.validate(two_modes(slow, fast), record_of(slow, fast))
    assert run.rmse[0] <= 1.05e-4
    assert not run.notes


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [3.0, 30.0])
def test_a_mode_faster_than_the_sampling_does_not_bias_the_slow_one(ratio):
    slow, fast = 3.0, ratio / PERIOD
    start = two_modes(slow, fast).with_parameters({"slow": 2.0, "fast": 2.0 * fast})
    found = eoi.refine(start, record_of(slow, fast))
    assert abs(found.parameters["slow"] - slow) < 4.0 * found.standard_errors["slow"]
    assert found.rmse[0] <= 1.05e-4


def test_longer_steps_stay_where_shorter_ones_agree():
    plant, record = two_modes(3.0, 20.0), record_of(3.0, 20.0)
    chosen, asked = eoi.validate(plant, record), eoi.validate(plant, record, substeps=4)
    np.testing.assert_array_equal(chosen.rmse, asked.rmse)


@pytest.mark.parametrize(
    ("change", "answer"),
    [
        (lambda count: 1.0 / count, (64, True)),  # falls with h: enough from 1/50 on
        (lambda count: 1.0, (64, False)),  # a chaotic run
        (lambda count: np.nan if count < 8 else 1.0 / count**4, (8, True)),
        (lambda count: np.inf, (64, False)),
        (lambda count: 50.0 / count, (1024, False)),  # falls, but never enough
        (lambda count: 0.0, (4, True)),
    ],
)
def test_steps_are_halved_as_long_as_that_leads_anywhere(change, answer):
    def of_two_outputs(count):
        # The second one is fitted exactly, and moved by less than can be measured.
        return np.array([change(count), 1e-8]), np.array([1.0, 0.0]), np.array([9.0, 1.0])

    assert settled_steps(4, 1024, of_two_outputs) == answer


def test_a_mode_too_fast_for_any_steps_is_named():
    plant, record = two_modes(3.0, 1e6), record_of(3.0, 100.0)
    choice = choose_steps(plant, [record])
    assert choice.count == RULES.finest
    assert choice.note in eoi.validate(plant, record).notes
    assert "a time constant of 1e-06 s" in choice.note
    assert "steady state" in choice.note


def test_a_slope_that_is_infinite_at_one_point_is_no_mode():
    """The root of an empty tank: ẏ = u − √y has λ = −1/(2√y)."""
    tank = eoi.Plant(lambda t, x, u, p: u[0] - p.a * jnp.sqrt(jnp.maximum(x.y[0], 0.0)), {"a": 1.0})
    y = np.concatenate([np.full(300, 1.0), [0.0, 1e-30], np.full(300, 1.0)])
    y += np.linspace(0.0, 1e-3, len(y))
    record = eoi.Record.from_period(PERIOD, np.ones(len(y)), y, hold="zero")
    assert fastest_mode(tank, record) == pytest.approx(0.5, rel=0.01)


@pytest.mark.slow
@pytest.mark.long
def test_an_identification_says_that_the_sampling_does_not_resolve_a_mode():
    """Both states measured, so that the passes need no internal state."""
    slow, fast = 3.0, 1600.0

    def dynamics(t, x, u, p):
        quick, lazy = x.y[0]
        return jnp.stack([p.fast * (u[0] - quick), p.slow * (quick - lazy)])

    rng = np.random.default_rng(1)
    u = np.repeat(rng.choice([-1.0, 0.0, 1.0], 30), 20)
    block = np.array([[-fast, 0.0, fast], [slow, -slow, 0.0], [0.0, 0.0, 0.0]])
    step, x, y = expm(PERIOD * block)[:2], np.zeros(2), np.zeros((len(u), 2))
    for k in range(len(u)):
        y[k] = x
        x = step @ [*x, u[k]]
    y += 1e-3 * rng.standard_normal(y.shape)
    record = eoi.Record.from_period(PERIOD, u, y, hold="zero")
    plant = eoi.Plant(dynamics, {"fast": 1000.0, "slow": 2.0}, outputs=("quick", "lazy"),
                      bounds={"fast": (1.0, 1e5), "slow": (0.1, 100.0)})  # fmt: skip
    found = eoi.identify(plant, record)
    assert found.status.code == "undersampled"
    assert found.status.ok
    assert "refine" in found.status.message
    # What it warns of: the estimate is far off, by many of its standard errors.
    assert found.parameters["fast"] < 0.5 * fast
    refined = eoi.refine(found, record)
    assert abs(refined.parameters["slow"] - slow) < 4.0 * refined.standard_errors["slow"]
    answer = eoi.discover(plant, record, 0.4)
    assert answer.status.code == "nothing_missing"
    assert answer.changed
    assert abs(answer.plant.parameters["slow"] - slow) < 0.05 * slow
