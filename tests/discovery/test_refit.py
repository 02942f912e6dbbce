"""A set of effects fitted again: by the estimator, or at the parameters of the search."""

from dataclasses import replace

import numpy as np
import pytest
from output_cases import accelerometer

import eoi_jax as eoi
from eoi_jax.discovery.refit import free_runs, not_simulated, refitted, window_of
from eoi_jax.discovery.task import Task
from eoi_jax.estimation.identify import estimate
from eoi_jax.estimation.preparation import prepare_records
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.effects import InputDelay

TRUTH = {"stiffness": 20.0, "damping": 0.8, "gain": 2.0}


def sprung(t, x, u, p):
    position, rate = x.y
    return -p.stiffness * position - p.damping * rate + p.gain * u


TRUE = eoi.Plant(sprung, TRUTH, 2, ("force",), ("position",))


@pytest.fixture(scope="module")
def task():
    """Noise biases the plain passes, so that the truth is better in free runs."""
    time = np.arange(3000) * 1e-2
    drive = eoi.excitation.multisine(time, 3.0, (0.1, 3.0), 16, seed=1)
    clean = eoi.simulate(TRUE, time, drive, hold="linear").outputs
    noise = 0.03 * np.std(clean) * np.random.default_rng(1).standard_normal(clean.shape)
    record = eoi.Record(time, drive, clean + noise, "noisy", hold="linear",
                        input_names=("force",), output_names=("position",))  # fmt: skip
    prepared = prepare_records(TRUE, (record,))
    declared = estimate(TRUE, prepared)
    return Task(TRUE, prepared, (record,), (), (), declared, 0.01, 3, None)


def test_parameters_of_the_search_are_kept_where_they_are_better_and_the_fit_is_theirs(task):
    found, notes = refitted(task, TRUE)
    assert notes == ("parameters are those of the search: in free runs better than the refit's",)
    assert found.parameters == TRUTH
    assert found.plant.parameters == TRUTH
    assert np.array_equal(found.parameter_history[found.best_pass], TRUE.theta)
    assert np.all(found.correction == 0.0)
    assert found.status.ok
    assert found.index[0, 0] >= np.min(task.declared.index)  # least squares has the smallest


def test_the_estimate_is_kept_where_it_is_better(task):
    far = TRUE.with_parameters({name: 1.5 * value for name, value in TRUTH.items()})
    found, notes = refitted(task, far)
    assert notes == ()
    for name, value in TRUTH.items():
        assert found.parameters[name] == pytest.approx(value, rel=0.2)


def test_a_delay_of_what_shows_jumps_at_once_is_a_multiple_of_the_sample_period_where_that_fits():
    """Four samples late; a hair behind them each jump of the base would come a sample late."""
    plant, time = accelerometer(), np.arange(2000) * 1e-2
    placed = place(plant, InputDelay(), 0)
    late = augmented(plant, (placed,), {"input_delay": 0.04})
    draw = np.random.default_rng(1)
    base = np.repeat(draw.uniform(-0.1, 0.1, 80), 25)
    clean = eoi.simulate(late, time, base, hold="zero").outputs
    record = eoi.Record(time, base, clean + 0.2 * draw.standard_normal(clean.shape), "late",
                        hold="zero", input_names=("base",), output_names=("acc",))  # fmt: skip
    prepared = prepare_records(plant, (record,))
    declared = estimate(plant, prepared)
    task = Task(plant, prepared, (record,), (), (), declared, 0.01, 3, None)
    found, notes = refitted(task, late.with_parameters({"input_delay": 0.0401}))
    assert found.parameters["input_delay"] == 0.04
    assert notes[-1].startswith("input_delay at a multiple of the sample period: in free runs")
    assert 0.0 < found.standard_errors["input_delay"] < 1e-3


def test_short_runs_are_a_tenth_of_a_record_where_that_is_long_enough(task):
    (record,) = task.records
    assert window_of(task, task.records) == pytest.approx(0.1 * len(record) * 1e-2)
    assert window_of(task, [record[:150]]) is None
    whole, short = free_runs(task, TRUE)
    assert short is not None
    assert len(whole.predictions) == 1
    assert not_simulated(TRUE) == ""


def test_short_runs_have_one_length_in_seconds_whatever_the_sample_periods(task):
    """50 Hz beside 1 kHz: a tenth of 20 s, and never fewer than 100 samples of the coarser one."""
    fast, slow = of_period(1e-3, 20.0), of_period(2e-2, 20.0)
    assert window_of(task, [fast, slow]) == window_of(task, [slow, fast]) == pytest.approx(2.0)
    _, short = free_runs(replace(task, held_out=(fast, slow)), TRUE)
    assert short is not None
    assert np.all(short.rmse < 1e-6)
    brief = of_period(1e-3, 5.0)
    assert window_of(task, [brief, slow]) == pytest.approx(100 * 2e-2)
    assert window_of(task, [of_period(1e-3, 3.9), slow]) is None


def of_period(period: float, length: float) -> eoi.Record:
    time = np.arange(round(length / period)) * period
    return eoi.simulate(TRUE, time, np.sin(2.0 * time), hold="linear", substeps=2)
