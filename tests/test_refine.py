"""Output-error refinement: derivatives, exact recovery, bounds, windows, failures."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.checks import RecordWarning
from eoi_jax.output_error import (
    Unknowns,
    errors,
    guessed_starts,
    linearised,
    problem_of,
    spans_of,
)
from eoi_jax.plants import duffing_oscillator, mass_spring_damper
from eoi_jax.refine import refine

TIME = np.arange(1001) * 5e-3
FORCE = np.sin(2.0 * TIME) + np.cos(7.0 * TIME)


def rubbing(t, x, u, p):
    position, rate = x.y
    return (u - p.viscous * rate - p.spring * position - p.dry * jnp.sign(rate)) / p.mass


RUBBING = eoi.Plant(
    rubbing,
    {"mass": 0.5, "viscous": 0.3, "spring": 4.0, "dry": 0.25},
    relative_degree=2,
    inputs=("force",),
    outputs=("position",),
)


def run(plant, initial=None, noise=0.0, seed=0, force=FORCE, **options):
    record = eoi.simulate(plant, TIME, force, initial, hold="linear", substeps=4, **options)
    error = noise * np.random.default_rng(seed).standard_normal(record.outputs.shape)
    return eoi.Record(TIME, force, record.outputs + error, record.name, hold="linear")


def prepared(plant, records, window, substeps=2):
    spans = spans_of(records, window)
    problem = problem_of(plant, records, spans, substeps)
    theta = jnp.asarray(plant.theta)[np.asarray(problem.free)]
    starts = guessed_starts(problem, records, spans, substeps)
    return problem, Unknowns(theta, jnp.asarray(starts))


@pytest.mark.parametrize("window", [None, 1.7])
def test_derivatives_are_finite_differences_with_dry_friction_too(window):
    record = run(RUBBING.with_parameters({"mass": 0.6, "dry": 0.3}))
    problem, unknowns = prepared(RUBBING, [record], window)
    _, jacobian = jax.jit(linearised)(unknowns, problem)
    own, free = unknowns.starts.shape[1], len(problem.free)

    @jax.jit
    def flat(x):
        return errors(Unknowns(x[:free], x[free:].reshape(unknowns.starts.shape)), problem)

    x = np.concatenate([unknowns.theta, np.ravel(unknowns.starts)])
    for j in range(len(x)):
        step = 1e-6 * max(abs(x[j]), 0.1)
        moved = np.eye(len(x))[j] * step
        slope = np.asarray(flat(x + moved) - flat(x - moved)) / (2 * step)
        column = np.zeros_like(slope)
        if j < free:
            column = np.asarray(jacobian[own + j])
        else:
            i, k = divmod(j - free, own)
            column[i] = jacobian[k, i]
        # Differences are off by the bend over their step, and by 1e-15 over it.
        assert np.linalg.norm(slope - column) < 1e-5 * np.linalg.norm(column), j


OSCILLATOR = duffing_oscillator().with_parameters(
    {"gain": 1.2, "damping": 0.5, "stiffness": 9.0, "cubic_stiffness": 4.0, "offset": 0.1}
)


@pytest.mark.parametrize("window", [None, 1.0])
def test_noise_free_runs_give_the_truth(window):
    start = OSCILLATOR.with_parameters(0.7 * np.asarray(OSCILLATOR.theta))
    result = refine(start, run(OSCILLATOR, [0.02, -0.1]), window=window)
    assert result.status.code == "converged"
    np.testing.assert_allclose(result.plant.theta, OSCILLATOR.theta, rtol=1e-7)
    assert result.rmse[0] < 1e-9 < result.before[0]
    assert result.cost < result.cost_before
    np.testing.assert_allclose(result.starts[0].y[:, 0], [0.02, -0.1], rtol=1e-6)
    assert [one.time for one in result.starts] == ([0.0] if window is None else [0, 1, 2, 3, 4])
    assert "refined" in str(result)


def test_dry_friction_is_refined_to_the_truth():
    true = RUBBING.with_parameters({"mass": 0.6, "viscous": 0.4, "spring": 5.0, "dry": 0.4})
    result = refine(RUBBING, run(true))
    assert result.status.ok
    # Moments of rest come and go with the parameters, so that the cost has kinks.
    np.testing.assert_allclose(result.plant.theta, true.theta, rtol=1e-4)


def test_estimates_scatter_as_their_standard_errors_say():
    """White noise: the sandwich over blocks is then the classical covariance, on average."""
    true, off = mass_spring_damper(true=True), []
    for seed in range(12):
        record = run(true, [0.01, -0.05], 1e-4, seed)
        result = refine(true, record, substeps=1)
        assert result.rmse[0] == pytest.approx(1e-4, rel=0.1)
        errors_of = np.asarray(list(result.standard_errors.values()))
        off.append((np.asarray(result.plant.theta) - true.theta) / errors_of)
    # 36 values, twenty blocks each: Student's t with 19 degrees of freedom, mean square 1.12;
    # three parameters of one run go together, so the bounds are wide.
    assert 0.4 < np.mean(np.square(off)) < 2.5


def test_bounds_and_fixed_parameters_are_kept():
    def plant(bounds, fixed):
        values = {"gain": 1.0, "damping": 0.3, "stiffness": 8.0, "cubic": 4.0, "offset": 0.1}
        return eoi.Plant(hardening, values, 2, ("u",), ("y",), bounds=bounds, fixed=fixed)

    record = run(plant({}, ()).with_parameters({"damping": 0.5, "stiffness": 9.0}))
    result = refine(plant({"damping": (0.1, 0.35)}, ("cubic",)), record)
    assert result.parameters["damping"] == 0.35
    assert result.parameters["cubic"] == 4.0
    assert result.standard_errors["cubic"] == 0.0
    assert np.isnan(result.standard_errors["damping"])
    assert result.notes == ("damping ended on its bound, 0.35",)
    assert 0.0 < result.standard_errors["stiffness"] < 1.0
    # The best model with that damping, as one without bounds finds it.
    held = refine(plant({}, ("damping", "cubic")).with_parameters({"damping": 0.35}), record)
    assert result.cost == pytest.approx(held.cost, abs=1e-5)
    free = refine(plant({}, ("cubic",)), record)
    assert free.cost < result.cost < result.cost_before


def hardening(t, x, u, p):
    position, rate = x.y
    spring = p.stiffness * position + p.cubic * position**3
    return p.gain * u - p.damping * rate - spring + p.offset


def test_masked_samples_and_burn_in_are_not_scored():
    record = run(OSCILLATOR, [0.02, -0.1])
    spoilt = record.outputs.copy()
    spoilt[:100] += 1.0
    spoilt[400:420] = np.nan
    with pytest.warns(RecordWarning):
        record = eoi.Record(TIME, FORCE, spoilt, hold="linear", burn_in=0.5)
    start = OSCILLATOR.with_parameters({"stiffness": 8.0})
    result = refine(start, record)
    np.testing.assert_allclose(result.plant.theta, OSCILLATOR.theta, rtol=1e-6)
    missing = np.isnan(result.residual[0][:, 0])
    assert missing[:100].all()
    assert missing[400:420].all()
    assert not missing[100:399].any()
    assert not missing[421:].any()


def two_lags(t, x, u, p):
    return jnp.stack([(u[0] - x.y[0, 0]) / p.first, (x.y[0, 0] - x.y[0, 1]) / p.second])


def test_records_of_any_length_and_outputs_of_any_size_share_one_estimate():
    """The second output has noise of its own, a thousand times larger: it hardly weighs."""
    plant = eoi.Plant(two_lags, {"first": 0.4, "second": 0.2}, 1, ("u",), ("a", "b"))
    true = plant.with_parameters({"first": 0.3, "second": 0.3})
    noise = np.array([1e-5, 1e-2])
    records = []
    for seed, count in enumerate((1001, 400)):
        time = TIME[:count]
        clean = eoi.simulate(true, time, FORCE[:count], hold="linear", substeps=4)
        error = noise * np.random.default_rng(seed).standard_normal(clean.outputs.shape)
        records.append(eoi.Record(time, FORCE[:count], clean.outputs + error, hold="linear"))
    result = refine(plant, records)
    assert result.status.ok
    np.testing.assert_allclose(result.rmse, noise, rtol=0.1)
    for name, value in true.parameters.items():
        assert abs(result.parameters[name] - value) < 4.0 * result.standard_errors[name]
    assert result.standard_errors["first"] < 1e-2 * result.standard_errors["second"]
    assert [len(one) for one in result.residual] == [1001, 400]


def filling(t, x, u, p):
    return p.gain * x.z[0] - x.y[0, 0]


def rising(t, x, u, p):
    return u - p.rate * x.z


def test_internal_states_start_as_declared_and_freely_in_later_windows():
    plant = eoi.Plant(
        filling, {"gain": 1.0, "rate": 2.0, "begin": 0.5}, 1, ("u",), ("y",),
        internal=rising, internal_initial=lambda p: jnp.reshape(p.begin, (1,)), fixed=("gain",),
    )  # fmt: skip
    true = plant.with_parameters({"rate": 1.0, "begin": 1.5})
    record = run(true)
    for window in (None, 1.0):
        result = refine(plant, record, window=window)
        np.testing.assert_allclose(result.plant.theta, true.theta, rtol=1e-5)
        assert result.starts[0].z[0] == result.parameters["begin"]
    assert len(result.starts) == 5


def growing(t, x, u, p):
    return p.rate * x.y[0] ** 3 + p.gain * u


def test_a_start_that_diverges_is_said_and_shorter_runs_fit():
    plant = eoi.Plant(growing, {"rate": 1.0, "gain": 1.0}, 1, ("u",), ("y",))
    record = run(plant.with_parameters({"rate": -2.0}))
    result = refine(plant, record)
    assert result.status.code == "diverged"
    assert "window" in result.status.message
    assert result.parameters == plant.parameters
    shorter = refine(plant, record, window=0.2)
    assert shorter.status.ok
    np.testing.assert_allclose(shorter.plant.theta, [-2.0, 1.0], rtol=1e-6)


def shared(t, x, u, p):
    return p.a * p.b * u - x.y[0]


def test_parameters_that_cannot_be_told_apart_are_named():
    plant = eoi.Plant(shared, {"a": 1.0, "b": 2.0}, 1, ("u",), ("y",))
    result = refine(plant, run(plant.with_parameters({"a": 1.5})))
    assert result.status.code == "unidentifiable"
    assert "a" in result.status.message
    assert "b" in result.status.message
    assert result.rmse[0] < 1e-6


def test_too_few_steps_are_said():
    result = refine(OSCILLATOR.with_parameters({"stiffness": 5.0}), run(OSCILLATOR), max_steps=2)
    assert result.status.code == "passes_exhausted"
    assert result.rmse[0] < result.before[0]


def test_records_without_a_scored_sample_are_said():
    record = eoi.Record(TIME, FORCE, run(OSCILLATOR).outputs, hold="linear", burn_in=10.0)
    result = refine(OSCILLATOR, record)
    assert result.status.code == "no_data"


@pytest.mark.parametrize(
    ("options", "field"),
    [({"window": -1.0}, "window"), ({"max_steps": 0}, "max_steps"), ({"substeps": 0}, "substeps")],
)
def test_wrong_arguments_are_named(options, field):
    with pytest.raises(ValueError, match=f"`{field}`"):
        refine(OSCILLATOR, run(OSCILLATOR), **options)


def test_an_identification_is_refined_and_the_result_is_saved(tmp_path):
    start = OSCILLATOR.with_parameters({"stiffness": 8.0})
    record = run(OSCILLATOR, noise=1e-4)
    result = refine(eoi.identify(start, record), record)
    assert result.status.ok
    result.save(tmp_path / "refined.npz")
    again = eoi.load(tmp_path / "refined.npz")
    assert again.parameters == result.parameters
    assert again.status == result.status
