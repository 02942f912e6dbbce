"""Records are made again as fits, once a law is found that the declared model lacks."""

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.data.holds import with_hold
from eoi_jax.discovery.free_run_search import search_free_runs
from eoi_jax.discovery.free_run_trials import Search

PERIOD, NOISE = 0.1, 0.002


def _reactor(t, x, u, p):
    return u[0] * (u[1] - x.y[0]) - p.k * x.y[0]


REACTOR = eoi.Plant(
    _reactor, {"k": 0.3}, 1, inputs=("flow", "feed"), outputs=("c",), units={"c": "mol/l"}
)


def record(seed, samples=400):
    """dc/dt = q (c_f - c) - 0.1 c - 0.2 c²; flow and feed are held from a sample to the next."""
    random = np.random.default_rng(seed)
    flow = np.repeat(random.uniform(0.3, 1.0, samples // 20), 20)
    feed = np.repeat(random.uniform(1.0, 3.0, samples // 25), 25)
    c = np.zeros(samples)
    c[0] = 1.0
    for k in range(samples - 1):
        # 0.2 (c - a) (c - b) = -dc/dt between two samples.
        half = (flow[k] + 0.1) / 0.4
        root = np.sqrt(half**2 + flow[k] * feed[k] / 0.2)
        ratio = (c[k] - root + half) / (c[k] + root + half) * np.exp(-0.4 * root * PERIOD)
        c[k + 1] = (root - half + ratio * (root + half)) / (1.0 - ratio)
    inputs = np.stack([flow, feed], axis=1)
    time = PERIOD * np.arange(samples)
    return eoi.Record(
        time, inputs, c + NOISE * random.standard_normal(samples),
        input_names=REACTOR.inputs, output_names=REACTOR.outputs,
    )  # fmt: skip


@pytest.mark.slow
def test_hold_that_the_declared_model_does_not_show_is_chosen_again_with_its_law(monkeypatch):
    fit, judging = (record(1),), (record(2),)
    variants = [(with_hold(fit, hold), with_hold(judging, hold)) for hold in ("linear", "zero")]
    tried: list[set[str]] = []
    fitted = Search.fitted

    def counted(self, plant, placed, best):
        tried.append({item.effect.name for item in (*best.placed, *placed)})
        return fitted(self, plant, placed, best)

    monkeypatch.setattr(Search, "fitted", counted)
    laws = [effects.PowerLoss(), effects.InputDelay(), effects.ActuatorLag()]
    answer = search_free_runs([REACTOR], variants, laws)
    assert answer is not None
    assert [item.effect.name for item in answer.best.placed] == ["power_loss"]
    assert answer.records[0].hold == "zero"
    late = {"input_delay", "actuator_lag"}
    assert not any("power_loss" in names and names & late for names in tried)
