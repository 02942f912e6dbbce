"""Answers that explain the injection, questioned by free runs: a rival, a hint, an extension."""

from dataclasses import replace

import numpy as np
import pytest
from found import discovery

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax._status import Status
from eoi_jax.discovery.doubts import leaves_more, leaves_open, misses_widely, telling_runs
from eoi_jax.discovery.free_run_search import search_free_runs
from eoi_jax.discovery.in_free_runs import (
    contradicts_injection,
    unless_refined_is_better,
    with_further_effects,
)
from eoi_jax.discovery.remainder import partial_where_more_is_left
from eoi_jax.discovery.result import Added
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.effects import Curve, Product
from eoi_jax.simulation.sensor_noise import sensor_noise

TIME = np.arange(4001) * 5e-3
TRUTH = {"gain": 1.0, "damping": 0.4, "stiffness": 10.0}


def oscillating(t, x, u, p):
    position, rate = x.y
    return p.gain * u - p.damping * rate - p.stiffness * position


PLANT = eoi.Plant(oscillating, {"gain": 1.2, "damping": 0.5, "stiffness": 9.0}, 2, ("u",), ("y",))
SPRING = {effects.CubicStiffness(): 8.0}


def record(hidden, seed):
    draw = np.random.default_rng(seed)
    force = np.repeat(draw.normal(size=100), 41)[: len(TIME)] + np.sin(2.0 * TIME)
    placed = [place(PLANT, effect, 0) for effect in hidden]
    values = {item.names[0]: hidden[item.effect] for item in placed}
    made = eoi.simulate(augmented(PLANT.with_parameters(TRUTH), placed, values), TIME, force,
                        hold="zero", substeps=2)  # fmt: skip
    noise = 1e-3 * np.std(made.outputs) * draw.standard_normal(made.outputs.shape)
    return eoi.Record(TIME, force, made.outputs + noise, f"run {seed}", hold="zero")


def judged_on(found, held):
    """The answer on other records that are held out."""
    runs = [eoi.validate(found.plant, held, window=window) for window in (np.inf, 2.0)]
    return replace(found, held_out=(held,), after=runs[0], windows_after=runs[1])


@pytest.fixture(scope="module")
def found():
    answer = eoi.discover(PLANT, record(SPRING, 1), record(SPRING, 2), [*SPRING])
    assert answer.effects == ("cubic_stiffness",)
    return answer


def test_an_effect_that_the_refined_model_does_not_need_gives_way(found):
    """Records of a rig that lacks nothing: all that the spring could make up for is a bias."""
    fit, held = record({}, 3), record({}, 4)
    biased = judged_on(found, held)
    answer = unless_refined_is_better(biased, (fit,))
    assert (answer.effects, answer.added, answer.status.code) == ((), (), "unexplained")
    assert answer.plant is found.declared.plant
    assert answer.diagnosis is not None
    assert any(note.startswith("refused: cubic_stiffness would explain") for note in answer.notes)


def test_an_effect_that_it_needs_stays(found):
    assert unless_refined_is_better(found, (record(SPRING, 1),)) is found


@pytest.mark.parametrize("drag", [0.0, 0.2])
def test_a_product_beside_the_answer_is_added_where_it_leaves_no_more_than_noise(found, drag):
    """Else it is a hint: it names no cause, and takes its share of what does."""
    hidden = SPRING | {Product("y", "u"): 0.3, effects.QuadraticDrag(): drag}
    fit, held = record(hidden, 1), record(hidden, 2)
    left = judged_on(found, held)
    assert leaves_more(left)
    answer = with_further_effects(left, (fit,), (held,), [Product("y", "u")], None, 0.01)
    hints = [note for note in answer.notes if "names no cause" in note]
    assert answer.effects == ("cubic_stiffness",) + (("product",) if drag == 0.0 else ())
    assert bool(hints) is (drag != 0.0)
    assert all("with the product of y and u beside the answer" in hint for hint in hints)


def test_a_law_beside_the_answer_is_added(found):
    hidden = SPRING | {effects.QuadraticDrag(): 0.2}
    fit, held = record(hidden, 1), record(hidden, 2)
    answer = with_further_effects(
        judged_on(found, held), (fit,), (held,), [effects.QuadraticDrag()], None, 0.01
    )
    assert answer.effects == ("cubic_stiffness", "quadratic_drag")
    assert answer.plant.parameters["quadratic_drag"] == pytest.approx(0.2, rel=0.05)
    assert answer.windows_after is not None
    assert answer.windows_after.window == 2.0


def test_the_hold_of_an_answer_that_is_refined_is_the_one_its_free_runs_show(found):
    """The injection may take a staircase for smooth: half a sample of delay, in a fast mode."""
    logged = [record(SPRING, seed) for seed in (1, 2)]
    fit, held = (eoi.Record(one.time, one.inputs, one.outputs, one.name) for one in logged)
    left = judged_on(found, held.with_hold("smooth"))
    answer = with_further_effects(left, (fit,), (held,), [], None, 0.01)
    assert answer.effects == ("cubic_stiffness",)
    assert answer.held_out[0].hold == "zero"
    assert any(note.startswith("hold zero: ") for note in answer.notes)


