"""What decides in free runs: long runs, the start of a run, few parameters; a limited servo."""

import re
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery import expected_error as errors_of_models
from eoi_jax.discovery import in_free_runs
from eoi_jax.discovery import judge as judge_module
from eoi_jax.discovery.confirm import excesses
from eoi_jax.discovery.expected_error import error_over_noise, expected_error
from eoi_jax.discovery.free_run_evidence import long_run_ratio, lost_on_held_out
from eoi_jax.discovery.free_run_search import search_free_runs
from eoi_jax.discovery.judge import (
    Judge,
    Judged,
    error_ratio,
    least_error_ratio,
    ratio_beyond_noise,
)
from eoi_jax.discovery.remarks import Reason
from eoi_jax.discovery.rules import RULES
from eoi_jax.models.augmented import place
from eoi_jax.models.placements import placements
from eoi_jax.refinement.refine import refine_once
from eoi_jax.simulation.sensor_noise import sensor_noise
from eoi_jax.simulation.validate import judged_runs, validate


def swung(t, x, u, p):
    del t, u
    return -p.stiffness * x.y[0] - p.damping * x.y[1]


PENDULUM = eoi.Plant(
    swung, {"stiffness": 40.0, "damping": 0.3}, relative_degree=2, inputs=(), outputs=("angle",),
    units={"angle": "deg"},
)  # fmt: skip
NOISE = 0.5


def released(seed, angle, dry, noise=NOISE, count=500, period=0.02):
    """A pendulum with dry friction swings out, by SciPy; white noise is logged with it."""
    time = period * np.arange(count)

    def rate(t, x):
        return [x[1], -40.0 * x[0] - 0.25 * x[1] - dry * np.tanh(x[1] / 0.01)]

    run = solve_ivp(rate, (0.0, time[-1]), [angle, 0.0], t_eval=time, max_step=0.01)
    noise = noise * np.random.default_rng(seed).standard_normal(count)
    return eoi.Record(
        time, np.zeros((count, 0)), run.y[0] + noise, input_names=(), output_names=("angle",),
        units={"angle": "deg"},
    )  # fmt: skip


def searched(dry, noise=NOISE):
    records = released(1, 20.0, dry, noise), released(3, 10.0, dry, noise)
    tried = [effects.CoulombFriction(), effects.QuadraticDrag()]
    answer = search_free_runs([PENDULUM], [(records, (released(2, 15.0, dry, noise),))], tried)
    assert answer is not None
    return answer


@pytest.fixture(scope="module")
def answer():
    return searched(40.0)


def test_long_runs_decide_where_short_ones_miss_by_noise(answer):
    """Windows of the declared model miss by 1.5 of the noise; whole runs tell."""
    assert [placed.effect.name for placed in answer.best.placed] == ["coulomb_friction"]
    assert answer.best.refinement.parameters["coulomb_friction"] == pytest.approx(40.0, rel=0.1)
    long_runs, windows = zip(answer.best.runs, answer.base.runs, strict=True)
    assert least_error_ratio(*windows) > 2.0 / 3.0
    assert np.exp(answer.best.error - answer.base.error) > 2.0 / 3.0
    assert ratio_beyond_noise(*long_runs) <= long_run_ratio(answer) < 2.0 / 3.0


def test_a_judge_counts_samples_not_steps_of_a_finer_grid():
    """A start of a third of a window had a few noisy samples, and most of its error in it."""
    coarse = released(2, 15.0, 40.0)
    y = np.full((10 * len(coarse) - 9, 1), np.nan)
    y[::10] = coarse.outputs
    with pytest.warns(eoi.RecordWarning, match="is measured every 10 samples"):
        fine = eoi.Record.from_period(
            0.1 * coarse.sample_period, np.zeros((len(y), 0)), y, units={"y": "deg"}
        )
    judges = [Judge.of((record,), PENDULUM) for record in (coarse, fine)]
    (one, other) = judges
    assert one is not None
    assert other is not None
    assert other.window == pytest.approx(one.window, rel=0.05)
    assert (other.head, other.whole_head) == (10 * one.head, 10 * one.whole_head)


def driven(t, x, u, p):
    del t
    return p.gain * u - p.loss * x.y[0]


