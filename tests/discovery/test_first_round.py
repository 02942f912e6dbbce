"""What the first round of a search in free runs tries again, from nominal values."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery import free_run_candidates, free_run_search, free_run_trials
from eoi_jax.discovery import judge as judge_module
from eoi_jax.discovery.free_run_trials import Search
from eoi_jax.discovery.judge import Judge, Judged, jointly_preferred
from eoi_jax.models.augmented import augmented, place
from eoi_jax.refinement.estimate import unanswered
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
        (True, None, True),
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


def test_an_order_higher_is_tried_where_the_score_test_says_little_of_it():
    time = np.arange(300) * 0.1
    u = np.repeat(np.random.default_rng(1).uniform(-1.0, 1.0, 20), 15)
    late = np.interp(time - 0.2, time, u)
    y = lfilter([0.0, 0.1], [1.0, -0.95], late)
    late_record = eoi.Record(time, u, y, hold="zero")
    judge = Judge.of((record(2),), PLANT)
    assert judge is not None
    search = Search.begun([PLANT], (late_record,), judge)
    assert search is not None
    laws = [effects.ActuatorLag(), effects.InputDelay(), effects.Leak()]
    models = free_run_candidates.candidates(search.base, laws, 1e-300)
    names = {item.effect.name for _, placed in models for item in placed}
    assert names == {"actuator_lag", "input_delay"}
    found = replace(search.base, placed=(place(PLANT, effects.Leak(), 0),))
    assert free_run_candidates.candidates(found, laws, 1e-300) == []


def test_dry_friction_of_what_moves_is_tried_where_the_base_never_stops():
    mass = eoi.Plant(lambda t, x, u, p: p.b * u - p.c * x.y[1], {"b": 1.0, "c": 0.5}, 2)
    laws = [effects.CoulombFriction(), effects.AsymmetricFriction(), effects.Leak()]

    def way(seed):
        """v' = u - 0.5 v - 0.3 sign v in a hundred steps a sample."""
        u, speed, places = record(seed).inputs[:, 0], 0.0, [0.0]
        for k in range(199):
            ends = places[-1]
            for _ in range(100):
                speed += 1e-3 * (u[k] - 0.5 * speed - 0.3 * np.tanh(100.0 * speed))
                ends += 1e-3 * speed
            places.append(ends)
        return eoi.Record(TIME, u, np.array(places), hold="zero")

    for plant, made, names in ((mass, way, {"coulomb_friction"}), (PLANT, record, set())):
        judge = Judge.of((made(2),), plant)
        assert judge is not None
        search = Search.begun([plant], (made(1),), judge)
        assert search is not None
        models = free_run_candidates.candidates(search.base, laws, 1e-300)
        assert {item.effect.name for _, placed in models for item in placed} == names


def test_further_kinds_of_effects_have_a_place_behind_the_first_ones():
    kinds = [effects.ConstantOffset(), effects.Leak(), effects.QuadraticDrag()]
    kinds += [effects.ActuatorLag(), effects.InputDelay(), effects.InputRate()]
    models = [(PLANT, (place(PLANT, effect, 0),)) for effect in kinds]
    chosen = free_run_candidates._of_each_kind(models, 2)
    assert [placed[0].effect for _, placed in chosen] == [*kinds[:2], *kinds[3:5]]


def test_products_take_no_place_of_a_loss():
    products = [effects.Product("u", "y"), effects.Product("y", "y")]
    kinds = [*products, effects.Overflow(), effects.Leak(), effects.QuadraticDrag()]
    models = [(PLANT, (place(PLANT, effect, 0),)) for effect in kinds]
    chosen = free_run_candidates._of_each_kind(models, 2)
    assert [placed[0].effect for _, placed in chosen] == kinds[:4]


@pytest.mark.parametrize(("samples", "steps"), [(1000, 100), (4000, 50), (40_000, 20)])
def test_short_records_are_fitted_to_the_end_of_a_valley(monkeypatch, samples, steps):
    asked = []

    def refined(plant, records, window, max_steps):
        asked.append(max_steps)
        return unanswered(plant, records, window, eoi.Status("diverged", "as told"))

    monkeypatch.setattr(free_run_trials, "refine_once", refined)
    part = eoi.Record(0.1 * np.arange(samples), np.ones(samples), np.ones(samples), hold="zero")
    judge = Judge((part,), 10.0, 5, 5)
    assert free_run_trials._fitted(PLANT, (), (part,), None, judge) is None
    assert asked == [steps]


