"""The comparators themselves: derivations, limits, and what each is not made for."""

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax import comparators
from eoi_jax.comparison.methods import vss_direct
from eoi_jax.comparison.methods.filtered import (
    Rows,
    default_filters,
    equation,
    linearised,
    motion,
    usable,
)
from eoi_jax.comparison.methods.plain import explicit_form
from eoi_jax.comparison.methods.svf import Regression, _predicted_fall, least_squares_on
from eoi_jax.comparison.methods.weighed import covariance, solve


def mass(**options) -> eoi.Plant:
    """Affine, one output, nominal values 20 % off."""

    def dynamics(t, x, u, p):
        position, rate = x.y
        return -p.k * position - p.c * rate + p.g * u

    values = {"k": 120.0, "c": 8.0, "g": 2.0}
    return eoi.Plant(dynamics, values, relative_degree=2, **options)


TRUE = {"k": 100.0, "c": 6.0, "g": 1.6}
TIME = np.arange(0.0, 12.0, 2e-3)
INPUT = eoi.excitation.prbs(TIME, amplitude=1.0, switching_period=0.1, seed=3)


@pytest.fixture(scope="module")
def plant() -> eoi.Plant:
    return mass()


@pytest.fixture(scope="module")
def clean(plant: eoi.Plant) -> eoi.Record:
    return eoi.simulate(plant.with_parameters(TRUE), TIME, INPUT)


def noisy(record: eoi.Record, share: float, seed: int) -> eoi.Record:
    rng = np.random.default_rng(seed)
    sigma = share * np.sqrt(np.mean(record.outputs**2))
    y = record.outputs + sigma * rng.standard_normal(record.outputs.shape)
    return record.with_outputs(y, "noisy")


def errors(estimate: comparators.Estimate, truth: dict) -> np.ndarray:
    assert estimate.parameters is not None, estimate.status
    return np.array([estimate.parameters[name] / value - 1.0 for name, value in truth.items()])


# -- filtered signals -----------------------------------------------------------------------------


def test_derivatives_of_a_sine_are_those_of_a_sine(plant: eoi.Plant):
    time, omega = np.arange(0.0, 20.0, 1e-2), 3.0
    record = eoi.Record(time, np.zeros_like(time), np.sin(omega * time))
    now = motion(plant, record, wide=60.0)
    inside = slice(100, -100)
    # Butterworth, order four, both ways: (ω/ω_c)⁸ off at ω, far below the spline's own error.
    for have, want in (
        (now.y[:, 0, 0], np.sin(omega * time)),
        (now.y[:, 1, 0], omega * np.cos(omega * time)),
        (now.highest[:, 0], -(omega**2) * np.sin(omega * time)),
    ):
        np.testing.assert_allclose(have[inside], want[inside], atol=1e-7 * omega**2)


def test_an_output_of_lower_degree_has_no_rate(clean: eoi.Record):
    def dynamics(t, x, u, p):
        return jnp.stack([p.a * u[0], p.b * x.y[1, 0]])

    both = eoi.Plant(dynamics, {"a": 1.0, "b": 1.0}, (2, 1), ("u",), ("y", "w"))
    record = eoi.Record(TIME, INPUT, np.column_stack([clean.outputs, clean.outputs]))
    now = motion(both, record, 50.0)
    assert np.all(now.y[:, 1, 1] == 0.0)
    np.testing.assert_allclose(now.highest[:, 1], now.y[:, 1, 0], rtol=0, atol=0)


def test_linearised_plant_is_its_own_transfer_function(plant: eoi.Plant, clean: eoi.Record):
    one = equation(plant, [clean])
    theta = np.array([100.0, 6.0, 1.6])
    response = linearised(plant, theta, one.motions, 12.0)
    assert response is not None
    np.testing.assert_allclose(response.transition, [[0.0, 1.0], [-100.0, -6.0]], atol=1e-12)
    # A held unit step from rest: g/k after all has settled, here with g = 1.
    step = response.applied(np.ones((len(TIME), 1, 1)), 2e-3)
    assert step[-1, 0, 0] == pytest.approx(1.0 / 100.0, rel=1e-3)


def test_integrators_keep_the_fixed_filter(clean: eoi.Record):
    def dynamics(t, x, u, p):
        return p.g * u - p.c * x.y[1]

    free = eoi.Plant(dynamics, {"g": 1.0, "c": 1.0}, relative_degree=2)
    one = equation(free, [clean])
    assert linearised(free, np.array([1.0, 1.0]), one.motions, 12.0) is None