@pytest.mark.parametrize(("kept", "judges"), [(9, False), (60, True)])
def test_inputs_known_in_parts_shorter_than_any_run_judge_nothing(kept, judges):
    """Where they are long enough, starts fit into them."""
    time = 0.01 * np.arange(400)
    u = np.sin(3.0 * time)
    u[np.arange(400) % (kept + 20) >= kept] = np.nan
    with pytest.warns(eoi.RecordWarning, match="Inputs are unknown"):
        record = eoi.Record(time, u, np.cos(3.0 * time), hold="linear")
    judge = Judge.of((record,), eoi.Plant(driven, {"gain": 1.0, "loss": 1.0}, 1))
    assert (judge is not None) is judges
    if judge is not None:
        assert max(judge.head, judge.whole_head) < kept


@pytest.mark.parametrize(("long_ratio", "effects_named"), [(0.6, ("coulomb_friction",)), (0.7, ())])
def test_the_answer_says_that_long_runs_decided(monkeypatch, answer, long_ratio, effects_named):
    monkeypatch.setattr(in_free_runs, "long_run_ratio", lambda answer: long_ratio)
    monkeypatch.setattr(in_free_runs, "shown_by_all", lambda answer: False)
    record = released(1, 20.0, 0.0)
    found = eoi.discover(PENDULUM, record, released(2, 15.0, 0.0), ["coulomb_friction"])
    judged = in_free_runs.answered(found, answer, (), None)
    assert judged.effects == effects_named
    notes = [note for note in judged.notes if note.startswith("in short runs the predictions")]
    assert len(notes) == len(effects_named)
    assert effects_named or judged.status.code in ("unexplained", "nothing_missing")


def test_the_number_in_the_answer_is_the_mean_that_it_says(monkeypatch, answer):
    monkeypatch.setattr(in_free_runs, "long_run_ratio", lambda answer: 0.6)
    found = eoi.discover(
        PENDULUM, released(1, 20.0, 0.0), released(2, 15.0, 0.0), ["quadratic_drag"]
    )
    judged = in_free_runs.answered(found, answer, (), None)
    pairs = (judged.before, judged.after), (judged.windows_before, judged.windows_after)
    ratio = np.sqrt(np.prod([new.rmse[0] / old.rmse[0] for old, new in pairs if old and new]))
    assert f"have {ratio:.3g} of the error of the refined" in judged.status.message
    assert "(geometric mean of the errors of all outputs, in long runs" in judged.status.message


@pytest.mark.parametrize(
    ("excess", "nrmse", "code"),
    [([], None, "nothing_missing"), (["more than noise"], None, "unexplained"),
     ([], 2.0, "unexplained")],
)  # fmt: skip
def test_what_confirms_nothing_shows_nothing_to_be_missing_within_the_noise(
    monkeypatch, answer, excess, nrmse, code
):
    """The windows of the declared model miss by less than twice the noise, as read off them.

    Where a constant is better than the model that noise may be motion.
    """
    monkeypatch.setattr(in_free_runs, "long_run_ratio", lambda answer: 0.7)
    monkeypatch.setattr(in_free_runs, "shown_by_all", lambda answer: False)
    found = eoi.discover(
        PENDULUM, released(1, 20.0, 0.0), released(2, 15.0, 0.0), ["quadratic_drag"]
    )
    assert in_free_runs.misses(answer.base) == []
    if excess:
        monkeypatch.setattr(in_free_runs, "misses", lambda model: excess)
    moved = 1.0 if nrmse is None else nrmse / answer.base.runs[1].nrmse[0]
    base, best = (
        replace(model, runs=tuple(replace(run, nrmse=moved * run.nrmse) for run in model.runs))
        for model in (answer.base, answer.best)
    )
    refined = replace(answer, base=base, best=best, better_base=True)
    judged = in_free_runs.answered(found, refined, (), None)
    assert (judged.status.code, judged.effects) == (code, ())
    hints = [note for note in judged.notes if note.startswith("with coulomb_friction the errors")]
    assert len(hints) == (code == "nothing_missing")
    assert (judged.lead is None) == (code == "nothing_missing")


