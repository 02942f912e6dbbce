"""A slice of the stiff plants: the simulator of the benchmark, and free runs of the truth."""

import numpy as np
import pytest

import eoi_jax as eoi
from benchmarks.truth import stiff_plants


def test_exact_solution_is_that_of_the_integrator():
    plant = stiff_plants.drawn(0)
    inputs = np.repeat([1.0, -0.5, 0.3], 12)
    exact, integrated = stiff_plants._exact(plant, inputs), stiff_plants._integrated(plant, inputs)
    np.testing.assert_allclose(exact, integrated, atol=1e-7)


@pytest.mark.parametrize("number", [3, 4])  # modes of 1/60 and 1/40 of a sample
def test_free_runs_of_true_parameters_reach_the_noise(number: int):
    plant = stiff_plants.drawn(number)
    assert plant.fastest < 0.03
    data, noise = stiff_plants.record(plant, 300, np.random.default_rng(1))
    answer = eoi.validate(stiff_plants.declared(plant), data)
    level = np.sqrt(np.mean(noise[stiff_plants.HEAD :] ** 2, axis=0))
    assert np.all(answer.rmse <= stiff_plants.ASKED * level)