def test_a_coarse_record_gets_sub_steps_for_the_wide_filter():
    # Fourteen samples a period of the resonance, and a cubic spring whose harmonics lie beyond.
    plant = eoi.plants.duffing_oscillator()
    truth = eoi.plants.duffing_oscillator(reference=True)
    time = np.arange(3000) / 610.35
    u = eoi.excitation.multisine(time, 0.05, (1.0, 150.0), 100, 1)
    record = eoi.simulate(truth, time, u, hold="zero", substeps=16)
    filters = default_filters(plant, [record])
    assert filters.substeps > 1
    assert filters.wide <= 0.501 * np.pi * filters.substeps * 610.35
    found = comparators.StateVariableFilter().estimate(plant, [record])
    # Harmonics beyond the raw Nyquist frequency are left to the spline.
    assert np.max(np.abs(errors(found, truth.parameters))) < 0.01


# -- state-variable filter and instruments --------------------------------------------------------


@pytest.mark.parametrize(
    "method", [comparators.StateVariableFilter(), comparators.StateVariableInstruments()]
)
def test_clean_record_gives_the_truth(method, plant: eoi.Plant, clean: eoi.Record):
    # What is left is the step of the input between samples, which W does not see whole.
    assert np.max(np.abs(errors(method.estimate(plant, [clean]), TRUE))) < 3e-4


def test_standard_errors_are_those_that_seeds_show(plant: eoi.Plant, clean: eoi.Record):
    method, found = comparators.StateVariableFilter(), []
    for seed in range(30):
        one = method.estimate(plant, [noisy(clean, 1e-2, seed)])
        assert one.parameters is not None
        assert one.standard_errors is not None
        found.append([(one.parameters[key] - TRUE[key]) / one.standard_errors[key] for key in TRUE])
    spread = np.std(found, axis=0)
    # χ² of 29 degrees: a ratio within 0.65 to 1.35 in 99.5 %; the rest is that of the sandwich.
    assert np.all((spread > 0.5) & (spread < 1.5)), spread


@pytest.mark.slow
def test_instruments_cure_the_bias_of_least_squares(plant: eoi.Plant):
    # Coarsely sampled, so that much of the noise lies in the band of the plant.
    time = np.arange(0.0, 90.0, 0.03)
    u = eoi.excitation.prbs(time, amplitude=1.0, switching_period=0.3, seed=3)
    record = eoi.simulate(plant.with_parameters(TRUE), time, u)

    def t_statistic(method) -> tuple[np.ndarray, np.ndarray]:
        found = np.array(
            [errors(method.estimate(plant, [noisy(record, 0.2, seed)]), TRUE) for seed in range(8)]
        )
        mean = np.mean(found, axis=0)
        return mean, np.abs(mean) / (np.std(found, axis=0, ddof=1) / np.sqrt(8))

    (biased, sure), (cured, chance) = (
        t_statistic(one)
        for one in (comparators.StateVariableFilter(), comparators.StateVariableInstruments())
    )
    assert np.min(sure) > 5.4  # t of seven degrees, two-sided: one in a thousand
    assert np.max(chance) < 5.4
    assert np.all(np.abs(cured) < 0.3 * np.abs(biased))


def test_a_parameter_that_enters_nonlinearly_takes_gauss_newton(clean: eoi.Record):
    def dynamics(t, x, u, p):
        position, rate = x.y
        return -(p.omega**2) * (position + 2.0 * p.zeta / p.omega * rate - p.static * u)

    curved = eoi.Plant(dynamics, {"omega": 14.0, "zeta": 0.15, "static": 0.03}, 2)
    truth = {"omega": 10.0, "zeta": 0.3, "static": 0.016}
    for method in (comparators.StateVariableFilter(), comparators.StateVariableInstruments()):
        assert np.max(np.abs(errors(method.estimate(curved, [clean]), truth))) < 3e-4


def test_bounds_and_fixed_parameters_are_kept(clean: eoi.Record):
    held = mass(fixed=("g",), bounds={"k": (110.0, 200.0)})
    found = comparators.StateVariableFilter().estimate(held, [clean])
    assert found.parameters is not None
    assert found.parameters["g"] == 2.0
    assert found.parameters["k"] >= 110.0


def test_dry_friction_is_left_out_near_rest_and_said():
    plant = eoi.plants.pendulum()
    truth = eoi.plants.pendulum(true=True)
    time = np.arange(0.0, 20.0, 2e-3)
    record = eoi.simulate(truth, time, eoi.excitation.square(time, amplitude=0.3, frequency=0.2))
    found = comparators.StateVariableFilter().estimate(plant, [record])
    assert "near rest" in found.status.message
    # The velocity jumps in its slope at every reversal: W rounds that corner.
    assert np.max(np.abs(errors(found, truth.parameters))) < 0.05