@pytest.mark.parametrize("silent", [True, False])
def test_held_out_records_within_the_noise_outweigh_what_the_injection_leaves(
    monkeypatch, answer, silent
):
    """Where samples are far apart its residual is an error of what lies between them."""
    monkeypatch.setattr(in_free_runs, "long_run_ratio", lambda answer: 0.7)
    monkeypatch.setattr(in_free_runs, "shown_by_all", lambda answer: False)
    found = eoi.discover(
        PENDULUM, released(1, 20.0, 0.0), released(2, 15.0, 0.0), ["quadratic_drag"]
    )
    found = replace(found, status=eoi.Status("unexplained", ""))
    monkeypatch.setattr(in_free_runs, "misses", lambda model: [])
    over = {"long": 0.9 if silent else 1.1, "short": 0.9}  # errors over the limit
    limits = np.array(list(over.values())) * in_free_runs._RULES.silent
    runs = answer.base.runs
    noises = {id(run): run.rmse / limit for run, limit in zip(runs, limits, strict=True)}
    monkeypatch.setattr(in_free_runs, "sensor_noise", lambda run: noises[id(run)])
    plain = replace(answer, better_base=False, best=answer.base)
    judged = in_free_runs.answered(found, plain, (), None)
    assert judged.status.code == ("nothing_missing" if silent else "unexplained")
    with_lead = in_free_runs.answered(found, replace(plain, best=answer.best), (), None)
    assert with_lead.status.code == "unexplained"


@pytest.mark.parametrize(
    ("tried", "named"),
    [([effects.CoulombFriction()], ()),
     ([effects.CoulombFriction(), effects.Product("y", "v")], ("coulomb_friction",))],
)  # fmt: skip
def test_what_a_product_refuted_in_the_injection_is_named_where_products_were_tried(
    monkeypatch, answer, tried, named
):
    """In free runs a product was then a rival, and has lost."""
    monkeypatch.setattr(in_free_runs, "long_run_ratio", lambda answer: 0.6)
    record = released(1, 20.0, 0.0)
    found = eoi.discover(PENDULUM, record, released(2, 15.0, 0.0), ["coulomb_friction"])
    refuted = replace(found.ranking[0], effect="coulomb_friction", reason=Reason.PRODUCT)
    found = replace(found, ranking=(refuted,))
    assert in_free_runs.answered(found, answer, tried, None).effects == named


def steep(t, x, u, p):
    """Dry friction as a curve that is nearly a step."""
    del t, u
    return -p.stiffness * x.y[0] - p.friction * jnp.clip(1e4 * x.y[1], -1.0, 1.0)


def test_a_model_is_judged_in_a_bounded_number_of_steps(monkeypatch):
    """A curve as steep as dry friction took a third of the time of a search."""
    plant = eoi.Plant(steep, {"stiffness": 40.0, "friction": 40.0}, 2, (), ("angle",))
    judge = Judge.of((released(2, 15.0, 40.0, 0.0),), PENDULUM)
    assert judge is not None
    counts = []
    for most in (RULES.judge.steps, 5_000):
        monkeypatch.setattr(judge_module, "_RULES", replace(RULES.judge, steps=most))
        runs = judge.runs(plant)
        counts.append(runs[0].substeps)
        assert runs[1] is not None
        assert runs[1].substeps == runs[0].substeps <= most / 500
    assert counts[0] > counts[1]


def test_records_of_the_fit_are_simulated_in_steps_as_short_as_those_that_judge():
    """Whatever their sample periods are."""
    judge = Judge.of((released(2, 15.0, 0.0),), PENDULUM)
    assert judge is not None
    records = (released(1, 20.0, 0.0, period=0.06, count=300),)
    fit = refine_once(PENDULUM, records, None)
    judged = replace(judge, of_fit=Judge.of(records, PENDULUM)).judged(fit, ())
    assert judged.fit_runs is not None
    steps = [runs[0].substeps for runs in (judged.runs, judged.fit_runs)]
    assert steps[1] == 3 * steps[0]


