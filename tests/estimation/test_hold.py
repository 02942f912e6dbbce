"""Holds of inputs that no record declares are decided by the fit."""

import numpy as np
import pytest
from report_runs import job
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import eoi_jax as eoi
from eoi_jax.cli.summary import identification_summary
from eoi_jax.data.holds import SETTINGS, best_hold, evidence, undeclared_hold, with_hold

PERIOD = 0.05
TRUTH = {"k": 40.0, "c": 1.5, "g": 30.0}
MASS = eoi.Plant(
    lambda t, x, u, p: -p.k * x.y[0] - p.c * x.y[1] + p.g * u[0],
    {"k": 35.0, "c": 1.0, "g": 25.0}, 2,
)  # fmt: skip


def every_step_another(count, seed):
    """A converter that gets a new value at each sample: nothing in it looks held."""
    steps = np.random.default_rng(seed).standard_normal(count)
    return np.convolve(steps, np.ones(4) / 4, "same")


def held(count=1500, seed=0, noise=1e-3, cubic=0.0, **options):
    """Driven by a converter: exact over each step, SciPy where the spring is not linear."""
    u = every_step_another(count, seed)
    block = np.array([[0.0, 1.0, 0.0], [-TRUTH["k"], -TRUTH["c"], TRUTH["g"]], [0.0, 0.0, 0.0]])
    step, x, y = expm(PERIOD * block)[:2], np.zeros(2), np.zeros(count)
    for k in range(count):
        y[k] = x[0]
        if cubic:
            force = lambda t, s, v=u[k]: [  # noqa: E731
                s[1], -TRUTH["k"] * s[0] - cubic * s[0] ** 3 - TRUTH["c"] * s[1] + TRUTH["g"] * v,
            ]  # fmt: skip
            x = solve_ivp(force, (0.0, PERIOD), x, rtol=1e-9, atol=1e-10).y[:, -1]
        else:
            x = step @ [*x, u[k]]
    y += noise * np.std(y) * np.random.default_rng(seed + 100).standard_normal(count)
    return eoi.Record.from_period(PERIOD, u, y, **options)


def continuous(count=1500, seed=0, noise=1e-3):
    """Driven by a sum of sines that goes on between the samples."""
    rng = np.random.default_rng(seed)
    w, phase = rng.uniform(1.0, 20.0, 8), rng.uniform(0.0, 6.0, 8)
    time = PERIOD * np.arange(count)
    response = TRUTH["g"] / (TRUTH["k"] - w**2 + 1j * w * TRUTH["c"])
    u = np.sum(np.sin(np.outer(time, w) + phase), axis=1)
    y = np.sum(np.imag(response * np.exp(1j * (np.outer(time, w) + phase))), axis=1)
    y += noise * np.std(y) * rng.standard_normal(count)
    return eoi.Record.from_period(PERIOD, u, y)


def test_the_samples_alone_suggest_the_wrong_hold_here():
    record = held()
    assert (record.hold, record.hold_declared) == ("linear", False)
    assert held(hold="linear").hold_declared


def test_a_record_keeps_what_its_caller_declared():
    declared, undeclared = held(hold="linear"), held()
    changed = with_hold([declared, undeclared], "zero")
    assert [record.hold for record in changed] == ["linear", "zero"]
    assert all(record.hold_declared for record in changed)
    np.testing.assert_array_equal(changed[1].outputs, undeclared.outputs)
    assert undeclared_hold([declared]) is None
    assert undeclared_hold([declared, undeclared]) == "linear"
    assert undeclared_hold([held().without_inputs()]) is None


def test_an_interpolated_record_follows_its_hold():
    """`bridged` is computed once; of another hold it is another record."""
    whole = held()
    y = whole.outputs.copy()
    y[700:703] = np.nan
    with pytest.warns(eoi.RecordWarning):
        record = eoi.Record(whole.time, whole.inputs, y)
    assert record.bridged.hold == "linear"
    assert record.with_hold("zero").bridged.hold == "zero"


def test_another_hold_must_be_clearly_better():
    assert best_hold({"zero": 0.5, "linear": 1.0, "smooth": 0.9}, "linear") == "zero"
    assert best_hold({"zero": 0.995, "linear": 1.0, "smooth": 1.0}, "linear") == "linear"


def test_without_an_error_there_is_no_ratio():
    assert evidence("the error", {"zero": 0.0, "linear": 1.0}, "zero") == ()
    assert evidence("the error", {"zero": 0.5, "linear": 1.0, "smooth": 2.0}, "zero") == (
        "hold zero: the error is 2 times as large with linear, 4 times as large with smooth",
    )


@pytest.mark.parametrize(("made", "hold"), [(held, "zero"), (continuous, "smooth")])
def test_identify_finds_how_the_record_was_made(made, hold):
    found = eoi.identify(MASS, made())
    assert found.reasons[0].startswith(f"hold {hold}: the index is ")
    for name, value in TRUTH.items():
        assert found.parameters[name] == pytest.approx(value, rel=0.01)


