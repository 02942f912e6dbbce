"""A discovered model refined: what only free runs show is found, held-out records judge."""

from dataclasses import replace

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery.refined import Polished, _with_plainer_laws, polished
from eoi_jax.models.augmented import augmented, place
from eoi_jax.simulation.validate import whole_and_windows

TIME = np.arange(6001) * 5e-3
NOISE = 1e-2  # of the output's spread
TRUTH = {"gain": 1.0, "damping": 0.4, "stiffness": 10.0}
HIDDEN = {"cubic_stiffness": 8.0, "quadratic_drag": 0.05}


def oscillating(t, x, u, p):
    position, rate = x.y
    return p.gain * u - p.damping * rate - p.stiffness * position


PLANT = eoi.Plant(oscillating, {"gain": 1.2, "damping": 0.5, "stiffness": 9.0}, 2, ("u",), ("y",))
EFFECTS = [effects.CubicStiffness(), effects.QuadraticDrag()]


def record(hidden, seed, relative=NOISE):
    draw = np.random.default_rng(seed)
    force = np.repeat(draw.normal(size=150), 41)[: len(TIME)] + np.sin(2.0 * TIME)
    placed = [place(PLANT, one, 0) for one in EFFECTS if one.name in hidden]
    plant = augmented(PLANT.with_parameters(TRUTH), placed, hidden)
    made = eoi.simulate(plant, TIME, force, hold="zero", substeps=2)
    spread = float(np.std(made.outputs))
    noise = relative * spread * draw.standard_normal(made.outputs.shape)
    return eoi.Record(TIME, force, made.outputs + noise, f"run {seed}", hold="zero"), spread


def error(validation):
    assert validation is not None
    return validation.rmse[0]


@pytest.fixture(scope="module")
def fit():
    return record(HIDDEN, 1)[0]


@pytest.fixture(scope="module")
def held():
    return record(HIDDEN, 2)


@pytest.fixture(scope="module")
def refined(fit, held):
    return eoi.discover(PLANT, fit, validation=held[0], refine=True)


@pytest.mark.slow
@pytest.mark.long
def test_a_drag_that_the_injection_does_not_show_is_found_in_the_free_run(fit, held, refined):
    alone = eoi.discover(PLANT, fit, validation=held[0])
    assert alone.effects == ("cubic_stiffness",)
    assert refined.effects == ("cubic_stiffness", "quadratic_drag")
    assert "found in the free run alone: quadratic drag" in refined.notes
    noise = NOISE * held[1]
    assert error(alone.after) > 1.5 * noise
    assert error(refined.after) == pytest.approx(noise, rel=0.02)
    assert error(refined.windows_after) < error(alone.windows_after)
    assert error(refined.before) == error(alone.before)


@pytest.mark.slow
@pytest.mark.long
def test_parameters_and_errors_are_those_of_the_refinement(refined):
    for name, value in (TRUTH | HIDDEN).items():
        spread = refined.found.standard_errors[name]
        assert abs(refined.found.parameters[name] - value) < 4.0 * spread
        assert spread < 0.3 * abs(value)
    assert refined.plant.parameters == refined.found.parameters
    told = {name: value for one in refined.added for name, value in one.parameters.items()}
    assert told == {name: refined.found.parameters[name] for name in HIDDEN}
    assert "quadratic_drag" in refined.equation
    assert "drag that grows with the square of the velocity" in str(refined)


@pytest.mark.slow
@pytest.mark.long
def test_what_is_refined_is_saved_and_read_back(refined, tmp_path):
    refined.save(tmp_path / "found.npz")
    again = eoi.load(tmp_path / "found.npz")
    assert again.effects == refined.effects
    assert again.found.parameters == refined.found.parameters


@pytest.mark.slow
@pytest.mark.long
def test_free_runs_extend_what_explains_the_injection_where_more_than_noise_is_left():
    hidden = {"cubic_stiffness": 8.0, "quadratic_drag": 0.02}
    (fit, _), (held, spread) = record(hidden, 1, 1e-3), record(hidden, 2, 1e-3)
    found = eoi.discover(PLANT, fit, validation=held)
    assert (found.status.code, found.effects) == (
        "complete",
        ("cubic_stiffness", "quadratic_drag"),
    )
    assert any(note.startswith("quadratic_drag found in free runs") for note in found.notes)
    assert error(found.after) < 1.5e-3 * spread
    assert error(found.windows_after) < 1.5e-3 * spread
    drag = found.plant.parameters["quadratic_drag"]
    assert abs(drag - 0.02) < 4.0 * found.found.standard_errors["quadratic_drag"]
    for whole, short in ((found.before, found.windows_before), (found.after, found.windows_after)):
        assert whole is not None
        assert short is not None
        assert (whole.window, short.window) == (None, 3.0)


