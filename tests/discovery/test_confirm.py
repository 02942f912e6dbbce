"""What free runs say where the injection is silent."""

import importlib
import re
from dataclasses import replace

import numpy as np
import pytest
from output_cases import mixed, shaken

from eoi_jax import Plant, Record, discover, validate
from eoi_jax._status import Status
from eoi_jax.discovery import in_injection
from eoi_jax.discovery.confirm import beyond_noise
from eoi_jax.simulation.sensor_noise import sensor_noise
from tests import problems

H, NOISE = 5e-3, 2e-4


def spring(t, x, u, p):
    del t
    return p.b * u - p.k * x.y[0] - p.c * x.y[1]


def plant(k: float) -> Plant:
    return Plant(spring, {"k": k, "c": 4.0, "b": 1.0}, 2, outputs=("place",))


def run(seed: int) -> Record:
    """A mass on a spring of 200."""
    draw = np.random.default_rng(seed)
    t = H * np.arange(2000)
    lines = 2.0 * np.pi * np.array([0.3, 0.7, 1.1, 1.7, 2.3, 3.1])
    u = 8.0 * np.sum(np.sin(np.outer(t, lines) + draw.uniform(0.0, 6.28, 6)), axis=1)
    a, b = np.array([[0.0, 1.0], [-200.0, -4.0]]), np.array([[0.0], [1.0]])
    y = problems.held_response(a, b, u[:, None], H)[:, :1]
    y = y + NOISE * draw.standard_normal(y.shape)
    return Record(t, u, y, output_names="place", hold="zero")


@pytest.fixture(scope="module")
def records():
    return run(0), run(1)


def test_free_runs_beyond_the_noise_are_told(records):
    assert beyond_noise(validate(plant(200.0), records[0], window=1.0)) == []
    (told,) = beyond_noise(validate(plant(220.0), records[0], window=1.0))
    assert told.startswith("free runs of place in windows miss by ")
    assert beyond_noise(None) == []


def late_acceleration(seed: int) -> Record:
    """A position, and an acceleration that comes late."""
    made = shaken(seed, 0.02, ("x", "acc"))
    late = np.stack([made.outputs[:, 0], np.roll(made.outputs[:, 1], 8)], axis=1)[50:]
    late[:, 0] += 2e-3 * np.random.default_rng(seed + 1).standard_normal(len(late))
    return Record(made.time[50:], made.inputs[50:], late, hold="linear",
                  input_names=("base",), output_names=("x", "acc"))  # fmt: skip


@pytest.mark.parametrize("seed", [2, 3, 4, 5])
def test_windows_follow_the_sensor_with_which_runs_are_likelier(seed):
    """Of two that contradict each other the first samples could be fitted to either."""
    record = late_acceleration(seed)
    for length in (np.inf, 2.0):
        runs = validate(mixed(), record, window=length)
        assert runs.rmse[0] < 1.2 * sensor_noise(runs)[0]


def test_a_sensor_that_is_wrong_is_told_and_not_those_whose_windows_it_spoils():
    """The acceleration comes late; position and velocity at the start of a window follow it."""
    record = late_acceleration(1)
    whole, windows = (validate(mixed(), record, window=length) for length in (np.inf, 2.0))
    assert [text[:15] for text in beyond_noise(whole)] == ["free runs of ac"]
    assert len(beyond_noise(windows)) == 2
    (told,) = beyond_noise(windows, full_runs=whole)
    assert re.match(
        r"free runs of acc in windows miss by \S+ times the noise of its sensor \(and x by \S+ "
        r"times in windows alone, which start from what all outputs show\), though",
        told,
    )
    assert beyond_noise(windows, full_runs=replace(whole, rmse=0.0 * whole.rmse)) == beyond_noise(
        windows
    )
    times = windows.rmse / sensor_noise(windows)
    order = [windows.outputs[j] for j in np.argsort(-times)]
    assert [text.split()[3] for text in beyond_noise(windows)] == order


@pytest.mark.parametrize("seed", range(3))
def test_of_slow_samples_an_error_within_their_differences_is_more_than_noise(seed):
    """Samples 0.3 time constants apart differ by three times their noise.

    So an error of a fifth more gain is less than three times what the samples show, though it is
    many times their noise; the true model's is not told.
    """
    draw, (period, noise) = np.random.default_rng(seed), (0.3, 0.02)
    u = np.repeat(draw.standard_normal(1000), 3)[:2000, None]
    y = problems.held_response(np.array([[-1.0]]), np.array([[1.0]]), u, period)[:, :1]
    record = Record.from_period(
        period, u, y + noise * draw.standard_normal(y.shape), output_names="level", hold="zero"
    )
    lag = Plant(lambda t, x, u, p: p.b * u - x.y[0], {"b": 1.0}, 1, outputs=("level",))
    assert beyond_noise(validate(lag, record, window=60.0)) == []
    runs = validate(lag.with_parameters({"b": 1.2}), record, window=60.0)
    assert 3.0 * noise < runs.rmse[0] < 3.0 * record.noise[0]
    assert len(beyond_noise(runs)) == 1


@pytest.fixture
def silenced(monkeypatch):
    """An injection that is silent, of parameters that stay where they are."""
    module = importlib.import_module("eoi_jax.discovery.discover")
    monkeypatch.setattr(
        in_injection, "judged", lambda *_, **__: Status("nothing_missing", "silence")
    )
    monkeypatch.setattr(module, "estimate", _as_declared(module.estimate))
    monkeypatch.setattr(module, "refined_answer", lambda _, found, __: found)
    monkeypatch.setattr(module, "without_bias", lambda _, found: found)


@pytest.mark.parametrize("refine", [False, True])
def test_an_answer_of_nothing_is_doubted_where_free_runs_say_otherwise(
    records, silenced, monkeypatch, refine
):
    module = importlib.import_module("eoi_jax.discovery.discover")
    monkeypatch.setattr(module, "divided", lambda *_: None)  # as of a record too short to judge
    found = discover(plant(220.0), records[0], effects="cubic_stiffness", refine=refine)
    (doubt,) = [note for note in found.notes if "times the noise of its sensor" in note]
    assert ("`refine=True`" in doubt) is not refine


def test_held_out_free_runs_that_miss_are_searched_and_may_blame_the_estimate(records, silenced):
    found = discover(plant(220.0), *records, effects="cubic_stiffness")
    assert (found.status.code, found.effects) == ("nothing_missing", ())
    assert found.plant.parameters["k"] == pytest.approx(200.0, rel=1e-3)
    assert beyond_noise(found.windows_after) == []
    assert any("was refined by the error of its free runs" in note for note in found.notes)
    assert not any("noise of its sensor" in note for note in found.notes)


def test_an_answer_of_nothing_stands_where_free_runs_agree(records):
    found = discover(plant(180.0), *records, effects="cubic_stiffness")
    assert found.status.code == "nothing_missing"
    assert not any("noise of its sensor" in note for note in found.notes)


def _as_declared(estimate):
    """The estimator, but that it leaves the parameters where they are."""

    def fake(model, prepared, passes):
        found = estimate(model, prepared, passes=passes)
        return replace(found, plant=model, parameters=model.parameters)

    return fake
