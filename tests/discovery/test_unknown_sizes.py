"""A set that explains the injection is no answer where the records do not tell its size."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from found import DECLARED, HELD_OUT, PLACED, discovery
from scipy.integrate import solve_ivp

import eoi_jax as eoi
from eoi_jax.discovery import in_injection
from eoi_jax.discovery.additions import disturbance_notes, fit_notes, gap_notes, sign_notes
from eoi_jax.discovery.result import Added
from eoi_jax.discovery.task import Task
from eoi_jax.estimation.covariance import computed
from eoi_jax.estimation.preparation import prepare_records

H = 0.02
NOMINAL = {"gain": 12.0, "stiffness": 40.0, "damping": 1.0}


def swing(t, x, u, p):
    return p.gain * u - p.stiffness * jnp.sin(x.y[0]) - p.damping * x.y[1]


def record(draw: np.random.Generator, truth: dict, noise: float, samples: int) -> eoi.Record:
    """Of a pendulum under steps of its drive, with noise and, by chance, a coarse sensor."""
    each = int(draw.integers(8, 40))
    u = np.repeat(draw.uniform(-2.0, 2.0, samples // each + 2), each)[:samples]

    def rate(t, x):
        drive = truth["gain"] * u[min(int(t / H + 1e-9), samples - 1)]
        return x[1], drive - truth["stiffness"] * np.sin(x[0]) - truth["damping"] * x[1]

    t = H * np.arange(samples)
    y = solve_ivp(rate, (0.0, t[-1]), (0.0, 0.0), t_eval=t, max_step=H, rtol=1e-7).y[0]
    y = y + noise * np.std(y) * draw.standard_normal(samples)
    if draw.random() < 0.5:
        step = np.std(y) / draw.uniform(10, 60)
        y = np.round(y / step) * step
    return eoi.Record(t, u, y, units={"y": "rad", "u": "V"})


@pytest.mark.slow
def test_short_noisy_records_of_a_right_model_name_nothing():
    # A sinusoid near the cut-off and a ripple of unknown size took all of the injection.
    draw = np.random.default_rng(18)
    truth = {key: value * np.exp(draw.uniform(-0.4, 0.4)) for key, value in NOMINAL.items()}
    draw.choice(["zero", "linear"])
    noise = 10 ** draw.uniform(-2.3, -0.9)
    samples, count = int(draw.integers(60, 320)), int(draw.integers(1, 4))
    fit = [record(draw, truth, noise, samples) for _ in range(count)]
    held = record(draw, truth, noise, int(draw.integers(60, 200)))
    plant = eoi.Plant(swing, NOMINAL, 2, units={"y": "rad", "u": "V"})
    assert eoi.discover(plant, fit, validation=held).effects == ()


def test_a_constant_of_the_sensor_is_told_beside_a_constant_force():
    """An offset of -0.1 m/s² on a spring of 10 1/s² is a zero that is off by -0.01 m."""
    answer = discovery()
    values = answer.found.parameters
    zero = values["constant_offset"] / (values["spring"] / values["mass"])
    (note,) = disturbance_notes(answer.found, answer.added)
    assert note == (
        f"a zero of the sensor of position that is off by {zero:.3g} m does the same as "
        "constant_offset: the records do not tell which"
    )
    assert disturbance_notes(answer.found, ()) == []


@pytest.mark.parametrize(("share", "said"), [(0.9, 1), (1.0, 0)])
def test_the_stiffness_within_a_gap_is_told_where_it_is_one(share, said):
    """A mount between two stops; of a play that stiffness is zero."""
    fit = discovery().found
    spring, mass = fit.parameters["spring"], fit.parameters["mass"]
    values = {"free_play_stiffness": share * spring / mass, "free_play_gap": 0.02}
    play = eoi.effects.FreePlay()
    added = Added(play, "position", values, dict.fromkeys(values, 1e-4), play.sentence)
    notes = gap_notes(DECLARED, [added], fit)
    assert len(notes) == said
    start = (
        f"spring = {spring:.4g} N/m is the stiffness beyond the gap of free_play: within ±0.02 m"
    )
    assert all(note.startswith(f"{start} it is {0.1 * spring:.4g} N/m.") for note in notes)
    joined = replace(added, effect=eoi.effects.LinearStiffness())
    assert gap_notes(DECLARED, [added, joined], fit) == []


@pytest.mark.parametrize(
    ("errors", "fixed", "said"),
    [(-10.0, (), 1), (-1.0, (), 0), (10.0, (), 0), (-10.0, ("spring",), 0)],
)
def test_a_parameter_that_came_out_with_the_other_sign_is_told(errors, fixed, said):
    """Of those that are estimated, and by more than their standard errors."""
    fit = discovery().found
    value = errors * fit.standard_errors["spring"]
    turned = replace(fit, parameters={**fit.parameters, "spring": value})
    notes = sign_notes(fit.nominal.declared_anew(fixed=fixed), turned)
    assert len(notes) == said
    assert all(note.startswith(f"spring is {value:.3g}") for note in notes)


@pytest.mark.parametrize(
    ("value", "error", "fixed", "said"),
    [(-5e38, 1e73, (), 1), (5e38, 1e73, (), 1), (3.0, 40.0, (), 1), (0.1, 1.0, (), 0),
     (-0.1, 1.0, (), 0), (20.0, 15.0, (), 0), (20.0, np.nan, (), 0), (5e38, 1e73, ("spring",), 0)],
)  # fmt: skip
def test_a_parameter_of_which_not_even_the_magnitude_is_told_is_said_so(value, error, fixed, said):
    """Its nominal value is 15: one near zero with a standard error of 1 is told to be small."""
    fit = discovery().found
    certainty = computed(fit.certainty)
    errors = {**certainty.standard_errors, "spring": error}
    changed = replace(
        fit, parameters={**fit.parameters, "spring": value},
        certainty=replace(certainty, standard_errors=errors),
    )  # fmt: skip
    assert changed.standard_errors["spring"] is error
    plant = fit.nominal.declared_anew(fixed=fixed)
    notes = [note for note in fit_notes(plant, (), changed) if "do not tell" in note]
    assert len(notes) == said
    assert all(f"spring: it is {value:.3g} with" in note for note in notes)


@pytest.mark.parametrize(
    ("before", "error", "leads"), [(2.0, None, True), (0.5, None, False), (2.0, np.nan, False)]
)
def test_a_lead_improves_on_the_errors_before_and_has_effects_of_known_size(
    monkeypatch, before, error, leads
):
    """The declared model may be refined after the rounds; a delay of zero has no standard error."""
    answer, placed = discovery(), PLACED[:1]
    certainty = computed(answer.found.certainty)
    errors = dict(certainty.standard_errors)
    errors |= {} if error is None else dict.fromkeys(placed[0].names, error)
    fit = replace(answer.found, certainty=replace(certainty, standard_errors=errors))
    assert answer.after is not None
    assert answer.windows_after is not None
    runs = (replace(run, rmse=before * run.rmse) for run in (answer.after, answer.windows_after))
    long_runs, short_runs = runs
    answer = replace(answer, before=long_runs, windows_before=short_runs)
    records = answer.declared.records
    task = Task(DECLARED, prepare_records(DECLARED, records), records, (HELD_OUT,), (),
                answer.declared, 1e-3, 2, None)  # fmt: skip
    monkeypatch.setattr(in_injection, "refitted", lambda *_: (fit, ()))
    monkeypatch.setattr(in_injection, "explained", lambda *_: (0.4, 0.5, False))
    lead = in_injection._lead(task, [in_injection.Step(fit.plant, placed, ())], (), answer)
    assert (lead is not None) is leads
    if lead is not None:
        assert lead.after is not None
        assert before * lead.after.rmse == pytest.approx(long_runs.rmse)
