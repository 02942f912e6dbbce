"""A mode faster than the sampling: what the injection says is tried in free runs, which judge."""

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery.discover import _Search
from eoi_jax.models.augmented import augmented, place

PERIOD, SUBSTEPS = 1e-3, 20
TRUTH = {"R": 0.8, "L": 3.2e-4, "K": 0.05, "J": 8e-5, "b": 2e-4}  # L/R is 0.4 of a period
CURRENT, TORQUE = "(voltage - R*current - K*speed)/L", "(K*current - b*speed)/J"
MOTOR = eoi.plant_from_text(
    {"current": CURRENT, "angle": "speed", "speed": TORQUE},
    {"R": 0.8, "L": 3e-4, "K": 0.05, "J": 1e-4, "b": 1e-4},
    outputs=["current", "angle"],
    inputs=["voltage"],
    bounds=dict.fromkeys(TRUTH, (1e-9, 1e3)),
)
COGGING = place(MOTOR, effects.PositionRipple(), 1)
HIDDEN = dict(zip(COGGING.names, (-75.0, 0.0, 24.0), strict=True))


def record(seed):
    draw = np.random.default_rng(seed)
    voltage = np.repeat(draw.uniform(-1.2, 1.2, 25), 80)
    time = PERIOD * np.arange(len(voltage))
    true = augmented(MOTOR.with_parameters(TRUTH), (COGGING,), HIDDEN)
    clean = eoi.simulate(true, time, voltage, hold="zero", substeps=SUBSTEPS).outputs
    noise = np.array([0.02, 4e-4]) * draw.standard_normal(clean.shape)
    return eoi.Record(time, voltage, clean + noise, f"run {seed}", input_names=["voltage"],
                      output_names=["current", "angle"], hold="zero")  # fmt: skip


@pytest.mark.slow
@pytest.mark.long
def test_what_the_injection_says_of_cogging_is_tried_in_free_runs():
    """Along runs that go astray by a tooth, a score test says nothing of what turns with it."""
    search = _Search(
        MOTOR, None, (effects.PositionRipple(),), (), 0.01, 3, None, False, True, lambda *_: None
    )
    searched = search.on((record(3),), (record(4),))
    assert searched.discovery.declared.status.code == "undersampled"
    assert searched.discovery.status.code == "unexplained"
    assert not searched.discovery.added
    (model, placed), *_ = searched.partial
    assert placed == (COGGING,)
    assert model.parameters[COGGING.names[-1]] == pytest.approx(24.0, abs=0.5)
