"""What the first round of a search in free runs tries again, from nominal values."""

from dataclasses import replace

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery import free_run_search
from eoi_jax.discovery.free_run_trials import Search
from eoi_jax.discovery.judge import Judge, Judged
from eoi_jax.models.augmented import augmented, place
from eoi_jax.refinement.refine import refine_once

PLANT = eoi.Plant(lambda t, x, u, p: p.b * u - p.a * x.y[0], {"b": 1.0, "a": 0.5}, 1)
TIME = 0.1 * np.arange(200)


def record(seed):
    """y' = u - 0.5 y + 0.2, exactly, with noise."""
    random = np.random.default_rng(seed)
    u, y = np.repeat(random.uniform(-1.0, 1.0, 20), 10), np.zeros(200)
    for k in range(199):
        final = (u[k] + 0.2) / 0.5
        y[k + 1] = final + (y[k] - final) * np.exp(-0.05)
    return eoi.Record(TIME, u, y + 0.01 * random.standard_normal(200), hold="zero")


@pytest.mark.parametrize(
    ("agree", "code", "restarted"),
    [
        (True, "converged", False),
        (True, "stalled", True),
        (True, None, False),
        (False, "converged", True),
    ],
)
def test_nominal_values_are_a_second_start_where_the_end_may_be_another(
    monkeypatch, agree, code, restarted
):
    judge = Judge.of((record(2),), PLANT)
    assert judge is not None
    search = Search.begun([PLANT, PLANT], (record(1),), judge)
    assert search is not None
    assert search.ends_alike
    search = replace(search, ends_alike=agree, bases=search.bases[:1])
    offset = place(PLANT, effects.ConstantOffset(), 0)
    fit = refine_once(augmented(PLANT, (offset,), {offset.names[0]: 0.0}), (record(1),), None)
    starts = []

    def fitted(_, plant, placed, __):
        starts.append(plant.parameters["b"])
        if code is None:
            return None
        ended = replace(fit, status=replace(fit.status, code=code))
        return Judged(ended, placed, judge.runs(fit.plant))

    monkeypatch.setattr(Search, "fitted", fitted)
    monkeypatch.setattr(free_run_search, "replacements", lambda *_: [])
    plant = augmented(search.base.refinement.plant, (offset,), {offset.names[0]: 0.0})
    monkeypatch.setattr(free_run_search, "candidates", lambda *_, **__: [(plant, (offset,))])
    free_run_search._first_trials(search, [PLANT, PLANT], [offset.effect], 0.01, (), ())
    assert (1.0 in starts) is restarted
    assert len(starts) == 1 + restarted