def test_gaps_are_left_out(plant: eoi.Plant, clean: eoi.Record):
    y = clean.outputs.copy()
    y[2000:2100] = np.nan
    with pytest.warns(eoi.RecordWarning):
        record = eoi.Record(TIME, INPUT, y)
    found = comparators.StateVariableFilter().estimate(plant, [record])
    assert np.max(np.abs(errors(found, TRUE))) < 3e-4


def test_what_leaves_no_trace_is_named(clean: eoi.Record):
    def dynamics(t, x, u, p):
        return -(p.a + p.b) * x.y[0] + p.g * u - p.c * x.y[1]

    double = eoi.Plant(dynamics, {"a": 60.0, "b": 60.0, "g": 2.0, "c": 8.0}, relative_degree=2)
    for method in (comparators.StateVariableFilter(), comparators.VSSDirect()):
        found = method.estimate(double, [clean])
        assert found.parameters is None
        assert found.status.code == "unidentifiable"
        assert "a" in found.status.message


def test_standing_still_is_no_data(plant: eoi.Plant):
    record = eoi.Record(TIME, INPUT, np.ones_like(TIME))
    found = comparators.StateVariableFilter().estimate(plant, [record])
    assert found.status.code == "no_data"


def test_a_model_that_is_not_finite_is_said(clean: eoi.Record):
    def dynamics(t, x, u, p):
        return p.a * jnp.log(x.y[0]) + p.g * u  # of a position of both signs

    bad = eoi.Plant(dynamics, {"a": 1.0, "g": 1.0}, relative_degree=2)
    found = comparators.StateVariableFilter().estimate(bad, [clean])
    assert found.status.code == "diverged"


def test_instruments_that_diverge_are_said():
    def dynamics(t, x, u, p):
        return p.a * x.y[0] ** 2 + p.b * u

    # y' = a y² from one escapes at t = 1/a: within the record for the fixed a, not for the true.
    plant = eoi.Plant(dynamics, {"a": 1.4, "b": 1.0}, fixed=("a",))
    time = np.arange(0.0, 0.9, 1e-3)
    record = eoi.Record(time, np.zeros_like(time) + 1e-3 * np.sin(50 * time), 1.0 / (1.0 - time))
    found = comparators.StateVariableInstruments().estimate(plant, [record])
    assert found.parameters is None
    assert found.status.code == "diverged"
    assert "instruments" in found.status.message


def test_several_outputs_share_one_regression():
    plant = eoi.plants.three_mass_spring_damper()
    truth = eoi.plants.three_mass_spring_damper(true=True)
    time = np.arange(0.0, 8.0, 2e-3)
    u = eoi.excitation.prbs(time, amplitude=1.0, switching_period=0.05, seed=1)
    one = equation(plant, [eoi.simulate(truth, time, u)])
    end, status = least_squares_on(one)
    assert status.ok
    share = end.theta / np.asarray(truth.theta) - 1.0
    assert np.max(np.abs(share)) < 1e-2  # dampers are a thousandth of the acceleration


# -- the paper's passes ---------------------------------------------------------------------------


def test_explicit_form_covers_the_injection_that_it_was_made_for(
    plant: eoi.Plant, clean: eoi.Record
):
    first = eoi.identify(plant, clean, passes=1)
    observer = explicit_form(first)
    assert isinstance(observer, eoi.observers.SecondOrder)
    assert observer.scheme == "explicit"
    largest = np.nanmax(np.abs(first.first_injection[0]))
    np.testing.assert_allclose(observer.c3, 2.0 * largest)


