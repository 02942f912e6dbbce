"""What a page says of the error beside the noise, where the samples are far apart."""

import re

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.report.contents import identification_contents


@pytest.mark.parametrize("noise", [1e-4, 2.0])
def test_an_error_is_told_beside_the_noise_that_the_run_bounds(noise):
    """The output follows the input within a sample, so that it differs from sample to sample."""
    plant = eoi.Plant(lambda t, x, u, p: (u - x.y[0]) / p.T, {"T": 1800.0})
    time, rng = 3600.0 * np.arange(300), np.random.default_rng(0)
    drive = rng.uniform(-1.0, 1.0, 50).repeat(6)
    clean = eoi.simulate(plant, time, drive, hold="zero")
    record = clean.with_outputs(
        clean.outputs + rng.normal(0.0, noise, clean.outputs.shape), "noisy"
    )
    result = eoi.identify(plant, record, instruments=False)
    validation = eoi.validate(plant, record)
    extra = {"validation": validation, "diagnosis": eoi.diagnose(result)}
    contents = identification_contents(result, extra)
    said = re.search(r"error ([0-9.]+) × sensor noise", contents.badge)
    assert said is not None
    assert 0.9 < float(said[1]) < 2.0
    (check,) = (item for item in contents.checks if item.name == "Noise")
    assert noise > 1.0 or "Noise of the outputs, at most: y " in check.finding