@pytest.mark.parametrize(("made", "hold"), [(held, "zero"), (continuous, "smooth")])
def test_refine_and_validate_find_it_too(made, hold):
    found = eoi.refine(MASS, made())
    assert any(note.startswith(f"hold {hold}: the error is ") for note in found.notes)
    for name, value in TRUTH.items():
        assert abs(found.parameters[name] - value) < 4.0 * found.standard_errors[name]
    run = eoi.validate(MASS.with_parameters(TRUTH), made(seed=5))
    assert any(note.startswith(f"hold {hold}: the error is ") for note in run.notes)
    assert run.nrmse[0] < 1.1e-3


def test_half_a_sample_of_delay_is_no_effect():
    found = eoi.discover(MASS, held(), held(seed=1))
    assert (found.effects, found.status.code) == ((), "nothing_missing")
    assert found.notes[0].startswith("hold zero: the index")


@pytest.mark.slow
@pytest.mark.long
def test_a_hidden_effect_is_named_though_it_hides_the_hold():
    found = eoi.discover(MASS, held(cubic=30.0), held(cubic=30.0, seed=1))
    assert found.effects == ("cubic_stiffness",)
    assert found.plant.parameters["cubic_stiffness"] == pytest.approx(30.0, rel=0.05)
    assert found.notes[0].startswith("hold zero: the index of the final model is ")


def without_noise() -> eoi.Record:
    """A pendulum whose input jumps while dry friction holds it, in steps that do not count."""
    rig = eoi.plants.pendulum().with_parameters({"a": 81.0, "b": 1.7, "c": 0.3, "d": 99.0})
    time = 1e-3 * np.arange(22_000)
    run = eoi.simulate(rig, time, eoi.excitation.square(time, 0.2, 0.1))
    assert run.hold_declared
    return eoi.Record(time, run.inputs, run.outputs, input_names=rig.inputs,
                      output_names=rig.outputs)  # fmt: skip


def test_errors_of_the_discretisation_tell_no_hold():
    found = eoi.identify(eoi.plants.pendulum(), without_noise())
    assert found.unexplained[0] < SETTINGS.numerical
    assert found.records[0].hold == "zero"
    same = "hold zero: the index is the same within 2 % with the others"
    assert found.reasons[0] == same


@pytest.mark.slow
def test_nothing_is_missing_in_an_exact_simulation():
    found = eoi.discover(eoi.plants.pendulum(), without_noise())
    assert found.status.code == "nothing_missing"
    assert found.found.records[0].hold == "zero"


def test_a_declared_hold_is_used_as_declared():
    found = eoi.identify(MASS, held(hold="linear"), smoothing=False)
    assert not any(reason.startswith("hold ") for reason in found.reasons)
    assert {record.hold for record in found.records} == {"linear"}


# -- channels that a logger reads one after another -----------------------------------------------


def apart(samples, count=1500, seed=0, noise=1e-3, hold="zero"):
    """Outputs read a part of a sample after the inputs (before, where negative); exact."""
    u = every_step_another(count, seed)
    block = np.array([[0.0, 1.0, 0.0], [-TRUTH["k"], -TRUTH["c"], TRUTH["g"]], [0.0, 0.0, 0.0]])
    early = samples % 1.0  # since the last change of the input
    step, part = expm(PERIOD * block)[:2], expm(PERIOD * early * block)[:2]
    x, y = np.zeros(2), np.zeros(count)
    for k in range(count):
        y[k] = (part @ [*x, u[k]])[0]
        x = step @ [*x, u[k]]
    whole = int(np.floor(samples))
    y = np.roll(y, -whole)[: count - abs(whole)] if whole >= 0 else y[:whole]
    u = u[: len(y)] if whole >= 0 else u[-whole:]
    y = y + noise * np.std(y) * np.random.default_rng(seed + 100).standard_normal(len(y))
    return eoi.Record.from_period(PERIOD, u, y, hold="auto")


@pytest.mark.parametrize(("samples", "told"), [(0.5, ""), (0.3, "lags"), (-0.5, "leads")])
def test_inputs_and_outputs_that_are_logged_apart_do_not_bias_the_estimate(samples, told):
    """Held and read half a sample later is nearly what goes on between the samples."""
    found = eoi.identify(MASS, apart(samples))
    for name, value in TRUTH.items():
        assert found.parameters[name] == pytest.approx(value, rel=0.005)
    assert any(f"u {told}" in reason for reason in found.reasons) == bool(told)


