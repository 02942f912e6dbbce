"""Growth of the error of a start, and free runs in windows where it is large."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

import eoi_jax as eoi
from eoi_jax.data.windows import start_samples
from eoi_jax.simulation.error_growth import RULES, error_growth, returns
from eoi_jax.simulation.validate import validated_alike

PERIOD = 0.01
NOISE = 1e-3


def first_order(rate):
    return eoi.Plant(lambda t, x, u, p: p.rate * x.y[0] + u, {"rate": rate}, 1)


def second_order(a=25.0, b=1.0, c=4.0):
    return eoi.Plant(
        lambda t, x, u, p: p.a * x.y[0] - p.b * x.y[1] + p.c * u, {"a": a, "b": b, "c": c}, 2
    )


def noise_record(count=400):
    rng = np.random.default_rng(0)
    return eoi.Record.from_period(
        PERIOD, rng.standard_normal(count), rng.standard_normal(count), hold="zero"
    )


def balanced(count=1500, seed=1, noise=NOISE):
    """ÿ = 25 y − ẏ + 4 u under state feedback, steps at the reference, by the exponential."""
    rng = np.random.default_rng(seed)
    block = np.array([[0.0, 1.0, 0.0], [25.0, -1.0, 4.0], [0.0, 0.0, 0.0]])
    step, x = expm(PERIOD * block)[:2], np.zeros(2)
    reference = np.repeat(rng.uniform(-1.0, 1.0, -(-count // 60)), 60)
    u, y = np.empty(count), np.empty(count)
    for k in range(count):
        y[k] = x[0]
        u[k] = -18.0 * (x[0] - reference[k]) - 2.5 * x[1]
        x = step @ [*x, u[k]]
    return eoi.Record.from_period(PERIOD, u, y + noise * rng.standard_normal(count), hold="zero")


def test_growth_of_a_first_order_plant_is_that_of_the_closed_form():
    record, rate = noise_record(), 2.0
    head = start_samples(record, 1)
    last = len(record) - 1
    at = np.exp(rate * PERIOD * np.arange(len(record)))
    expected = at[last] / np.sqrt(np.sum(at[:head] ** 2))
    assert error_growth(first_order(rate), [record]).largest == pytest.approx(expected, rel=1e-9)


def test_growth_of_a_double_integrator_is_that_of_an_extrapolated_line(monkeypatch):
    """It grows with time only, so that whole runs can be fitted: by default it is not asked for."""
    record = noise_record(3000)
    assert not error_growth(second_order(a=0.0, b=0.0), [record]).growing
    rules = replace(RULES, exponent=-np.inf)
    monkeypatch.setattr("eoi_jax.simulation.error_growth.RULES", rules)
    head = start_samples(record, 2)
    k = np.arange(head)
    spread = np.sum((k - k.mean()) ** 2)
    expected = np.sqrt(1.0 / head + (len(record) - 1 - k.mean()) ** 2 / spread)
    growth = error_growth(second_order(a=0.0, b=0.0), [record])
    assert growth.largest == pytest.approx(expected, rel=1e-6)
    assert growth.growing


@pytest.mark.parametrize("plant", [first_order(-2.0), second_order(a=-25.0), first_order(0.0)])
def test_errors_of_a_stable_plant_and_of_an_integrator_of_first_order_do_not_grow(plant):
    growth = error_growth(plant, [noise_record()])
    assert not growth.growing
    assert growth.largest < 1.0


def test_windows_are_no_longer_than_four_time_constants():
    growth = error_growth(first_order(2.0), [noise_record(2000)])
    assert growth.window <= RULES.exponent / 2.0 + 1e-12


def test_an_unstable_plant_is_judged_in_windows_and_the_note_says_how_many():
    record = balanced()
    run = eoi.validate(second_order(), record)
    assert run.window is not None
    assert run.rmse[0] < 2.0 * NOISE
    starts = -(-(len(record) - 1) // round(run.window / PERIOD))
    (note,) = [note for note in run.notes if note.startswith("Judged in")]
    assert f"{starts} windows" in note
    assert "the plant is unstable" in note
    assert f"in windows of {run.window:g} s" in str(run)


def test_a_record_that_is_shorter_than_the_start_of_a_window_is_judged_too():
    """Half of a window is its start: of a record shorter than that nothing would be left."""
    alone = eoi.validate(second_order(), balanced())
    assert alone.window is not None
    count = round(0.4 * alone.window / PERIOD)
    run = eoi.validate(second_order(), [balanced(), balanced(count, seed=2)])
    assert run.window == pytest.approx(alone.window, rel=0.3)
    assert [int(scored.sum()) > 0 for scored in run.scored_at] == [True, True]
    assert run.scored_at[1].sum() == count - round(0.5 * count)
    assert run.nrmse[0] < 0.1


def test_a_whole_run_can_be_asked_for():
    run = eoi.validate(second_order(), balanced(), window=np.inf)
    assert run.window is None
    assert not run.rmse[0] < 1.0


def test_a_stable_plant_with_wrong_parameters_is_judged_over_whole_records():
    run = eoi.validate(first_order(-1.0), noise_record())
    assert run.window is None
    assert run.nrmse[0] > 0.9


def test_models_are_compared_in_the_same_windows():
    unstable, stable = validated_alike((second_order(), second_order(a=-25.0)), balanced())
    assert unstable.window == stable.window is not None
    assert unstable.rmse[0] < 0.1 * stable.rmse[0]


@pytest.mark.parametrize(
    ("rate", "degree", "duration", "known"),
    [
        (lambda t, x, u, p: -p.a * x.y[0] + u, 1, 4.5, True),
        (lambda t, x, u, p: -p.a * x.y[0] + u, 1, 3.5, False),
        (lambda t, x, u, p: u - 40.0 * p.a * x.y[0] - 0.1 * x.y[1], 2, 4.0, True),
        (lambda t, x, u, p: u - p.a * x.y[1], 2, 400.0, False),
    ],
)
def test_a_plant_returns_that_a_constant_force_displaces_by_so_much(rate, degree, duration, known):
    plant = eoi.Plant(rate, {"a": 1.0}, degree)
    time = np.linspace(0.0, duration, 101)
    record = eoi.Record(time, np.zeros(101), np.sin(time), hold="zero")
    assert returns(plant, [record]) == known
