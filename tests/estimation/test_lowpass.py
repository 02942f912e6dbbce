"""The filter (19): its poles, its gain, its exact sampling."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import grid, lag_step_response
from scipy import signal

from eoi_jax.estimation.lowpass import LowPass

ORDERS = range(1, 7)


def butterworth(order, cutoff) -> Any:
    """The continuous filter, by scipy."""
    poly: Any = signal.butter(order, cutoff, analog=True)
    return signal.lti(*poly)


def run(lowpass, h, values):
    """Outputs after each sample of `values`, from rest."""
    sampled = lowpass.discretise(h)
    state = jnp.zeros((lowpass.order, *np.shape(values)[1:]))
    shown = []
    for value in values:
        state = sampled.step(state, jnp.asarray(value))
        shown.append(np.asarray(state[0]))
    return np.array(shown)


def test_order_two_is_eq_19():
    np.testing.assert_allclose(LowPass(30.0).denominator(), [1.0, np.sqrt(2.0), 1.0], rtol=1e-14)


@pytest.mark.parametrize("order", ORDERS)
def test_poles_are_those_of_butterworth(order):
    want = butterworth(order, 1.0).den
    np.testing.assert_allclose(LowPass(30.0, order).denominator(), want, rtol=1e-12)


@pytest.mark.parametrize("order", ORDERS)
def test_a_constant_passes_unchanged(order):
    sampled = LowPass(30.0, order).discretise(1e-3)
    steady = np.linalg.solve(np.eye(order) - sampled.transition, sampled.entry)
    np.testing.assert_allclose(steady[0], 1.0, rtol=1e-10)  # condition of I - Φ at ω h = 0.03


@pytest.mark.parametrize("order", ORDERS)
def test_amplitude_at_the_cutoff_is_minus_3_db(order):
    cutoff, h = 30.0, 1e-4
    sampled = LowPass(cutoff, order).discretise(h)
    z = np.exp(1j * cutoff * h)
    gain = np.linalg.solve(z * np.eye(order) - sampled.transition, sampled.entry + 0j)[0]
    # The held input alone costs 1 - (ω h)²/24, 4e-7 here.
    np.testing.assert_allclose(np.abs(gain), np.sqrt(0.5), rtol=1e-6)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("relative", [1e-3, 0.1, 2.0])
def test_sampled_step_response_is_the_continuous_one(order, relative):
    cutoff = 30.0
    h = relative / cutoff
    count = min(round(8.0 / relative), 200)
    t = grid(count + 1, h)
    _, want = butterworth(order, cutoff).step(T=t)
    got = run(LowPass(cutoff, order), h, np.ones(count))
    # scipy's own step response of order six loses digits in its companion form.
    np.testing.assert_allclose(got, want[1:], atol=1e-9)


def test_order_one_is_a_first_order_lag():
    got = run(LowPass(5.0, 1), 0.02, np.ones(100))
    np.testing.assert_allclose(got, lag_step_response(grid(101, 0.02)[1:], 5.0), rtol=1e-12)


def test_many_signals_at_once_equal_one_at_a_time():
    values = np.random.default_rng(0).standard_normal((20, 2, 3))
    lowpass = LowPass(30.0, 3)
    together = run(lowpass, 0.01, values)
    for i in range(2):
        for j in range(3):
            alone = run(lowpass, 0.01, values[:, i, j])
            np.testing.assert_allclose(together[:, i, j], alone, atol=1e-14)


def test_a_step_of_many_signals_calls_no_matrix_library():
    # A loop that calls one is no longer compiled as a whole: a pass takes thirty times as long.
    sampled = LowPass(30.0, 3).discretise(0.01)
    step = jax.jit(lambda state, value: sampled.step(state, value))
    compiled = step.lower(jnp.zeros((3, 1, 8)), jnp.zeros((1, 8))).compile()
    text = str(compiled.as_text())
    assert "multiply(" in text
    assert "dot(" not in text
    assert "custom-call" not in text


@pytest.mark.parametrize("order", ORDERS)
def test_impulse_response_has_decayed_to_a_percent_after_the_memory(order):
    lowpass = LowPass(30.0, order)
    t = np.linspace(0.0, 3.0 * lowpass.memory, 3001)
    _, response = butterworth(order, 30.0).impulse(T=t)
    late = np.max(np.abs(response[t > lowpass.memory])) / np.max(np.abs(response))
    # The envelope of the slowest pole has its own amplitude, up to 5 at order six.
    assert 1e-4 < late < 0.05


@pytest.mark.parametrize("cutoff", [0.0, -3.0, np.nan, np.inf])
def test_cutoff_must_be_positive(cutoff):
    with pytest.raises(ValueError, match=r"`cutoff` must be positive and finite.*in rad/s"):
        LowPass(cutoff)


@pytest.mark.parametrize("order", [0, -1])
def test_order_must_be_at_least_one(order):
    with pytest.raises(ValueError, match="`order` must be an integer ≥ 1, got"):
        LowPass(10.0, order)