def biased(offset, seed):
    """As `record`, with another offset than 0.2."""
    made = record(seed)
    return made.with_outputs(made.outputs + (offset - 0.2) / 0.5, "biased")


def judged(plant, judge):
    """A model that is fitted as it stands."""
    fit = refine_once(plant, judge.records, None, max_steps=1)
    return judge.judged(replace(fit, plant=plant), ())


@pytest.mark.parametrize(("level", "stays"), [(0.2, False), (0.4, True)])
def test_what_only_held_out_records_show_does_not_stay(level, stays):
    """The held-out record has an offset of 0.4; those of the fit have it, or are without it."""
    offset = place(PLANT, effects.ConstantOffset(), 0)
    judge = Judge.of((biased(0.4, 2),), PLANT)
    assert judge is not None
    judge = replace(judge, of_fit=Judge.of((biased(level, 1),), PLANT))
    low, high = (
        judged(augmented(PLANT, (offset,), {offset.names[0]: value}), judge) for value in (0.2, 0.4)
    )
    search = Search((biased(level, 1),), (biased(level, 1),), judge, (low,))
    assert judge.prefers(high.runs, low.runs)
    assert search.is_shown_by_fit(high, low) is stays
    assert search.accepts(high, low, []) is stays
    high = replace(high, placed=(offset,))
    contest = free_run_search._round(search, [high], (low, []), [])
    assert (contest is not None) is stays


def test_a_plainer_model_that_the_records_of_the_fit_deny_does_not_come_instead(monkeypatch):
    judge = Judge.of((record(2),), PLANT)
    assert judge is not None
    search = Search.begun([PLANT], (record(1),), judge)
    assert search is not None
    base = search.base
    laws = effects.QuadraticDrag(), effects.ConstantOffset(), effects.Leak()
    drag, offset, leak = (place(PLANT, law, 0) for law in laws)
    wide, plain = replace(base, placed=(drag, offset)), replace(base, placed=(leak,))
    monkeypatch.setattr(Search, "accepts", lambda _, trial, *__: trial is wide)
    monkeypatch.setattr(Search, "narrowed", lambda _, chosen, *__, **___: chosen)
    for denied, chosen in ((plain, wide), (None, plain)):
        monkeypatch.setattr(
            Search, "is_shown_by_fit", lambda _, trial, __, denied=denied: trial is not denied
        )
        contest = free_run_search._round(search, [wide, plain], (base, ()), [])
        assert contest is not None
        assert contest.chosen is chosen


def with_steps_of(errors, runs):
    """Free runs whose errors are others, block by block."""
    made, (measured,) = runs[0], runs[0].records
    predicted = measured.with_outputs(measured.outputs - errors[:, None], "made")
    rmse = np.sqrt(np.mean(errors[made.scored_at[0]] ** 2, keepdims=True))
    whole = replace(
        made, predictions=(predicted,), rmse=rmse, nrmse=rmse / np.std(measured.outputs)
    )
    return whole, None


def test_records_of_both_kinds_show_together_what_neither_shows_alone():
    judge = Judge.of((record(2),), PLANT)
    assert judge is not None
    made = judge.runs(PLANT)
    old = np.ones(200)
    uneven = np.where(np.arange(200) // 20 % 3 == 0, 0.1, 1.05)
    worse = np.where(np.arange(200) // 20 % 3 == 0, 1.6, 0.95)
    rival = with_steps_of(old, made)
    trial, other = with_steps_of(uneven, made), with_steps_of(worse, made)
    deviation = judge_module.deviations_of(trial, rival)[0]
    assert 2.5 / np.sqrt(2.0) < deviation < 2.5
    assert jointly_preferred([(trial, rival), (trial, rival)])
    assert not jointly_preferred([(trial, rival)])
    assert not jointly_preferred([(trial, rival), (rival, rival)])  # no lower error
    assert not jointly_preferred([(trial, rival), (other, rival)])  # a larger one
