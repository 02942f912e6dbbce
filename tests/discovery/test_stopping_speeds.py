"""A speed that never reverses, but stops: dry friction holds it."""

from dataclasses import replace

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery.free_run_search import search_free_runs
from eoi_jax.discovery.free_run_trials import Search
from eoi_jax.discovery.judge import Judge, Judged
from eoi_jax.discovery.probability import from_contests
from eoi_jax.models.augmented import augmented, place
from eoi_jax.refinement.refine import refine_once
from eoi_jax.refinement.score_test import LinearisedRuns

PERIOD, COUNT = 0.1, 600
GAIN, LOSS, LEVEL = 0.9, 1.1, 1.5


def driven(t, x, u, p):
    return p.k * u - p.d * x.y[0]


def belt(unit):
    return eoi.Plant(driven, {"k": 1.0, "d": 1.0}, 1, units={"y": unit})


def measured(seed, lowest=0.0, unit="m/s", level=LEVEL, growth=0.0):
    """A belt with dry friction: between changes of its input each run has a closed form.

    Args:
        seed: of input and noise.
        lowest: of the inputs; LEVEL/GAIN moves it.
        unit: of the speed.
        level: of the friction.
        growth: q of an actuator with the force u + q u².
    """
    random = np.random.default_rng(seed)
    u = np.repeat(random.uniform(lowest, 7.0, COUNT // 30), 30)
    final = (GAIN * (u + growth * u**2) - level) / LOSS
    speed, decay = np.zeros(COUNT), np.exp(-LOSS * PERIOD)
    for k in range(COUNT - 1):
        speed[k + 1] = max(final[k] + (speed[k] - final[k]) * decay, 0.0)
    noise = 0.02 * random.standard_normal(COUNT)
    return eoi.Record(PERIOD * np.arange(COUNT), u, speed + noise, hold="zero",
                      units={"y": unit})  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("tried", [effects.PowerLoss(), effects.StribeckFriction()])
def test_a_law_that_imitates_dry_friction_of_a_speed_that_stops_gives_way_to_it(tried):
    records = (measured(1),), (measured(2),)
    answer = search_free_runs([belt("m/s")], [records], [tried, effects.CoulombFriction()])
    assert answer is not None
    (friction,) = answer.best.placed
    assert friction.effect == effects.CoulombFriction()
    parameters = answer.best.refinement.parameters
    assert parameters["coulomb_friction"] == pytest.approx(LEVEL, rel=0.01)
    assert parameters["d"] == pytest.approx(LOSS, rel=0.01)
    assert friction in from_contests(belt("m/s"), answer.best, answer.best.placed, answer.rounds)


def test_a_wider_law_stays_where_the_simpler_one_is_worse():
    fitted, judging = (measured(seed, level=0.0, growth=0.1) for seed in (1, 2))
    plant = belt("m/s")
    judge = Judge.of((judging,), plant)
    assert judge is not None
    search = Search.begun([plant], (fitted,), judge)
    assert search is not None
    model = search.with_only([place(plant, effects.InputQuadratic(), 0)], search.base)
    assert model is not None
    assert search.narrowed(model, effects.standard()) is model


def test_a_law_goes_in_a_round_only_where_it_has_ended_on_a_bound():
    fitted, judging = measured(1), measured(2)
    plant = belt("m/s")
    judge = Judge.of((judging,), plant)
    assert judge is not None
    search = Search.begun([plant], (fitted,), judge)
    assert search is not None
    friction = place(plant, effects.StribeckFriction(), 0)
    start = dict(zip(friction.names, (LEVEL, 0.0, 0.3), strict=True))
    fit = refine_once(augmented(plant, [friction], start), (fitted,), None)
    model = Judged(fit, (friction,), judge.runs(fit.plant))
    for rise, goes in ((0.0, True), (0.01, False)):
        parameters = fit.parameters | {"stribeck_friction_rise": rise}
        wide = replace(model, refinement=replace(fit, parameters=parameters))
        plain = search.narrowed(wide, [effects.CoulombFriction()], ended=True)
        assert (plain is not wide) is goes


@pytest.mark.parametrize(
    ("lowest", "unit", "tried"), [(0.0, "m/s", True), (3.0, "m/s", False), (0.0, "m", False)]
)
def test_dry_friction_is_tried_of_a_speed_that_stops(lowest, unit, tried):
    """Not where it keeps moving, where friction is a constant, nor of a level that is empty."""
    plant, record = belt(unit), measured(1, lowest, unit)
    fit = eoi.refine(plant, record)
    runs = LinearisedRuns.from_refinement(fit)
    for effect in (effects.CoulombFriction(), effects.LoadFriction()):
        assert bool(runs.tries(place(plant, effect, 0))) is tried
    slope = effects.AsymmetricViscousFriction()
    assert not slope.shows(runs.signal_statistics(place(plant, slope, 0)))