@pytest.mark.slow
def test_explicit_form_of_outputs_of_different_degree(clean: eoi.Record):
    def dynamics(t, x, u, p):
        return jnp.stack([-p.k * x.y[0, 0] - 6.0 * x.y[1, 0] + p.g * u[0], -p.a * x.y[0, 1]])

    both = eoi.Plant(dynamics, {"k": 90.0, "g": 1.5, "a": 1.0}, (2, 1), ("u",), ("y", "w"))
    y = np.column_stack([clean.outputs, np.exp(-0.5 * TIME)])
    records = [eoi.Record(TIME, INPUT, y), eoi.Record(TIME, 0.5 * INPUT, 0.5 * y)]
    found = eoi.identify(both, records, passes=1)
    observer = explicit_form(found)
    assert isinstance(observer, eoi.observers.PerOutput)
    assert [one.scheme for one in observer.observers] == ["explicit", "explicit"]
    injections = found.first_injection
    largest = np.max([np.nanmax(np.abs(one[:, 0])) for one in injections])
    fastest = np.max([np.nanmax(np.abs(np.diff(one[:, 1]))) for one in injections]) / 2e-3
    second, first = observer.observers
    assert isinstance(second, eoi.observers.SecondOrder)
    assert isinstance(first, eoi.observers.FirstOrder)
    np.testing.assert_allclose(second.c3, 2.0 * largest)
    np.testing.assert_allclose(first.delta, 2.0 * fastest)


def test_explicit_filter_stays_below_the_limit_cycle(plant: eoi.Plant, clean: eoi.Record):
    # Chatter at √(1.4 ω_c/h), four cut-offs away or more: the estimate is of the right size.
    found = comparators.PlainExplicit().estimate(plant, [clean])
    assert np.max(np.abs(errors(found, TRUE))) < 0.2


# -- what a method is not made for ----------------------------------------------------------------


def test_internal_states_are_not_applicable():
    plant = eoi.plants.cascaded_tanks()
    time = np.arange(0.0, 400.0, 4.0)
    record = eoi.Record(time, 2.0 + np.sin(0.05 * time), 5.0 + np.sin(0.05 * time))
    for method in (
        comparators.StateVariableFilter(),
        comparators.StateVariableInstruments(),
        comparators.VSSDirect(),
    ):
        found = method.estimate(plant, [record])
        assert found.parameters is None
        assert found.status.code == "not_applicable"
        assert "internal" in found.status.message


def test_third_degree_is_not_applicable_to_explicit_and_vss():
    def dynamics(t, x, u, p):
        return -p.a * x.y[0] - p.b * x.y[1] - 3.0 * x.y[2] + u[0]

    third = eoi.Plant(dynamics, {"a": 1.2, "b": 3.5}, relative_degree=3)
    time = np.arange(0.0, 20.0, 1e-2)
    truth = third.with_parameters({"a": 1.0, "b": 3.0})
    record = eoi.simulate(truth, time, np.sin(0.7 * time))
    for method in (comparators.PlainExplicit(), comparators.VSSDirect()):
        found = method.estimate(third, [record])
        assert found.status.code == "not_applicable"
        assert "degree" in found.status.message


# -- VSS direct -----------------------------------------------------------------------------------


def test_vss_at_the_truth_stays_there(clean: eoi.Record):
    # α̂₀ in the middle of the bounds: with α - α̂₀ = 0 there is nothing for the filter to delay.
    bounds = {"k": (50.0, 150.0), "c": (3.0, 9.0), "g": (0.8, 2.4)}
    found = comparators.VSSDirect().estimate(mass(bounds=bounds), [clean])
    assert np.max(np.abs(errors(found, TRUE))) < 0.01


def test_vss_takes_the_lag_of_its_filter_for_damping(clean: eoi.Record):
    bounds = {"k": (50.0, 450.0), "c": (3.0, 9.0), "g": (0.8, 2.4)}
    plant = mass(bounds=bounds)
    found = comparators.VSSDirect().estimate(plant, [clean])
    assert found.parameters is not None
    # Middle 250, true 100: 150 y behind a lag τ is 150 (y - τ ẏ), to first order in τ.
    lag = 1.0 / default_filters(plant, [clean]).narrow
    assert found.parameters["c"] - TRUE["c"] == pytest.approx(150.0 * lag, rel=0.2)
    assert found.parameters["k"] == pytest.approx(TRUE["k"], rel=0.02)


def test_vss_takes_first_order_and_several_outputs():
    def dynamics(t, x, u, p):
        return jnp.stack([-p.a * x.y[0, 0] + u[0], -p.b * x.y[0, 1] + p.a * x.y[0, 0]])

    plant = eoi.Plant(dynamics, {"a": 2.2, "b": 0.9}, 1, ("u",), ("y1", "y2"))
    truth = {"a": 2.0, "b": 1.0}
    record = eoi.simulate(plant.with_parameters(truth), TIME, INPUT)
    found = comparators.VSSDirect().estimate(plant, [record])
    assert np.max(np.abs(errors(found, truth))) < 0.1
    assert found.standard_errors is None