@pytest.mark.slow
def test_errors_on_records_that_no_model_describes_confirm_no_effect(monkeypatch, answer):
    """Held out at another place: dry friction is nearer to them by chance, and both are lost."""
    monkeypatch.setattr(in_free_runs, "long_run_ratio", lambda answer: 0.5)
    elsewhere = released(2, 15.0, 40.0)
    elsewhere = eoi.Record(
        elsewhere.time, elsewhere.inputs, elsewhere.outputs + 200.0, input_names=(),
        output_names=("angle",), units={"angle": "deg"},
    )  # fmt: skip
    judge = Judge.of((elsewhere,), PENDULUM)
    assert judge is not None
    base, best = (
        replace(model, runs=judge.runs(model.refinement.plant))
        for model in (answer.base, answer.best)
    )
    lost = replace(answer, base=base, best=best, judge=judge)
    (note,) = lost_on_held_out(lost)
    assert re.search(r"angle is 187\S* to 215\S* deg there, -18\S* to 20\S* in the fit", note)
    assert lost_on_held_out(answer) == []
    found = eoi.discover(PENDULUM, released(1, 20.0, 0.0), elsewhere, ["coulomb_friction"])
    judged = in_free_runs.answered(found, lost, (), None)
    assert judged.effects == ()
    assert judged.lead is not None
    assert note in judged.notes


@pytest.mark.parametrize(("error", "is_lost"), [(1.0, False), (50.0, True)])
def test_held_out_records_that_hardly_move_are_lost_by_more_than_those_of_the_fit_move(
    answer, error, is_lost
):
    """A rig at rest: a constant describes it better than any model."""
    runs = [replace(run, rmse=np.array([error]), nrmse=np.array([5.0])) for run in answer.best.runs]
    still = replace(answer, best=replace(answer.best, runs=tuple(runs)))
    assert bool(lost_on_held_out(still)) == still.is_lost == is_lost


def test_long_runs_do_not_decide_alone_where_short_ones_tell():
    assert long_run_ratio(searched(40.0, 0.2)) == np.inf


def test_without_friction_nothing_is_added_to_such_records():
    found = searched(0.0)
    assert not found.best.placed
    assert long_run_ratio(found) == np.inf


def test_long_runs_decide_nothing_that_is_chance_on_the_records_of_the_fit(answer, monkeypatch):
    """Half a swing under much noise: errors beyond it are a half, by no more than its scatter."""
    judge = Judge.of((released(6, 20.0, 40.0, 4.0, 120),), answer.base.refinement.plant)
    assert judge is not None
    base, best = (
        replace(model, fit_runs=judge.runs(model.refinement.plant))
        for model in (answer.base, answer.best)
    )
    few = replace(answer, base=base, best=best)
    assert long_run_ratio(few) == np.inf
    monkeypatch.setattr(Judge, "prefers", lambda *_: True)
    assert long_run_ratio(few) < 2.0 / 3.0


def test_what_an_error_falls_to_if_the_other_model_is_true():
    """Errors of a biased model are noise and a difference: without it they are the noise."""
    record = released(2, 15.0, 0.0)
    exact = PENDULUM.with_parameters({"stiffness": 40.0, "damping": 0.25})
    biased = exact.with_parameters({"damping": 0.35})
    runs = [judged_runs(plant, (record,), 50) for plant in (exact, biased)]
    assert error_ratio(*runs) < 0.8
    assert least_error_ratio(*runs) == pytest.approx(error_ratio(*runs), abs=0.05)
    assert least_error_ratio(runs[1], runs[1]) == 1.0


def test_what_exceeds_the_noise_is_what_records_without_noise_show():
    """A model with half of the error of another one: beside the noise the ratio is near one."""
    exact = PENDULUM.with_parameters({"stiffness": 40.0, "damping": 0.25})
    models = [exact.with_parameters({"damping": 0.25 * factor}) for factor in (1.1, 1.2)]
    noisy, clean = (
        [judged_runs(plant, (released(2, 15.0, 0.0, noise, 2000),), 50) for plant in models]
        for noise in (NOISE, 0.0)
    )
    assert error_ratio(*clean) < 0.6
    assert error_ratio(*noisy) > 0.85
    assert ratio_beyond_noise(*noisy) == pytest.approx(error_ratio(*clean), rel=0.15)
    assert ratio_beyond_noise(*clean) == pytest.approx(error_ratio(*clean), rel=1e-3)
    true = judged_runs(exact, noisy[0].records, 50)
    assert ratio_beyond_noise(true, true) == 1.0


