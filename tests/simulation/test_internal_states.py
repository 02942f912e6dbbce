"""Internal states against closed forms: order four in the step, wherever they are integrated."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eoi_jax.data.record import Record
from eoi_jax.discovery.cosine_modes import integrated
from eoi_jax.estimation.kernel import run_pass
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.observers import FirstOrder
from eoi_jax.estimation.preparation import prepare_steps, step_inputs
from eoi_jax.models.library import Plant
from eoi_jax.simulation.simulate import simulate

DURATION = 2.0


def orders(errors):
    """Of errors at halved steps."""
    return np.log2(np.array(errors[:-1]) / np.array(errors[1:]))


# -- in a pass of the observer: dz/dt = 1 - a z², z(0) = 0, so z = tanh(√a t)/√a ------------------

A, G = 1.7, 0.8
SATURATING = Plant(
    lambda t, x, u, p: p.g * x.z[0] + 0.0 * x.y[0],
    {"a": A, "g": G},
    internal=lambda t, x, u, p: u - p.a * x.z**2,
    internal_initial=[0.0],
)


def regressors_of_a_pass(h):
    """Time and φ in the middle of each step: ∂f/∂g is z, ∂f/∂a is g ∂z/∂a."""
    samples = round(DURATION / h) + 1
    y = np.sin(3.0 * h * np.arange(samples))  # the state does not depend on it
    record = Record.from_period(h, np.ones(samples), y, hold="zero")
    # So quick a filter that nothing of earlier steps is left in it.
    lowpass = jax.tree.map(lambda leaf: np.asarray(leaf)[None], LowPass(200.0 / h).discretise(h))
    steps = prepare_steps(SATURATING, [record], [step_inputs(record, False)], 1, 0.0, 0.1,
                          [np.zeros(1)], False, 0.0)  # fmt: skip
    theta = jnp.asarray(SATURATING.theta)
    _, trace = run_pass(SATURATING, FirstOrder(1e3), lowpass, steps, theta, store="signals")
    assert trace is not None
    return h * (np.arange(samples - 1) + 0.5), np.asarray(trace.Phi)[0, :, 0]


def test_a_pass_follows_an_internal_state_and_its_sensitivity_at_order_four():
    errors = []
    for h in (0.2, 0.1, 0.05, 0.025):
        t, phi = regressors_of_a_pass(h)
        root = np.sqrt(A)
        z = np.tanh(root * t) / root
        slope = 0.5 * t / A / np.cosh(root * t) ** 2 - 0.5 * z / A
        used = phi[:, 1] != 0  # all but a few that the observer starts on
        assert np.count_nonzero(used) >= len(t) - 5
        errors.append(np.max(np.abs(phi - np.stack([G * slope, z], 1))[used], axis=0))
    assert np.all(errors[-1] < 1e-6)
    assert np.all(np.abs(orders(errors)[-1] - 4.0) < 0.3)


# -- in the modes: dz/dt = -2 t z², z(0) = 1, so z = 1/(1 + t²) -----------------------------------


def test_states_of_the_modes_are_integrated_at_order_four():
    """The driving signal is linear over each step: what the ends are taken from is exact."""
    errors = []
    for h in (0.2, 0.1, 0.05, 0.025):
        t = h * (np.arange(round(DURATION / h)) + 0.5)
        z = integrated(lambda z, row: -2.0 * row[0] * z**2, jnp.ones(1), (t,), (h + 0.0 * t,), h)
        errors.append(np.max(np.abs(np.asarray(z)[:, 0] - 1.0 / (1.0 + t**2))))
    assert errors[-1] < 1e-6
    assert abs(orders(errors)[-1] - 4.0) < 0.3


# -- in a free run, with and without dry friction -------------------------------------------------


def fading(t, x, u, p):
    return -2.0 * t * x.z**2


def simulated(plant, initial, h):
    time = h * np.arange(round(DURATION / h) + 1)
    return simulate(plant, time, np.zeros_like(time), initial, hold="zero").outputs


def test_a_smooth_free_run_with_an_internal_state_converges_at_order_four():
    """dy/dt = z² beside it: y = (t/(1 + t²) + atan t)/2."""
    plant = Plant(lambda t, x, u, p: p.a * x.z[0] ** 2, {"a": 1.0}, internal=fading,
                  internal_initial=[1.0])  # fmt: skip
    want = 0.5 * (DURATION / (1.0 + DURATION**2) + np.arctan(DURATION))
    errors = [abs(simulated(plant, 0.0, h)[-1, 0] - want) for h in (0.2, 0.1, 0.05, 0.025)]
    assert errors[-1] < 1e-7
    assert abs(orders(errors)[-1] - 4.0) < 0.5


@pytest.mark.parametrize("speed", [5.0, 0.77])
def test_dry_friction_leaves_an_internal_state_at_order_four(speed):
    """A sliding mass beside dq/dt = z; it slides throughout, or stops in the middle of a step."""

    def dynamics(t, x, u, p):
        return jnp.stack([-p.c * jnp.sign(x.y[1, 0]), x.z[0]])

    plant = Plant(dynamics, {"c": 1.0}, relative_degree=(2, 1), outputs=("x", "q"),
                  internal=fading, internal_initial=[1.0])  # fmt: skip
    slid = min(speed, DURATION)
    want = [speed * slid - 0.5 * slid**2, np.arctan(DURATION)]
    errors = []
    for h in (0.2, 0.1, 0.05, 0.025):
        x, q = simulated(plant, [[0.0, 0.0], [speed, 0.0]], h)[-1]
        assert x == pytest.approx(want[0], abs=1e-12)  # a parabola: exact
        errors.append(abs(q - want[1]))
    assert errors[-1] < 1e-6
    assert abs(orders(errors)[-1] - 4.0) < 0.5