def test_what_explains_down_to_the_noise_is_not_extended():
    hidden = {"cubic_stiffness": 8.0}
    (fit, _), (held, _) = record(hidden, 1, 1e-3), record(hidden, 2, 1e-3)
    found = eoi.discover(PLANT, fit, validation=held)
    assert found.effects == ("cubic_stiffness",)
    assert not any("free runs" in note for note in found.notes)


@pytest.mark.slow
@pytest.mark.long
def test_nothing_is_added_where_nothing_else_is_missing():
    hidden = {"cubic_stiffness": 8.0}
    fit, held = record(hidden, 3)[0], record(hidden, 4)
    found = eoi.discover(PLANT, fit, validation=held[0], refine=True)
    assert found.effects == ("cubic_stiffness",)
    assert any(note.startswith("refined: converged") for note in found.notes)
    assert error(found.after) == pytest.approx(NOISE * held[1], rel=0.02)


@pytest.mark.slow
@pytest.mark.long
def test_what_only_free_runs_show_is_an_answer_where_the_injection_shows_nothing():
    hidden = {"quadratic_drag": 0.02}
    fit, held = record(hidden, 5)[0], record(hidden, 6)
    assert eoi.discover(PLANT, fit, validation=held[0]).status.code == "nothing_missing"
    found = eoi.discover(PLANT, fit, validation=held[0], refine=True)
    assert found.effects == ("quadratic_drag",)
    assert found.status.code == "complete"
    assert str(found).startswith("The model lacks drag that grows with the square of the velocity")
    assert NOISE * held[1] < error(found.after) < 1.05 * NOISE * held[1]


def rolling(t, x, u, p):
    return (u - p.friction * x.y[1]) / p.mass


@pytest.mark.slow
@pytest.mark.long
def test_short_runs_take_the_place_of_whole_ones_where_a_drift_bends_these():
    """A slow force that is in no record: its effect on an integrating plant adds up."""
    true = eoi.Plant(rolling, {"mass": 2.0, "friction": 1.0}, 2, ("u",), ("y",))
    fit, held = (rolled(true, seed, push) for seed, push in ((1, 0.05), (2, 0.0)))
    whole, _ = whole_and_windows(true, [held], None)
    loose = replace(whole, rmse=1e5 * whole.rmse), None
    start = true.with_parameters({"mass": 2.2, "friction": 0.9})
    answer = polished(start, [fit], [held], loose, 2.0, [effects.QuadraticDrag()])
    assert not isinstance(answer, str)
    assert answer.refinement.window == 2.0
    bent = whole_and_windows(eoi.refine(start, fit).plant, [held], 2.0)
    for short, long in zip(answer.runs, bent, strict=True):
        assert error(short) < 0.8 * error(long)


def rolled(plant, seed, push):
    draw = np.random.default_rng(seed)
    force = eoi.excitation.multisine(TIME, 1.0, (0.1, 2.0), 16, seed=seed)
    slow = np.convolve(draw.standard_normal(len(TIME) + 800), np.hanning(801), "valid")
    made = eoi.simulate(plant, TIME, force + push * slow / np.std(slow), hold="linear")
    noise = 1e-5 * draw.standard_normal(made.outputs.shape)
    return eoi.Record(TIME, force, made.outputs + noise, f"run {seed}", hold="linear")


@pytest.mark.parametrize(("rise", "kept"), [(0.0, "coulomb_friction"), (0.6, "stribeck_friction")])
def test_a_law_that_another_contains_takes_its_place_where_it_is_as_good(rise, kept):
    wide = place(PLANT, effects.StribeckFriction(), 0)
    hidden = dict(zip(wide.names, (0.3, rise, 0.3), strict=True))
    true = augmented(PLANT.with_parameters(TRUTH), (wide,), hidden)
    draw, time = np.random.default_rng(1), TIME[:1500]
    force = np.repeat(3.0 * draw.normal(size=40), 41)[: len(time)] + np.sin(2.0 * time)
    clean = eoi.simulate(true, time, force, hold="zero", substeps=4)
    outputs = clean.outputs + 1e-3 * draw.standard_normal(clean.outputs.shape)
    data = eoi.Record(time, force, outputs, hold="zero")
    start = augmented(PLANT, (wide,), dict(zip(wide.names, (0.3, 0.1, 0.3), strict=True)))
    fit = eoi.refine(start, data)
    model = Polished(fit, (wide,), whole_and_windows(fit.plant, (data,), None))
    plain = _with_plainer_laws(model, PLANT, (data,), (data,), None)
    assert [item.effect.name for item in plain.placed] == [kept]
    assert (plain is model) is (rise > 0.0)