@pytest.mark.slow
def test_an_effect_that_is_all_that_noise_leaves_to_be_seen_is_an_answer():
    """With the friction the errors are noise, which those without it exceed by a sixth."""
    found = searched(20.0, 1.0)
    assert [placed.effect.name for placed in found.best.placed] == ["coulomb_friction"]
    assert error_ratio(found.best.runs[0], found.base.runs[0]) > 2.0 / 3.0
    assert long_run_ratio(found) < 2.0 / 3.0


# -- the start of a run -----------------------------------------------------------------------


@pytest.mark.parametrize(("count", "head"), [(48, 14), (120, 30), (400, 50)])
def test_so_many_samples_tell_position_and_velocity_at_the_start_of_a_run(count, head):
    """What an error of the velocity grows to would hide the effects: a tenth and three for each."""
    random = np.random.default_rng(0)
    time = 0.01 * np.arange(count)
    angle = np.sin(9.0 * time) + 1e-3 * random.standard_normal(count)
    record = eoi.Record(time, np.zeros((count, 0)), angle, input_names=(), output_names=("angle",))
    judge = Judge.of((record,), PENDULUM)
    assert judge is not None
    assert judge.whole_head == head


# -- few parameters ---------------------------------------------------------------------------


def trial(effect, error):
    """A model whose errors have this mean logarithm."""
    record = (released(2, 15.0, 0.0),)
    runs = judged_runs(PENDULUM, record, 20)
    fit = refine_once(PENDULUM, record, None)
    judged = Judged(fit, (place(PENDULUM, effect, 0),), (runs, None))
    return replace(judged, runs=(replace(runs, nrmse=np.exp([error])), None))


@pytest.mark.parametrize(("fall", "chosen"), [(0.08, "coulomb_friction"),
                                              (0.1, "stribeck_friction")])  # fmt: skip
def test_a_wider_law_is_better_by_so_much_for_each_further_parameter(fall, chosen):
    """Stribeck friction has two more than Coulomb friction: 0.03 for each, and 0.03 that decide."""
    trials = [
        trial(effects.CoulombFriction(), -5.0),
        trial(effects.StribeckFriction(), -5.0 - fall),
    ]
    plainest = Judge((released(2, 15.0, 0.0),), 0.1, 4, 8).plainest(trials)
    assert plainest.placed[0].effect.name == chosen


@pytest.mark.parametrize(("rise", "chosen"), [(0.0, "coulomb_friction"),
                                              (0.02, "stribeck_friction")])  # fmt: skip
def test_a_plainer_law_that_is_as_good_is_not_passed_over(rise, chosen):
    """Where only the wider one falls by more than two standard errors."""
    plain, wide = (
        trial(effects.CoulombFriction(), -5.0 + rise),
        trial(effects.StribeckFriction(), -5.0),
    )
    judge = Judge((released(2, 15.0, 0.0),), 0.1, 4, 8)
    assert judge.plainest_of_all([plain, wide], [wide]).placed[0].effect.name == chosen
    assert judge.plainest_of_all([plain, wide], [plain]) is plain


# -- a servo whose drive saturates ------------------------------------------------------------


def followed(t, x, u, p):
    return p.stiffness * (u - x.y[0]) - p.damping * x.y[1]


SERVO = eoi.Plant(
    followed, {"stiffness": 20.0, "damping": 6.0}, relative_degree=2, inputs=("command",),
    outputs=("angle",), units={"command": "deg", "angle": "deg"},
)  # fmt: skip
STIFFNESS, DAMPING, LIMIT = 36.0, 8.2, 30.0