def test_an_effect_that_free_runs_came_to_is_not_said_to_be_refused(found):
    hidden = SPRING | {effects.QuadraticDrag(): 0.2}
    fit, held = record(hidden, 1), record(hidden, 2)
    said = "refused: {} would make free runs on the records of `validation` worse or diverge"
    refused = [said.format(name) for name in ("quadratic_drag", "coulomb_friction")]
    left = replace(judged_on(found, held), notes=(*found.notes, *refused))
    answer = with_further_effects(left, (fit,), (held,), [effects.QuadraticDrag()], None, 0.01)
    assert answer.effects == ("cubic_stiffness", "quadratic_drag")
    assert [note for note in answer.notes if note.startswith("refused: ")] == refused[1:]


@pytest.mark.parametrize(("drift", "stays"), [(0.0, False), (0.3, True)])
def test_an_answer_with_a_disturbance_in_time_must_predict_better_than_one_without(drift, stays):
    """Beside a spring that takes all there is it is as good, and goes."""
    hidden = SPRING | ({effects.Drift(): drift} if drift else {})
    parts = (record(hidden, 1),), (record(hidden, 2),)
    disturbed = [place(PLANT, effect, 0) for effect in (*SPRING, effects.Drift())]
    values = {item.names[0]: {**SPRING, effects.Drift(): drift}[item.effect] for item in disturbed}
    rival = augmented(PLANT.with_parameters(TRUTH), disturbed, values)
    answer = search_free_runs([PLANT], [parts], [*SPRING], rival=rival)
    assert (answer is None) == stays


def test_a_model_that_a_constant_is_better_than_does_not_lack_nothing(found):
    """What is read as noise off a few samples may be motion."""
    runs = replace(found.windows_after, rmse=np.array([1e-9]), nrmse=np.array([0.5]))
    quiet = replace(
        found, status=Status("nothing_missing", "quiet"), effects=(), added=(), windows_after=None,
        after=runs,
    )  # fmt: skip
    assert not leaves_open(quiet)
    assert leaves_open(replace(quiet, after=replace(runs, nrmse=np.array([1.3]))))
    assert leaves_open(replace(quiet, windows_after=replace(runs, nrmse=np.array([1.3]))))
    assert not leaves_open(replace(quiet, after=None))


def test_an_answer_to_a_part_is_partial_where_free_runs_show_the_rest(found):
    """Complete is what leaves noise in the injection and in free runs."""
    left = replace(judged_on(found, record({}, 4)), explained=0.6)
    runs = left.windows_after
    worse = replace(runs, nrmse=10.0 * runs.nrmse)
    left = replace(left, before=worse, windows_before=worse)
    answer = partial_where_more_is_left(left)
    assert answer.status.code == "partial"
    assert answer.status.message == (
        f"{left.status.message}; free runs on the held-out records miss by more than noise"
    )
    alike = replace(left, explained=0.95, windows_before=runs)
    assert partial_where_more_is_left(alike).status.message == (
        f"{answer.status.message}, hardly less than before"
    )
    assert partial_where_more_is_left(replace(left, windows_after=None)).status == answer.status
    most = partial_where_more_is_left(replace(left, explained=0.95))
    assert most.status == left.status
    times = runs.rmse[0] / sensor_noise(runs)[0]
    assert most.notes[-1] == (
        f"free runs of {left.plant.outputs[0]} in windows miss by {times:.2g} times the noise of "
        "its sensor: something smaller than the added effects is missing, too, or an input acted "
        "otherwise than its log, which may be noisy or inexact"
    )
    assert partial_where_more_is_left(replace(left, in_sample=True)).status == left.status
    assert partial_where_more_is_left(found) == found


def test_what_is_questioned(found):
    left = judged_on(found, record({}, 4))
    assert leaves_more(left)
    runs = left.windows_after
    for size, wide in ((0.04, False), (0.06, True)):
        missed = replace(left, windows_after=replace(runs, nrmse=np.full(1, size)))
        assert misses_widely(missed) == wide
    assert not misses_widely(found)
    assert not leaves_more(found)
    assert not leaves_more(replace(left, in_sample=True))
    assert not leaves_more(replace(left, added=()))
    assert leaves_more(replace(left, windows_after=None))
    assert not leaves_more(replace(left, windows_after=None, after=None))
    curved = replace(left.added[0], effect=Curve("y", ()))
    assert not leaves_more(replace(left, added=(curved,)))
    # Simulated without noise: errors of the simulation, which exceed its accuracy.
    for size, searched in ((2e-4, True), (5e-5, False)):
        assert (
            leaves_more(replace(left, windows_after=replace(runs, nrmse=np.full(1, size))))
            == searched
        )
    # An error far below what was read as noise: that was motion, and worth a search.
    runs = replace(found.windows_after, rmse=np.array([1e-9]), nrmse=np.array([0.02]))
    assert leaves_more(replace(found, windows_after=runs))
    small = replace(runs, nrmse=np.array([0.002]))
    assert not leaves_more(replace(found, windows_after=small))


