"""What a term does to a free run, to first order: where and when it is looked at."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.models.augmented import place
from eoi_jax.models.effects import ConstantOffset, SecondMass
from eoi_jax.refinement.problem import problem_of
from eoi_jax.refinement.score_test import LinearisedRuns, Try, _stages
from eoi_jax.refinement.spans import spans_of


@pytest.mark.parametrize("outputs", [1, 2])
def test_frequencies_at_which_the_residual_stands_out(outputs):
    period, omega = 0.02, 2.0 * np.pi * 7 / 20.0  # seven periods in 20 s
    time = period * np.arange(1000)
    residual = np.sin(omega * time)[:, None] * np.ones(outputs)
    names = ("y", "w")[:outputs]
    one: Any = SimpleNamespace(residual=residual.ravel(), plant=SimpleNamespace(outputs=names))
    assert LinearisedRuns._peaks(one, period)[0] == pytest.approx(omega)


@pytest.mark.parametrize("substeps", [1, 2, 3])
def test_stages_are_start_middle_and_end_of_each_sample(substeps):
    """An input and a state that are the time itself."""
    plant = eoi.Plant(lambda t, x, u, p: p.b * u - x.y[0], {"b": 1.0}, 1)
    sampled = 2.0 + 0.3 * np.arange(101)
    record = eoi.Record(sampled, sampled, sampled, hold="linear")
    problem = problem_of(plant, [record], spans_of([record], None), substeps)
    time = np.linspace(sampled[0], sampled[-1], 100 * substeps + 1)
    inputs = np.stack([time[:-1], 0.5 * (time[:-1] + time[1:]), time[1:]], axis=1)
    expected = sampled[:-1, None] + 0.3 * np.array([0.0, 0.5, 1.0])
    for one in _stages(problem, inputs[None, ..., None], time[None, :, None]):
        np.testing.assert_allclose(np.reshape(one, (100, 3)), expected)


def test_two_forms_of_an_effect_at_one_channel_are_no_pair():
    """A model contains at most one effect of each kind and channel: both have the same names."""
    shaken = eoi.Plant(lambda t, x, u, p: p.g * u[0], {"g": 1.0}, 2, ("u",), ("y",))
    forms = (SecondMass(), SecondMass(in_bearing=True), ConstantOffset())
    draw = np.random.default_rng(1)
    tries = [Try(place(shaken, form, 0), np.zeros(0), draw.normal(size=(50, 1))) for form in forms]
    runs: Any = SimpleNamespace(residual=draw.normal(size=50), _power=50.0)
    shares = LinearisedRuns.pair_shares(runs, tries)
    assert shares[0, 1] == 0.0
    assert np.all(shares[:2, 2] > 0.0)