def test_a_result_is_validated_on_records_made_like_those_of_its_fit():
    found, third = eoi.identify(MASS, apart(-0.5)), apart(-0.5, seed=2)
    noise = 1e-3 * np.std(third.outputs)
    made_alike, as_read = eoi.validate(found, third), eoi.validate(found.plant, third)
    assert made_alike.rmse[0] == pytest.approx(noise, rel=0.1)
    assert as_read.rmse[0] > 3.0 * noise
    assert made_alike.records[0].skew[0] == pytest.approx(0.5 * PERIOD, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("samples", [0.5, -0.5])
def test_a_skew_of_the_channels_is_no_effect(samples):
    found = eoi.discover(MASS, apart(samples), apart(samples, seed=1))
    assert (found.effects, found.status.code) == ((), "nothing_missing")
    assert any("the outputs by " in note for note in found.notes) == (samples < 0)
    if samples < 0:
        (held_out,) = found.held_out
        assert held_out.skew[0] == pytest.approx(-samples * PERIOD, rel=0.02)


@pytest.mark.slow
@pytest.mark.long
def test_a_delay_of_many_samples_is_one_of_the_plant():
    late = apart(-4.0)
    found = eoi.identify(MASS, late)
    assert not any("in the log" in reason for reason in found.reasons)
    assert eoi.discover(MASS, late, apart(-4.0, seed=1)).effects == ("input_delay",)


def test_shifted_inputs_are_those_of_the_shifted_signal():
    time = 0.1 * np.arange(200)
    record = eoi.Record(time, np.sin(time), np.cos(time), hold="smooth")
    moved = record.with_delayed_inputs([0.03])
    np.testing.assert_array_equal(moved.inputs, record.inputs)  # as they were logged
    fine = moved.resample(4)
    np.testing.assert_allclose(fine.inputs[20:-20, 0], np.sin(fine.time - 0.03)[20:-20], atol=1e-7)
    middle = np.sin(time[:-1] + 0.05 - 0.03)
    np.testing.assert_allclose(moved.midpoint_inputs()[5:-5, 0], middle[5:-5], atol=1e-7)
    assert record.with_delayed_inputs([0.0]) is record
    with pytest.raises(ValueError, match="`delays` must hold finite times"):
        record.with_delayed_inputs([np.nan])
    with pytest.raises(ValueError, match="`delays` must hold a time for each of 1 input"):
        record.with_delayed_inputs([0.0, 0.1])


@pytest.mark.parametrize(("delay", "row"), [(0.6, [0.6, 0.4, 0.0]), (-0.25, [0.0, 0.75, 0.25])])
def test_a_held_input_that_is_shifted_keeps_its_mean_over_each_step(delay, row):
    levels = np.random.default_rng(0).standard_normal(50)
    record = eoi.Record.from_period(2.0, levels, np.ones(50), hold="zero")
    moved = record.with_delayed_inputs([2.0 * delay])
    mean = np.convolve(levels, row[::-1], "valid")  # of the level before, this one, the next
    np.testing.assert_allclose(moved.midpoint_inputs()[1:48, 0], mean[:47], rtol=1e-12)
    fine = moved.resample(20).midpoint_inputs()[:, 0].reshape(-1, 20)
    np.testing.assert_allclose(fine.mean(axis=1)[1:48], mean[:47], rtol=1e-12)
    assert len(np.unique(fine[5].round(12))) == 2  # it changes where it does


def test_the_right_hold_is_found_from_a_start_that_needs_many_passes():
    # ẏ = (K u − y)/τ from τ twice too large: after four passes wrong holds are ahead by 5.
    period, tau, gain = 0.02, 0.14, 1.04
    rng = np.random.default_rng(241)
    u = np.repeat(rng.choice([-0.3, -0.15, 0.0, 0.15, 0.3], 50), 50)
    y, decay = np.zeros(len(u)), np.exp(-period / tau)
    for k in range(len(u) - 1):
        y[k + 1] = decay * y[k] + (1.0 - decay) * gain * u[k]
    plant = eoi.Plant(lambda t, x, u, p: (p.K * u - x.y[0]) / p.tau, {"tau": 0.3, "K": 1.0}, 1)
    y += 2e-3 * rng.standard_normal(len(u))
    result = eoi.identify(plant, eoi.Record.from_period(period, u, y))
    assert any(reason.startswith("hold zero") for reason in result.reasons)
    assert result.parameters["tau"] == pytest.approx(tau, rel=0.01)


def test_of_a_constant_input_no_hold_is_tried():
    time = 0.1 * np.arange(200)
    y = np.exp(-time) + 1e-3 * np.random.default_rng(3).standard_normal(200)
    record = eoi.Record(time, np.ones(200), y, input_names=("u",))
    assert undeclared_hold([record]) is None
    plant = eoi.Plant(lambda t, x, u, p: p.b * u[0] - x.y[0], {"b": 0.2}, 1, ("u",), ("y",))
    for fit in (eoi.refine(plant, record), eoi.identify(plant, record)):
        assert not any("hold" in note.lower() for note in fit.notes)


def test_what_samples_suggest_of_a_hold_is_not_told_beside_what_fits():
    record = held()
    assert any(note.startswith("Hold taken as") for note in record.notes)
    fit = eoi.identify(MASS, record)
    assert any(reason.startswith("hold ") for reason in fit.reasons)
    assert not any("Hold taken as" in note for note in fit.notes)
    assert not any("Hold taken as" in note for note in fit.records[0].notes)


def test_a_summary_names_the_hold_of_the_fit():
    records, held_out = [held(seed=1)], [held(seed=2)]
    fit = eoi.identify(MASS, records)
    summary = identification_summary(job(MASS, records, held_out), fit, None)
    for record in summary["records"] + summary["held_out_records"]:
        assert record["hold"] == "zero"
        assert not any("Hold taken as" in note for note in record["notes"])