def followed_levels(seed, limit=LIMIT, count=900, period=0.015):
    """Random levels of a command, by SciPy; whole degrees are logged."""
    random = np.random.default_rng(seed)
    time = period * np.arange(count)
    command = np.repeat(random.uniform(0.0, 170.0, count // 90), 90)

    def rate(t, x):
        error = command[min(int(t / period), count - 1)] - x[0]
        return [x[1], STIFFNESS * np.clip(error, -limit, limit) - DAMPING * x[1]]

    run = solve_ivp(rate, (0.0, time[-1]), [command[0], 0.0], t_eval=time, max_step=period)
    return eoi.Record(
        time, command, np.round(run.y[0]), hold="zero", input_names=("command",),
        output_names=("angle",), units={"command": "deg", "angle": "deg"},
    )  # fmt: skip


@pytest.mark.slow
def test_a_limited_control_error_of_a_servo_is_found_with_its_limit():
    found = eoi.discover(SERVO, followed_levels(1), followed_levels(2))
    assert found.effects == ("error_saturation",)
    values = found.plant.parameters
    assert values["error_saturation"] == pytest.approx(LIMIT, rel=0.05)
    assert values["stiffness"] == pytest.approx(STIFFNESS, rel=0.05)


def test_a_servo_that_is_not_limited_gets_no_limit():
    tried = [effects.ErrorSaturation(), effects.InputSaturation()]
    pair = (followed_levels(1, np.inf),), (followed_levels(2, np.inf),)
    answer = search_free_runs([SERVO], [pair], tried)
    assert answer is not None
    assert not answer.best.placed


def test_a_control_error_needs_an_input_that_commands_the_output():
    """By its unit; without units by the model, which knows both by their difference."""
    law = effects.ErrorSaturation()
    assert [placed.names for placed in placements(SERVO, [law])] == [("error_saturation",)]
    assert not placements(PENDULUM, [law])
    for units, places in (({}, 1), ({"command": "V"}, 1), ({"command": "V", "angle": "deg"}, 0)):
        commanded = eoi.Plant(
            followed, dict(SERVO.parameters), relative_degree=2, inputs=("command",),
            outputs=("angle",), units=units,
        )  # fmt: skip
        assert len(placements(commanded, [law])) == places
    forced = eoi.Plant(
        lambda t, x, u, p: p.b * u - p.k * x.y[0], {"b": 2.0, "k": 1.0}, 2, ("command",), ("angle",)
    )
    assert not placements(forced, [law])
    shown = eoi.Plant(lambda t, x, u, p: p.b * u, {"b": 2.0}, 0, ("command",), ("angle",))
    assert not placements(shown, [law])
    at = effects.At(*jnp.asarray([0.0, 10.0, 0.0, 50.0]), z=None)
    assert float(law.changed(at, [30.0])) == 40.0


def weighed(t, x, u, p):
    return followed(t, x, u, p) - p.weight * jnp.sin(x.y[0])


def limited(t, x, u, p):
    return p.stiffness * jnp.clip(u - x.y[0], -0.5, 0.5) - p.damping * x.y[1]


def filled(t, x, u, p):
    return p.stiffness * jnp.sqrt(u + 2.0) - p.damping * jnp.sqrt(x.y[0] + 2.0)


def mixed(t, x, u, p):
    return p.stiffness * u * x.y[0] - p.damping * x.y[1]


@pytest.mark.parametrize(("law", "places"), [(weighed, 1), (limited, 1), (filled, 0), (mixed, 0)])
def test_an_input_in_the_unit_of_the_output_is_one_that_the_model_takes_the_output_from(
    law, places
):
    """Under a weight it is; not where the level of one tank fills another one."""
    plant = eoi.Plant(
        law, {"stiffness": 20.0, "damping": 6.0, "weight": 1.0}, relative_degree=2,
        inputs=("command",), outputs=("angle",), units={"command": "rad", "angle": "rad"},
    )  # fmt: skip
    assert len(placements(plant, [effects.ErrorSaturation()])) == places


SWING = eoi.Plant(
    lambda t, x, u, p: -p.stiffness * x.y[0] - p.damping * x.y[1],
    {"stiffness": 30.0, "damping": 0.2}, 2, inputs=(), outputs=("rate",), units={"rate": "rad/s"},
)  # fmt: skip


def gyroscope(seed, start, dry):
    """The rate of a swing with dry friction; its time at rest is not recorded."""
    time = 0.02 * np.arange(400)

    def slope(t, x):
        return [x[1], -36.0 * x[0] - 0.3 * x[1] - dry * np.tanh(x[1] / 1e-3)]

    run = solve_ivp(slope, (0.0, time[-1]), [start, 0.0], t_eval=time, max_step=2e-3)
    noise = 2e-3 * np.random.default_rng(seed).standard_normal(len(time))
    return eoi.Record(
        time, np.zeros((len(time), 0)), run.y[1] + noise, input_names=(), output_names=("rate",),
        units={"rate": "rad/s"},
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("dry", [0.0, 0.3])
def test_dry_friction_is_found_where_the_output_is_the_speed_of_the_motion(dry):
    """Its derivative is in the model: a jump at each turn, of which `coulomb_friction` has none."""
    records = gyroscope(1, 0.8, dry), gyroscope(2, 0.5, dry)
    tried = [*effects.standard(), *effects.wider()] if dry else [effects.RateFriction()]
    found = eoi.discover(SWING, records[0], records[1], tried)
    assert found.effects == (("rate_friction",) if dry else ())
    if dry:
        level = found.plant.parameters["rate_friction_level"]
        assert level == pytest.approx(dry, rel=0.1)
        assert found.plant.parameters["damping"] == pytest.approx(0.3, rel=0.15)


def grown(count, seed, noise=0.05):
    """A culture that grows tenfold from a start that is told by few samples."""
    time = np.linspace(0.0, 4.0, count)
    error = noise * np.random.default_rng(seed).standard_normal((count, 1))
    y = 0.2 * np.exp(0.6 * time)[:, None] + error
    return eoi.Record(time, np.zeros((count, 0)), y, f"batch {seed}")


CULTURE = eoi.Plant(lambda t, x, u, p: p.rate * x.y[0], {"rate": 0.6}, inputs=())


def test_a_right_model_is_expected_to_miss_by_the_error_of_its_start_too():
    """The mean square over many batches is that which the derivation says, not that of noise."""
    fit = refine_once(CULTURE, tuple(grown(20, seed) for seed in range(3)), None)
    ratios, levels = [], []
    for seed in range(100, 140):
        judge = Judge.of((grown(20, seed),), CULTURE)
        assert judge is not None
        run = judge.runs(fit.plant)[0]
        levels.append(expected_error(fit, run)[0] / sensor_noise(run)[0])
        ratios.append(run.rmse[0] / 0.05)
    reached = np.sqrt(np.mean(np.square(ratios)))
    assert np.mean(levels) > 1.5
    assert reached == pytest.approx(np.mean(levels), rel=0.25)


@pytest.mark.parametrize(
    ("long_run", "windows", "said"),
    [(1.1, 1.0, "no more than noise"), (1.8, 1.1, "1.8 times the noise"),
     (1.1, 1.4, "1.4 times the noise in windows"), (5.0, 1.5, "1.5 times the noise in windows"),
     (5.0, 1.1, "no more than noise"),
     (5.0, None, "5 times the noise, as a right model may from starts that are told no better")],
)  # fmt: skip
def test_an_answer_says_by_how_much_it_misses(monkeypatch, answer, long_run, windows, said):
    """Long runs that miss by more than noise where windows do not have drifted."""
    monkeypatch.setattr(errors_of_models, "sensor_noise", lambda run: np.array([0.01]))
    long_runs, short_runs = (
        times and replace(run, rmse=np.array([0.01 * times]))
        for run, times in zip(answer.base.runs, (long_run, windows), strict=True)
    )
    assert error_over_noise(replace(answer.base, runs=(long_runs, short_runs))) == said


def test_noise_that_is_read_off_few_samples_may_be_small_by_chance():
    """A misfit of 2.2 times the noise: of two hundred samples it is told, of twelve it is not."""
    told = []
    for count in (12, 200):
        record = grown(count, 1)
        run = validate(CULTURE, record, initial_samples=4)
        told.append(excesses(replace(run, rmse=np.array([2.2])), np.array([1.0])))
    assert [len(sentences) for sentences in told] == [0, 1]


@pytest.mark.parametrize(
    ("times", "said"), [(1.4, ""), (2.2, ", which 8 samples tell to within a factor of 6.1 only")]
)
def test_an_answer_says_where_few_samples_tell_the_noise(answer, times, said, monkeypatch):
    """Of eight samples the square is told by 2.7 differences: F at 99 % is 6.1 squared."""
    monkeypatch.setattr(errors_of_models, "sensor_noise", lambda run: np.array([1.0]))
    run = validate(CULTURE, grown(12, 1), initial_samples=4)
    few = replace(answer.base, runs=(replace(run, rmse=np.array([times])), None))
    assert error_over_noise(few) == f"{times} times the noise{said}"