@pytest.mark.parametrize(
    ("laws", "doubted"),
    [
        ((effects.Overflow(), effects.ConstantOffset()), True),
        ((effects.Leak(), effects.Overflow()), True),
        ((effects.Overflow(),), False),
        ((effects.Leak(), effects.ConstantOffset()), False),
    ],
)
def test_a_kink_beside_a_straight_loss_may_stand_for_a_loss_that_bends(laws, doubted):
    answer = discovery()
    added = tuple(Added(law, "position", {}, {}, "") for law in laws)
    complete = replace(answer, added=added, status=Status("complete", ""), in_sample=False)
    assert leaves_open(complete) == doubted


@pytest.mark.parametrize("held_out", [SPRING, {}])
def test_a_disturbance_in_time_that_predicts_to_the_noise_stands_in_for_nothing(found, held_out):
    """A search in free runs of such an answer took ten times as long as all else."""
    drift = replace(found.added[0], effect=effects.Drift())
    answer = replace(judged_on(found, record(held_out, 2)), added=(drift,))
    assert leaves_open(answer) == (not held_out)


@pytest.mark.parametrize(("error", "doubted"), [(0.005, False), (0.05, True)])
def test_a_loss_to_a_level_may_stand_for_a_store_where_something_is_left(error, doubted):
    answer = discovery()
    pair = tuple(
        Added(law, "position", {}, {}, "") for law in (effects.Leak(), effects.ConstantOffset())
    )
    complete = replace(answer, added=pair, status=Status("complete", ""), in_sample=False)
    assert complete.after is not None
    runs = replace(complete.after, nrmse=np.array([error]))
    assert leaves_open(replace(complete, after=runs, windows_after=None)) == doubted


@pytest.mark.parametrize(
    ("level", "rise", "error", "doubted"),
    [
        (1.0, 0.3, 0.1, False),
        (1.0, 1.2, 0.1, True),
        (1.0, 0.3, 0.6, True),
        (0.0, 1.0, np.nan, True),
    ],
)
def test_friction_that_falls_to_less_than_half_may_stand_for_drag(level, rise, error, doubted):
    """It makes up for a damping that is too large at low speed; or its level is not told."""
    answer, values = discovery(), {"level": level, "rise": rise, "velocity": 0.5}
    friction = Added(effects.StribeckFriction(), "position", values, {**values, "level": error}, "")
    complete = replace(answer, added=(friction,), status=Status("complete", ""), in_sample=False)
    assert leaves_open(complete) == doubted


@pytest.mark.parametrize(("in_product", "doubted"), [(True, True), (False, False)])
def test_a_bent_input_that_multiplies_others_may_stand_for_a_term_of_its_own(in_product, doubted):
    def spring(t, x, u, p):
        factor = x.y[0] if in_product else 1.0
        return p.k * u * factor - x.y[0] - x.y[1]

    plant = eoi.Plant(spring, {"k": 1.0}, 2, inputs=("force",), outputs=("position",))
    answer = discovery()
    bent = Added(effects.InputQuadratic(), "force", {}, {}, "")
    answer = replace(answer, declared=replace(answer.declared, nominal=plant), added=(bent,))
    assert leaves_open(replace(answer, status=Status("complete", ""), in_sample=False)) == doubted


@pytest.mark.parametrize("in_sample", [False, True])
def test_a_model_without_an_estimate_is_searched_in_free_runs_where_records_are_held_out(in_sample):
    """Where noise hides the motion from the passes, free runs may show it."""
    hidden = replace(discovery(), status=Status("no_data", ""), added=(), in_sample=in_sample)
    assert leaves_open(hidden) != in_sample


@pytest.mark.parametrize(("larger", "contradicts"), [(0.9, False), (1.9, False), (27.0, True)])
def test_an_answer_that_leaves_far_more_of_the_injection_contradicts_it(larger, contradicts):
    justified = discovery()
    fit = replace(justified.found, index=larger * np.asarray(justified.found.index))
    assert contradicts_injection(replace(justified, found=fit), justified) is contradicts


def test_whole_runs_tell_more_than_windows_that_score_few_of_their_samples(found):
    whole, windows = found.after, found.windows_after
    assert telling_runs(found) is windows
    few = replace(windows, scored=whole.scored // 3)
    assert telling_runs(replace(found, windows_after=few)) is whole
    assert telling_runs(replace(found, windows_after=None)) is whole
