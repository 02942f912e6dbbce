"""How probable an added effect is against its rivals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t as student

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery import free_run_trials, judge
from eoi_jax.discovery.free_run_trials import Search
from eoi_jax.discovery.judge import Judge, Judged, noise_level, odds, probability_better
from eoi_jax.discovery.probability import Contest, Standing, from_contests, from_sets
from eoi_jax.discovery.result import Rival
from eoi_jax.discovery.rivals import experiments
from eoi_jax.models.augmented import place
from eoi_jax.models.effects.products import InputProduct
from eoi_jax.models.effects.signals import Signal
from eoi_jax.refinement.refine import refine_once
from eoi_jax.simulation.validation import Validation

COUNT = 200


def mass(t, x, u, p):
    return p.b * u - p.k * x.y[0] - p.c * x.y[1]


MASS = eoi.Plant(
    mass, {"b": 1.0, "k": 4.0, "c": 0.5}, 2, inputs=("force",), outputs=("position",)
)  # fmt: skip
FRICTION, STRIBECK, OFFSET, CUBIC, ASYMMETRIC = (
    place(MASS, effect, 0)
    for effect in (
        effects.CoulombFriction(), effects.StribeckFriction(), effects.ConstantOffset(),
        effects.CubicStiffness(), effects.AsymmetricFriction(),
    )
)  # fmt: skip


def record(outputs):
    time = 0.01 * np.arange(len(outputs))
    return eoi.Record(time, np.zeros(len(time)), outputs, "held out", hold="zero",
                      input_names="force", output_names="position")  # fmt: skip


def run_with(errors):
    """A free run with these errors about a measured sine; a diverged one is clipped."""
    measured = np.sin(0.1 * np.arange(len(errors)))
    data = record(measured)
    prediction = record(measured + np.minimum(errors, 1e3))
    rmse = np.array([np.sqrt(np.mean(np.square(errors)))])
    return Validation(
        rmse, rmse, rmse, (prediction,), len(errors), ("position",), ("",), (), (data,),
        scored_at=(np.ones(len(errors), dtype=bool),),
    )  # fmt: skip


def runs_with(levels):
    """Free runs, whole and in windows, whose errors have these sizes in ten blocks."""
    errors = np.repeat(levels, COUNT // len(levels))
    return run_with(errors), run_with(errors)


REFINEMENT = refine_once(
    MASS, (record(np.random.default_rng(3).normal(size=COUNT)),), None
)  # of no interest here


def model(placed, runs):
    return Judged(REFINEMENT, placed, runs)


def test_the_probability_is_student_s_of_the_mean_error_over_blocks():
    random = np.random.default_rng(0)
    first, second = np.exp(random.normal(0.0, 0.3, (2, 10)))
    squares = first**2, second**2
    fall = 0.5 * np.log(np.mean(squares[1]) / np.mean(squares[0]))
    ours, theirs = (square / np.mean(square) for square in squares)
    error = np.std(0.5 * (theirs - ours), ddof=1) / np.sqrt(10)
    runs = runs_with(first), runs_with(second)
    assert probability_better(runs[0], runs[1]) == pytest.approx(student.cdf(fall / error, 9))
    assert probability_better(runs[1], runs[0]) == pytest.approx(student.sf(fall / error, 9))
    assert (probability_better(runs[0], runs[1]) > 0.5) == (runs[0][0].rmse[0] < runs[1][0].rmse[0])
    shifted = student.cdf((fall - 0.2) / error, 9)
    assert probability_better(runs[0], runs[1], 0.2) == pytest.approx(shifted)


def test_samples_that_start_a_run_do_not_count():
    """A start that was fitted is no prediction, and a rare measurement has no part in the rest."""
    first, second = (runs_with(np.full(10, level)) for level in (0.1, 0.11))
    at_start = np.zeros(COUNT)
    at_start[: COUNT // 5] = 5.0
    worse = run_with(np.repeat(np.full(10, 0.1), COUNT // 10) + at_start)
    unscored = replace(worse, rmse=first[0].rmse, scored_at=(at_start == 0.0,))
    assert probability_better(first, second) == 1.0
    assert probability_better((worse, worse), second) < 0.5
    assert probability_better((unscored, unscored), second) == 1.0
    also_there = replace(second[0], scored_at=unscored.scored_at)
    assert probability_better((unscored, first[1]), (also_there, second[1])) == 1.0
    assert len(judge._blocks(unscored)) == 8


def test_the_probability_is_right_where_models_are_alike():
    """Of two models with errors of one size neither is said to be better more often than chance."""
    random = np.random.default_rng(4)
    said = [
        probability_better(runs_with(np.abs(first)), runs_with(np.abs(second)))
        for first, second in random.normal(size=(300, 2, 10))
    ]
    for level in (0.1, 0.5, 0.9):
        assert np.mean(np.asarray(said) < level) == pytest.approx(level, abs=0.06)


def test_what_diverges_does_not_predict_better():
    good = runs_with(np.full(10, 0.1))
    diverged = runs_with(np.r_[np.full(5, 0.1), np.full(5, np.inf)])
    assert probability_better(diverged, good) == 0.0
    assert probability_better(good, diverged) == 1.0
    assert odds(good, diverged) == 1e6


def test_errors_of_zero_or_that_diverge_have_no_noise_to_compare_with():
    for errors in (np.zeros(COUNT), np.full(COUNT, np.inf)):
        run = run_with(errors)
        assert np.isfinite(noise_level((run, run)))


def test_a_rival_with_more_effects_must_be_better_by_what_makes_them_stay():
    level = np.exp(np.random.default_rng(1).normal(-0.02, 0.05, 10))
    rival, chosen = runs_with(0.1 * level), runs_with(np.full(10, 0.1))
    assert odds(rival, chosen, further=1.0) < odds(rival, chosen)


def test_models_that_leave_more_than_noise_are_not_told_apart_by_little():
    """A difference of 0.3 % in every block says which of two wrong models is the better one."""
    first, second = runs_with(np.full(10, 0.1)), runs_with(np.full(10, 0.1003))
    assert 1.0 < odds(first, second) < 1.3
    assert odds(runs_with(np.full(10, 0.05)), second) > 1e6 - 1.0


def test_a_better_law_that_contains_an_effect_is_no_rival_of_it():
    bare, friction = (
        model((), runs_with(np.full(10, 1.0))),
        model((FRICTION,), runs_with(np.full(10, 0.1))),
    )
    wide = model((STRIBECK,), runs_with(np.full(10, 0.098)))
    cubic = model((CUBIC,), runs_with(np.full(10, 0.098)))
    for rival, told in ((wide, []), (cubic, ["cubic_stiffness"])):
        contest = Contest(bare, friction, (friction, rival))
        found = from_contests(MASS, friction, friction.placed, [contest])[FRICTION]
        assert [law.effect for law in found.rivals] == told


def test_a_law_in_place_of_a_wider_one_has_the_standing_of_the_round_that_added_it():
    bare, wide = (
        model((), runs_with(np.full(10, 1.0))),
        model((STRIBECK,), runs_with(np.full(10, 0.1))),
    )
    cubic = model((CUBIC,), runs_with(np.full(10, 0.1)))
    narrowed = model((FRICTION,), runs_with(np.full(10, 0.1)))
    contest = Contest(bare, wide, (wide, cubic))
    found = from_contests(MASS, narrowed, narrowed.placed, [contest])[FRICTION]
    assert [rival.effect for rival in found.rivals] == ["cubic_stiffness"]
    offset = model((OFFSET,), runs_with(np.full(10, 0.1)))
    assert from_contests(MASS, offset, offset.placed, [contest]) == {}


def test_sets_weigh_as_the_criterion_of_schwarz_has_it():
    sets = [
        (frozenset({FRICTION}), 0.0),
        (frozenset({CUBIC}), 2.0),
        (frozenset({FRICTION, OFFSET}), 3.0),
        (frozenset(), 4.0),
    ]
    weights = np.exp(-0.5 * np.array([0.0, 2.0, 3.0, 4.0]))
    found = from_sets(MASS, FRICTION, [FRICTION], sets, {})
    assert found.probability == pytest.approx((weights[0] + weights[2]) / weights.sum())
    (rival,) = found.rivals
    assert (rival.effect, rival.position) == ("cubic_stiffness", "position")
    assert rival.probability == pytest.approx(weights[1] / weights.sum())


def test_a_level_and_an_offset_are_the_asymmetric_law_that_they_are_read_from():
    sets = [(frozenset({ASYMMETRIC}), 0.0), (frozenset({FRICTION}), 1.0)]
    assert from_sets(MASS, FRICTION, [ASYMMETRIC], sets, {}).probability == 1.0
    offset = from_sets(MASS, OFFSET, [ASYMMETRIC], sets, {})
    assert offset.probability == pytest.approx(1.0 / (1.0 + np.exp(-0.5)))
    assert offset.rivals[0].effect == "coulomb_friction"


def test_a_wider_law_that_gave_way_in_free_runs_stays_a_rival():
    sets = [(frozenset({STRIBECK}), 0.0)]
    found = from_sets(MASS, FRICTION, [STRIBECK], sets, {STRIBECK: 0.25})
    assert found.probability == pytest.approx(0.8)
    assert found.rivals[0].effect == "stribeck_friction"


def test_an_effect_that_takes_less_than_is_left_may_be_a_part_of_something_else():
    rival = Rival("cubic_stiffness", "", "position", 0.1)
    found = Standing(0.9, (rival,))
    assert found.beside(1.0, 0.0) == found
    half = found.beside(2.0, 2.0)
    assert half.probability == pytest.approx(0.45)
    assert half.rivals[0].probability == pytest.approx(0.05)
    assert found.beside(-1.0, 1.0).probability == 0.0


def test_models_with_another_effect_of_the_answer_are_no_rivals():
    random = np.random.default_rng(2)

    def level(size):
        return runs_with(size * np.exp(random.normal(0.0, 0.2, 10)))

    bare, friction, offset = model((), level(1.0)), model((FRICTION,), level(0.5)), level(0.55)
    cubic = model((CUBIC,), level(0.5))
    both = model((FRICTION, OFFSET), level(0.2))
    first = Contest(bare, friction, (friction, model((OFFSET,), offset), cubic))
    second = Contest(friction, both, (both,))
    found = from_contests(MASS, both, both.placed, [first, second])
    rare = odds(cubic.runs, friction.runs, cubic.burden - friction.burden)
    assert cubic.burden - friction.burden == 1.0
    against = odds(bare.runs, friction.runs) + rare
    powers = np.exp(2.0 * np.array([one.error for one in (bare, friction, both)]))
    left = powers[-1] - np.exp(2.0 * noise_level(both.runs))
    shares = [taken / (taken + left) for taken in -np.diff(powers)]
    assert 0.5 < shares[1] < shares[0] < 0.97
    assert found[FRICTION].probability == pytest.approx(shares[0] / (1.0 + against))
    assert [rival.effect for rival in found[FRICTION].rivals] == ["cubic_stiffness"]
    expected = shares[1] / (1.0 + odds(friction.runs, both.runs))
    assert found[OFFSET].probability == pytest.approx(expected)
    assert found[OFFSET].rivals == ()
    assert from_contests(MASS, both, both.placed, []) == {}
    # What was in the model from the start was chosen in none of these rounds.
    assert from_contests(MASS, both, both.placed, [second]).keys() == {OFFSET}


def test_what_does_the_same_as_a_lag_of_the_sensor_is_as_probable():
    """A second store of what empties; behind a dead zone a lag of the actuator."""
    random = np.random.default_rng(3)

    def level(size):
        return runs_with(size * np.exp(random.normal(0.0, 0.2, 10)))

    tank = eoi.Plant(lambda t, x, u, p: -p.k * x.y[0], {"k": 1.0}, 1, (), ("charge",))
    valve = eoi.Plant(lambda t, x, u, p: u - p.k * x.y[0], {"k": 1.0}, 1, ("flow",), ("level",))
    zone = place(valve, effects.InputDeadZone(), 0)
    for plant, beside, twin in ((tank, (), "second_node"), (valve, (zone,), "actuator_lag")):
        lag = place(plant, effects.SensorLag(), 0)
        origin, chosen = model((), level(1.0)), model((lag, *beside), level(0.02))
        found = from_contests(plant, chosen, [lag], [Contest(origin, chosen, (chosen,))])[lag]
        assert 0.4 < found.probability <= 0.5
        assert [rival.effect for rival in found.rivals] == [twin]
        assert found.rivals[0].probability == pytest.approx(found.probability, rel=1e-3)
    lag = place(valve, effects.SensorLag(), 0)
    alone = model((lag,), level(0.02))
    told = from_contests(valve, alone, [lag], [Contest(model((), level(1.0)), alone, (alone,))])
    assert told[lag].probability > 0.9
    assert told[lag].rivals == ()


def test_records_of_the_fit_count_as_much_as_those_that_judge():
    """A rival that is hardly better there, and far worse on the others, has no odds."""
    levels = np.linspace(0.8, 1.2, 10)
    held_out = runs_with(levels), runs_with(1.05 * levels[::-1])
    worse = runs_with(3.0 * levels), runs_with(levels)
    alike = runs_with(levels), runs_with(levels)
    assert odds(*held_out) > 1.0
    assert odds(*held_out, of_fit=worse) < 0.01
    fall, error = fall_and_error(*held_out)
    expected = student.cdf(0.5 * fall / (0.5 * error), 18)
    assert probability_better(*held_out, of_fit=alike) == pytest.approx(expected)
    diverged = runs_with([*levels[:-1], np.inf])
    assert probability_better(*held_out, of_fit=(diverged, alike[0])) == 0.0


def fall_and_error(first, second):
    """Fall of the logarithm of whole runs as long as windows, and its standard error."""
    squares = [
        np.mean(np.square(run.predictions[0].outputs - run.records[0].outputs).reshape(10, -1), 1)
        for run in (first[0], second[0])
    ]
    fall = 0.5 * np.log(np.mean(squares[1]) / np.mean(squares[0]))
    parts = 0.5 * (squares[1] / np.mean(squares[1]) - squares[0] / np.mean(squares[0]))
    return fall, np.std(parts, ddof=1) / np.sqrt(10)


# Of fits of one model to long and to short runs: on held-out records, and on those of the fit.
@pytest.mark.parametrize(
    ("errors", "chosen"),
    [
        ({2.0: (0.5, 0.4), 3.0: (0.4, 0.3)}, 3.0),
        ({2.0: (0.5, 0.4), 3.0: (0.49, 0.4)}, None),  # as good as the one that is there
        ({2.0: (0.5, 0.4), 3.0: (0.3, 0.9)}, None),  # better on few records
        ({2.0: (0.3, 0.2), 3.0: (0.35, 0.1)}, 3.0),
    ],
)
def test_of_fits_to_long_and_to_short_runs_all_records_decide(monkeypatch, errors, chosen):
    def fit(gain, *levels):
        plant = MASS.with_parameters({"b": gain})
        runs = (runs_with([level] * 10) for level in levels)
        fitted = replace(REFINEMENT, plant=plant, status=eoi.Status("converged", "as told"))
        return Judged(fitted, (FRICTION,), *runs)

    best, *others = fit(1.0, 0.5, 0.4), *(fit(gain, *pair) for gain, pair in errors.items())
    monkeypatch.setattr(free_run_trials, "over_both", lambda *_: others)
    monkeypatch.setattr(Search, "_tells_parameters", lambda *_: True)
    data = (record(np.zeros(COUNT)),)
    settled = Search(data, data, Judge(data, 1.0, 3, 3), (best,)).settled(best)
    assert settled is not None
    assert settled.refinement.plant.parameters["b"] == (chosen or 1.0)


@pytest.mark.parametrize(("wavenumber", "tells"), [(7.0, True), (3.0, False)])
def test_a_ripple_needs_two_periods_within_the_range_of_the_records(wavenumber, tells):
    """The records swing from -1 to 1: less than two periods are a bend, of any law."""
    ripple = place(MASS, effects.PositionRipple(), 0)
    values = dict(zip(ripple.names, (0.5, 0.5, wavenumber), strict=True))
    fit = replace(REFINEMENT, parameters={**REFINEMENT.parameters, **values},
                  standard_errors=dict.fromkeys([*MASS.names, *values], 0.01))  # fmt: skip
    runs = runs_with([1.0] * 10)
    data = (record(np.sin(0.1 * np.arange(COUNT))),)
    search = Search(data, data, Judge(data, 1.0, 3, 3), (Judged(REFINEMENT, (), runs),))
    assert search.of_unknown_size(Judged(fit, (ripple,), runs)) == ([] if tells else [ripple])


def test_the_experiment_that_is_advised_is_one_that_the_plant_allows():
    """Without inputs the motion follows from where it starts."""
    driven = eoi.Plant(lambda t, x, u, p: u - p.a * x.y[0], {"a": 1.0}, 1)
    free = eoi.Plant(lambda t, x, u, p: -p.a * x.y[0], {"a": 1.0}, 1, inputs=())
    names = ["constant_offset", "power_loss", "coulomb_friction", "input_saturation"]
    for plant, word, absent in ((driven, "input", "start"), (free, "start", "input")):
        sentences = [experiments(plant, [], [name]) for name in names]
        assert all(word in sentence for sentence in sentences[:2])
        assert not any(absent in sentence for sentence in sentences)
        assert bool(sentences[-1]) is bool(plant.inputs)
    assert experiments(free, [], []) == ""
    tank = eoi.Plant(lambda t, x, u, p: u - p.a * x.y[0], {"a": 1.0}, 1, outputs=("level",))
    said = [experiments(plant, [], ["power_loss"]) for plant in (driven, tank)]
    assert [text.endswith("then springs part.") for text in said] == [True, False]
    assert said[1].endswith("then laws of the output part.")


def test_signals_keep_their_underscores_in_sentences():
    product = InputProduct((Signal("load", 0, None), Signal("T_buf", 1)))
    assert "T_buf" in product.words
    assert effects.CoulombFriction().words == "coulomb friction"