def test_what_makes_free_runs_worse_is_refused_and_said(fit, held):
    runs = whole_and_windows(PLANT, [held[0]], None)
    perfect = replace(runs[0], rmse=1e-9 * runs[0].rmse), None
    answer = polished(PLANT, [fit], [held[0]], perfect, None, [effects.QuadraticDrag()])
    assert answer == "not refined: that makes free runs worse on the records that judge"


def test_a_refinement_without_an_answer_is_said(held):
    one = held[0]
    masked = eoi.Record(one.time, one.inputs, one.outputs, burn_in=one.time[-1] + 1.0)
    runs = whole_and_windows(PLANT, [held[0]], None)
    answer = polished(PLANT, [masked], [held[0]], runs, None)
    assert isinstance(answer, str)
    assert answer.startswith("not refined: no_data")


def test_an_unexplained_residual_gets_no_effect_though_the_model_is_refined():
    hidden = {"cubic_stiffness": 400.0}
    fit, held = record(hidden, 1)[0], record(hidden, 2)
    found = eoi.discover(PLANT, fit, validation=held[0], effects=["constant_offset"], refine=True)
    assert found.status.code == "unexplained"
    assert found.effects == ()
    assert found.after is not None
    assert found.before is not None
    assert found.after.rmse[0] <= found.before.rmse[0]


def van_der_pol(t, x, u, p):
    position, rate = x.y
    return p.mu * (1.0 - position**2) * rate - p.stiffness * position


def orbit(start, seed, noise, plant, step=0.05):
    time = step * np.arange(600)
    made = eoi.simulate(plant, time, np.zeros((600, 0)), start, substeps=4)
    error = noise * np.random.default_rng(seed).standard_normal(made.outputs.shape)
    return eoi.Record(time, np.zeros((600, 0)), made.outputs + error, f"run {seed}")


def test_an_answer_that_nothing_is_missing_has_the_parameters_of_free_runs():
    declared = eoi.Plant(van_der_pol, {"mu": 1.0, "stiffness": 3.0}, 2, (), ("y",))
    values = {"mu": 1.5, "stiffness": 4.0}
    truth, starts = declared.with_parameters(values), ([1.0, 0.5], [-0.5, 1.5], [1.5, -1.0])
    *fit, held = (orbit(start, seed, NOISE, truth) for seed, start in enumerate(starts))
    found = eoi.discover(declared, fit, validation=held)
    assert found.status.code == "nothing_missing"
    assert any("may bias the passes" in note for note in found.notes)
    assert found.plant.parameters == found.found.parameters
    assert error(found.after) < 1.1 * NOISE < error(found.before)
    for name, value in values.items():
        passes, answer = (
            abs(one.parameters[name] - value) / one.standard_errors[name]
            for one in (found.declared, found.found)
        )
        assert answer < 4.0 < passes


def test_passes_without_bias_stay_the_answer():
    fit, held = (record({}, seed)[0] for seed in (1, 2))
    found = eoi.discover(PLANT, fit, validation=held)
    assert found.status.code == "nothing_missing"
    assert found.found is found.declared
    assert not any("may bias the passes" in note for note in found.notes)


@pytest.mark.filterwarnings("ignore::eoi_jax.RecordWarning")  # stamps are far and unevenly apart
def test_what_passes_over_few_samples_hardly_tell_free_runs_tell():
    true = {"absorption": 1.2, "loss": 0.2, "volume": 30.0}
    time = np.unique(np.r_[0.0, np.round(np.geomspace(0.25, 24.0, 24) * 4.0) / 4.0])
    declared = eoi.plant_from_text(
        {"amount": "-absorption*amount", "level": "absorption*amount/volume - loss*level"},
        {"absorption": 2.0, "loss": 0.1, "volume": 20.0}, outputs=["level"],
        initial={"amount": 100.0, "level": 0.0},
    )  # fmt: skip
    level = 100.0 / 30.0 * 1.2 / (1.2 - 0.2) * (np.exp(-0.2 * time) - np.exp(-1.2 * time))
    *fit, held = (sampled(time, level, 2160 + seed) for seed in range(5))
    found = eoi.discover(declared, fit, validation=held)
    assert found.status.code == "nothing_missing"
    for name, value in true.items():
        assert abs(found.found.parameters[name] - value) < 4.0 * found.found.standard_errors[name]
    volume = [one.standard_errors["volume"] for one in (found.declared, found.found)]
    assert volume[1] < 0.2 * volume[0]
    assert error(found.after) < 0.5 * error(found.before)


def sampled(time, level, seed):
    values = level * np.exp(0.05 * np.random.default_rng(seed).standard_normal(len(time)))
    return eoi.Record(time, np.zeros((len(time), 0)), values, f"run {seed}", output_names=["level"])