@pytest.mark.parametrize(
    ("drift", "code", "advice"), [(0.0, "converged", False), (0.1, "passes_exhausted", True)]
)
def test_vss_answers_by_the_mean_of_its_last_tenth_and_says_whether_it_drifts(drift, code, advice):
    plant, share = mass(), np.linspace(-9.0, 1.0, 2001)  # over the last tenth from zero to one
    steady = np.array([100.0, 6.0, 1.6])
    history = steady * (1.0 + drift * share[:, None])
    found = vss_direct._answer(plant, history)
    assert found.status.code == code
    assert ("longer records" in found.status.message) is advice
    # From the first half of it to the second the mean moves by half of what it moves in all.
    moved = 0.5 * drift / (1.0 + 0.5 * drift)
    assert f"by {moved:.2g} at most" in found.status.message
    assert found.parameters is not None
    np.testing.assert_allclose(
        list(found.parameters.values()), steady * (1.0 + 0.5 * drift), rtol=1e-3
    )
    history[7] = np.nan
    assert vss_direct._answer(plant, history).status.code == "diverged"


def test_vss_uses_the_papers_intervals_for_the_papers_plant(clean: eoi.Record):
    plant = eoi.plants.mass_spring_damper()
    far = plant.with_parameters({"alpha": 1000.0, "beta": 100.0, "rho": 50.0})
    # The nominal values play no part: all comes from the intervals of section 6.
    first, second = (comparators.VSSDirect().estimate(one, [clean]) for one in (plant, far))
    assert first.parameters == pytest.approx(second.parameters, rel=1e-9)


@pytest.mark.parametrize("memory", [0, 150])  # samples; fifty blocks of scores, or ten
def test_the_sandwich_of_white_residuals_is_their_covariance(memory):
    """σ² (ΦᵀΦ)⁻¹ on average, of two outputs with noise of their own and weights to match."""
    draw = np.random.default_rng(5)
    sigma, free, total = np.array([0.2, 3.0]), np.ones(2), np.zeros((2, 2))
    for _ in range(200):
        phi = [draw.standard_normal((length, 2, 2)) for length in (1000, 500)]
        error = [sigma * draw.standard_normal(one.shape[:2]) for one in phi]
        rows = Rows(phi, error, np.ones(2))
        solved = solve(rows, rows, free)
        flat = np.concatenate(phi) / sigma[:, None]
        exact = np.linalg.inv(np.einsum("kja,kjb->ab", flat, flat))
        size = np.sqrt(np.diagonal(exact))
        total += covariance(solved, rows, rows, memory) / np.outer(size, size)
    # Each has 50 or 10 blocks, so that the mean of 200 is uncertain by 1.4 or 3.2 %.
    np.testing.assert_allclose(total / 200, np.eye(2), atol=0.07)


def test_a_steady_motion_is_no_rest():
    def block(t, x, u, p):
        return p.g * u - p.c * jnp.sign(x.y[1])

    plant = eoi.Plant(block, {"g": 1.0, "c": 0.1}, 2)
    time = 0.01 * np.arange(1000)
    position = np.where(time < 5.0, 0.7 * time, 3.5)  # moves, then stands
    record = eoi.Record(time, 0.0 * time, position)
    filters = default_filters(plant, [record])
    keep = usable(plant, record, motion(plant, record, filters.wide), filters)[:, 0]
    assert np.all(keep[200:400] == 1.0)
    assert np.all(keep[600:800] == 0.0)


def test_too_few_blocks_leave_errors_unknown_but_not_of_what_is_fixed():
    draw = np.random.default_rng(1)
    rows = Rows([draw.standard_normal((40, 1, 2))], [draw.standard_normal((40, 1))], np.ones(1))
    solved = solve(rows, rows, np.array([1.0, 0.0]))
    found = covariance(solved, rows, rows, 30)
    np.testing.assert_array_equal(found, [[np.nan, 0.0], [0.0, 0.0]])


def test_an_output_that_stands_still_does_not_hide_that_steps_have_settled():
    phi = np.stack([np.ones((50, 2)), np.zeros((50, 2))], axis=1)
    error = np.stack([np.full(50, 0.5), np.zeros(50)], axis=1)
    rows = Rows([phi], [error], np.array([4.0, 0.0]))
    now = Regression(np.zeros(2), rows, solve(rows, rows, np.ones(2)))
    assert _predicted_fall(now, np.zeros(2)) == 0.0
    # Of the two powers only one falls, to 0.6² of it: their geometric mean to 0.6.
    fall = _predicted_fall(now, np.array([0.1, 0.1]))
    assert fall / now.cost == pytest.approx(0.4)
