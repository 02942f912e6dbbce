"""Curves of a signal, where what is missing is no law of the library."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import eoi_jax as eoi
from eoi_jax.discovery import curves
from eoi_jax.discovery.curves import misses_a_law
from eoi_jax.discovery.free_run_trials import Search
from eoi_jax.discovery.judge import Judge, Judged
from eoi_jax.discovery.result import Added
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.effects import Curve, InputCurve, InternalOverflow, standard, wider
from eoi_jax.models.effects.effect import At
from eoi_jax.refinement.refine import refine_once
from eoi_jax.simulation.validate import judged_runs

PERIOD, COUNT, EACH = 0.05, 3000, 15
NOISE = 1e-3


def heated(t, x, u, p):
    return -p.a * x.y[0] + p.b * u


def softly(t, x, u):
    return [2.0 * np.tanh(0.5 * u) - 0.8 * x[0]]


HEATER = eoi.Plant(heated, {"a": 0.8, "b": 1.0}, 1, inputs=("u",), outputs=("y",))


def measured(rate, seed):
    """Steps of random height, simulated by SciPy from step to step; noise on the output."""
    random = np.random.default_rng(seed)
    heights = random.uniform(-6.0, 6.0, COUNT // EACH)
    x, outputs = np.zeros(1), []
    for u in heights:
        grid = PERIOD * np.arange(EACH + 1)
        run = solve_ivp(rate, (0.0, grid[-1]), x, t_eval=grid, args=(u,), rtol=1e-9, atol=1e-10)
        outputs.append(run.y[0, :-1])
        x = run.y[:, -1]
    y = np.concatenate(outputs)
    y += NOISE * np.std(y) * random.standard_normal(COUNT)
    return eoi.Record(PERIOD * np.arange(COUNT), np.repeat(heights, EACH), y, f"seed {seed}",
                      hold="zero", input_names=("u",), output_names=("y",))  # fmt: skip


def over_noise(found):
    record = found.held_out[0]
    return float(found.windows_after.rmse[0]) / (NOISE * np.std(record.outputs))


def found_of(rate):
    return eoi.discover(HEATER, measured(rate, 1), measured(rate, 2))


@pytest.fixture(scope="module")
def soft():
    """An amplifier that saturates softly: no clip, though near to it."""
    return found_of(softly)


@pytest.mark.slow
@pytest.mark.long
def test_soft_saturation_is_a_curve_of_the_input(soft):
    assert soft.effects == ("input_curve",)
    assert over_noise(soft) < 1.5
    assert any("nearest to input saturation" in note for note in soft.notes)


@pytest.mark.slow
@pytest.mark.long
def test_curve_has_the_shape_of_what_is_missing(soft):
    (added,) = soft.added
    u = np.linspace(-5.5, 5.5, 45)
    changed = np.asarray(added.effect.changed(at_input(u), list(added.parameters.values())))
    through = soft.plant.parameters["b"] * changed
    np.testing.assert_allclose(through, 2.0 * np.tanh(0.5 * u), atol=0.03)


@pytest.mark.slow
@pytest.mark.long
def test_a_curve_that_the_final_fit_does_not_tell_is_not_kept(soft, monkeypatch):
    monkeypatch.setattr(curves, "tells_its_curve", lambda model: False)
    found = found_of(softly)
    assert soft.effects == ("input_curve",)
    assert "input_curve" not in found.effects


def steadily(t, x, u):
    return [u - 0.8 * x[0]]


@pytest.mark.parametrize(("rate", "told"), [(softly, True), (steadily, False)])
def test_a_curve_is_told_where_some_parameter_of_it_is_known_to_half_its_value(rate, told):
    """Of a heater that lacks none every parameter is noise."""
    placed = place(HEATER, InputCurve((-6.0, -2.0, 2.0, 6.0)), 0)
    plant = augmented(HEATER, [placed], dict.fromkeys(placed.names, 0.0))
    fit = refine_once(plant, (measured(rate, 1),), None)
    runs = judged_runs(fit.plant, measured(rate, 2)), None
    assert curves.tells_its_curve(Judged(fit, (placed,), runs)) is told
    assert curves.tells_its_curve(Judged(fit, (), runs))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("contradicted", "confirmed"), [(False, True), (True, True), (False, False)]
)
def test_a_curve_takes_the_place_of_an_answer_only_where_both_detectors_let_it(
    soft, monkeypatch, contradicted, confirmed
):
    """Dry friction with an offset (emps): a curve misses less, and leaves more of the injection."""
    shape = place(HEATER, InputCurve((-6.0, -4.0, -2.0, 2.0, 4.0, 6.0)), 0)

    def best(search, *others):
        del others
        return curves._fitted(search, search.base, shape)

    monkeypatch.setattr(curves, "_with_best_curve", best)
    monkeypatch.setattr(curves, "contradicts_injection", lambda *answers: contradicted)
    if not confirmed:
        monkeypatch.setattr(curves, "answered", lambda discovery, *others: discovery)
    justified = replace(
        soft, status=eoi.Status("complete", ""), effects=(), added=(),
        plant=soft.declared.plant, after=soft.before, windows_after=soft.windows_before,
    )  # fmt: skip
    answer = curves.with_curves(justified, (measured(softly, 1),), None)
    assert (answer is justified) == (contradicted or not confirmed)


def at_input(u):
    return At(0.0 * u, 0.0 * u, 0.0 * u, u, None)


@pytest.mark.slow
@pytest.mark.long
def test_report_says_what_it_is(soft):
    text = str(soft)
    assert "an actuator whose characteristic is a curve" in text
    assert "with u → u + curve(u)" in text


def test_clip_stays_a_saturation():
    found = found_of(lambda t, x, u: [np.clip(u, -2.5, 2.5) - 0.8 * x[0]])
    assert found.effects == ("input_saturation",)
    assert over_noise(found) < 1.5


@pytest.mark.slow
@pytest.mark.long
def test_curves_are_not_tried_where_nothing_is_left(soft):
    assert not misses_a_law(soft)
    left = replace(soft, windows_after=soft.windows_before)
    assert misses_a_law(left)
    assert not misses_a_law(replace(left, in_sample=True))
    spilled = Added(InternalOverflow(caught=False), "z", {}, {}, "")
    assert not misses_a_law(replace(left, added=(spilled,)))
    assert not misses_a_law(replace(left, status=eoi.Status("nothing_missing", "")))


@pytest.mark.slow
@pytest.mark.long
def test_effects_that_are_asked_for_are_the_only_ones():
    records = (measured(softly, 1), measured(softly, 2))
    found = eoi.discover(HEATER, *records, effects=["input_saturation"])
    assert not any(isinstance(added.effect, Curve | InputCurve) for added in found.added)


def waving(t, x, u):
    return [u - 0.5 * x[0] - 0.6 * np.sin(2.5 * x[0])]


@pytest.mark.slow
@pytest.mark.long
def test_a_curve_of_the_output_is_compared_with_laws_of_a_term_alone():
    # A capacity that changes with the output divides all terms: it is no law of this curve.
    found = found_of(waving)
    assert "curve" in found.effects


@pytest.fixture(scope="module")
def heater():
    """The heater, refined and judged."""
    fit = refine_once(HEATER, (measured(softly, 1),), None)
    return Judged(fit, (), (judged_runs(fit.plant, measured(softly, 2)), None))


def with_effects(model, error, *effects):
    """A model with some effects, and with this mean logarithm of errors."""
    placed = tuple(place(HEATER, effect, 0) for effect in effects)
    run = replace(model.runs[0], nrmse=np.exp([error]))
    return Judged(model.refinement, placed, (run, None))


@pytest.mark.parametrize(("alone", "replaces"), [(-0.1, False), (0.6, True)])
def test_curve_replaces_many_laws_only_where_none_alone_comes_near(
    heater, alone, replaces, monkeypatch
):
    """Of a damper whose force yields the yield law stays, though small effects stand beside it."""
    names = ("input_yield", "actuator_lag", "input_asymmetry")
    laws = [law for law in (*standard(), *wider()) if law.name in names]
    assert len(laws) == 3
    rival = with_effects(heater, -0.4, *laws)
    curve = with_effects(heater, -0.5, InputCurve((-6.0, -2.0, 2.0, 6.0)))
    errors = {"input_yield": alone, "actuator_lag": 1.0, "input_asymmetry": 1.0}

    def with_only(search, placed, model):
        assert model is rival
        return with_effects(heater, errors[placed[0].effect.name], placed[0].effect)

    monkeypatch.setattr(Search, "with_only", with_only)
    judge = Judge.of((measured(softly, 2),), HEATER)
    assert judge is not None
    search = Search((), (), judge, (heater,))
    assert curves._replaces_sum(search, curve, rival) is replaces
