"""Free-run validation: known errors, estimated starts, windows, divergence, a measured record."""

from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from eoi_jax import plant_from_text
from eoi_jax._checks import RecordWarning
from eoi_jax.data.record import Record
from eoi_jax.data.windows import plan
from eoi_jax.models.library import (
    Plant,
    cascaded_tanks,
    duffing_oscillator,
    mass_spring_damper,
    pendulum,
    three_mass_spring_damper,
)
from eoi_jax.models.plant import State
from eoi_jax.simulation import planned_runs
from eoi_jax.simulation.chained_runs import Chain
from eoi_jax.simulation.initial_state import _descend, _Heads
from eoi_jax.simulation.integrator import Drive
from eoi_jax.simulation.simulate import simulate
from eoi_jax.simulation.validate import _record, validate, whole_and_windows

TIME = np.arange(1001) * 5e-3
FORCE = np.sin(2.0 * TIME) + np.cos(7.0 * TIME)


def swing(initial=(0.01, -0.05), hold="linear"):
    plant = mass_spring_damper(true=True)
    return simulate(plant, TIME, FORCE, initial, hold=hold, substeps=4, name="swing")


def with_noise(record, size, seed=0):
    noise = size * np.random.default_rng(seed).standard_normal(record.outputs.shape)
    return Record(record.time, record.inputs, record.outputs + noise, record.name, hold=record.hold)


@pytest.mark.parametrize("hold", ["zero", "linear", "smooth"])
def test_true_plant_has_no_error_from_an_unknown_initial_state(hold):
    result = validate(mass_spring_damper(true=True), swing(hold=hold))
    # The plant is linear: one Gauss-Newton step from a polynomial start is exact up to rounding.
    assert result.rmse[0] < 1e-12
    assert result.fit[0] > 100.0 - 1e-6
    assert result.scored == 1001 - 50


def test_rmse_of_the_true_plant_is_the_measurement_noise():
    noisy = with_noise(swing(), 1e-4)
    result = validate(mass_spring_damper(true=True), noisy)
    # 951 samples: the standard deviation of the rms is 2.3 %; the start adds a decaying transient.
    assert result.rmse[0] == pytest.approx(1e-4, rel=0.08)
    residual = noisy.outputs[50:] - result.predictions[0].outputs[50:]
    np.testing.assert_allclose(result.rmse, np.sqrt(np.mean(residual**2, axis=0)), rtol=1e-12)
    spread = np.std(noisy.outputs[50:], axis=0)
    np.testing.assert_allclose(result.nrmse, result.rmse / spread, rtol=1e-12)
    np.testing.assert_allclose(result.fit, 100.0 * (1.0 - result.nrmse), rtol=1e-12)


def test_several_records_are_pooled_sample_by_sample():
    plant = mass_spring_damper()  # nominal: a wrong model
    first, second = swing(), swing((-0.05, 0.3))[:400]
    one, two, both = (validate(plant, case) for case in (first, second, [first, second]))
    squares = one.rmse**2 * one.scored + two.rmse**2 * two.scored
    assert both.scored == one.scored + two.scored
    np.testing.assert_allclose(both.rmse**2 * both.scored, squares, rtol=1e-12)
    assert [len(part) for part in both.predictions] == [1001, 400]


def test_internal_state_at_the_start_is_estimated():
    plant, time = cascaded_tanks(), np.arange(301) * 4.0
    u = 3.0 + np.sin(0.02 * time) + np.sin(0.05 * time)
    record = simulate(plant, time, u, 3.0, internal=[9.0], hold="zero", substeps=4)
    # The model says 5 V; the record started at 9 V.
    assert validate(plant, record).rmse[0] < 1e-9


def test_several_outputs_and_their_velocities_are_estimated():
    plant, time = three_mass_spring_damper(true=True), np.arange(801) * 2e-3
    initial = [[0.01, -0.02, 0.005], [0.1, 0.0, -0.2]]
    record = simulate(plant, time, np.sign(np.sin(9.0 * time)), initial, hold="zero", substeps=4)
    result = validate(plant, record)
    assert result.rmse.shape == (3,)
    assert np.all(result.rmse < 1e-12)


def test_friction_plant_starts_in_motion_and_comes_to_rest():
    plant = pendulum(true=True).with_parameters({"c": 3.0})
    record = simulate(plant, TIME, np.where(TIME < 3, 0.2, 0.0), [0.3, 1.0], substeps=4)
    # Nonlinear in the start: Gauss-Newton ends where the squared error no longer falls.
    assert validate(plant, record).rmse[0] < 1e-8


def test_windows_of_a_wrong_model_err_less_than_one_long_run():
    def drifting(t, x, u, p):
        return p.push * u

    truth = Plant(drifting, {"push": 1.0}, relative_degree=2)
    record = simulate(truth, TIME, FORCE, hold="linear")
    wrong = truth.with_parameters({"push": 1.05})
    long = validate(wrong, record)
    short = validate(wrong, record, window=0.5, initial_samples=20)
    assert short.rmse[0] < 0.1 * long.rmse[0]
    assert np.all(np.isfinite(short.predictions[0].outputs))


def test_every_window_leaves_its_initial_samples_unscored():
    record = swing()
    result = validate(mass_spring_damper(true=True), record, window=1.5, initial_samples=50)
    # 1000 steps in windows of 300 and a rest of 100, which reaches back and scores its 101.
    assert result.scored == 3 * 250 + 101
    assert result.rmse[0] < 1e-12


def test_masked_samples_and_burn_in_are_not_scored():
    y = swing().outputs[:, 0].copy()
    y[300:310] = np.nan
    with pytest.warns(RecordWarning):
        record = Record(TIME, FORCE, y, "holes", hold="linear", burn_in=1.0)
    result = validate(mass_spring_damper(true=True), record)
    assert result.scored == 1001 - 200 - 10
    assert result.rmse[0] < 1e-12


def with_gaps(*gaps: tuple[int, int]) -> Record:
    record = swing()
    y = record.outputs[:, 0].copy()
    for gap in gaps:
        y[slice(*gap)] = np.nan
    with pytest.warns(RecordWarning):
        return Record(TIME, FORCE, y, "gaps", hold="linear")


@pytest.mark.parametrize("masked", [26, 49, 50, 60, 400])
def test_a_run_whose_first_samples_are_masked_starts_behind_them(masked):
    """Started from nothing it would miss the motion by its own size."""
    result = validate(mass_spring_damper(true=True), with_gaps((0, masked)))
    assert result.rmse[0] < 1e-12
    assert result.scored == 1001 - masked - 50
    (note,) = result.notes
    assert note.startswith(f"The free run on gaps starts at t = {5e-3 * masked:g} s")
    assert np.all(result.predictions[0].outputs[:masked] == result.predictions[0].outputs[masked])


def test_a_start_with_half_of_its_samples_stays_where_it_is():
    result = validate(mass_spring_damper(true=True), with_gaps((0, 25)))
    assert result.rmse[0] < 1e-12
    assert result.scored == 1001 - 50
    assert not result.notes


def test_windows_start_late_or_are_left_out_where_their_first_samples_are_masked():
    """Five windows of 200: the second one starts at 270, the fourth one has 10 samples."""
    result = validate(mass_spring_damper(true=True), with_gaps((195, 270), (600, 790)), window=1.0)
    assert result.rmse[0] < 1e-12
    assert result.scored == (150 - 5) + 80 + 150 + 151
    few = "fewer than 25 of the first 50 samples (0.25 s) are valid."
    assert result.notes == (
        f"1 of 5 windows on gaps starts late: at first {few}",
        f"1 of 5 windows on gaps is not scored: {few}",
    )
    assert np.all(np.isfinite(result.predictions[0].outputs))


def test_a_record_with_samples_far_apart_starts_where_it_can():
    """Of 50 samples two are valid, which is enough for a position and a rate, or one."""
    plant, record = mass_spring_damper(true=True), swing()
    y = np.where(np.arange(1001) % 40 == 7, record.outputs[:, 0], np.nan)
    with pytest.warns(RecordWarning):
        rare = Record(TIME, FORCE, y, "rare", hold="linear")
    assert validate(plant, rare).rmse[0] < 1e-6
    with pytest.raises(ValueError, match="`record rare` must have 2 valid samples among 20"):
        validate(plant, rare, initial_samples=20)


@pytest.mark.parametrize("channel", ["output", "input"])
def test_a_record_that_cannot_be_scored_is_a_note_where_another_one_can(channel):
    plant, record = mass_spring_damper(), swing()
    u, y = FORCE.copy(), record.outputs[:, 0].copy()
    (u if channel == "input" else y)[9:] = np.nan
    with pytest.warns(RecordWarning):
        lost = Record(TIME, u, y, "lost", hold="linear")
    for records in ([record, lost], [lost, record]):
        result = validate(plant, records)
        np.testing.assert_allclose(result.rmse, validate(plant, record).rmse, rtol=1e-9)
        assert any(note.startswith("not scored: `record lost` must have") for note in result.notes)
    with pytest.raises(ValueError, match="`record lost` must have"):
        validate(plant, lost)


def test_runs_of_a_record_without_gaps_are_its_windows():
    runs = plan(swing(), 50, 1.5, 2)
    assert runs.starts == (0, 300, 600, 700)
    assert runs.predicted == (range(300), range(300, 600), range(600, 900), range(900, 1001))
    assert (runs.late, runs.lost) == (0, 0)


def test_divergence_is_a_note_and_an_infinite_error():
    def escape(t, x, u, p):
        return p.a * x.y[0] ** 3 + u

    record = Record(TIME, np.zeros(1001), 1.0 + 0.1 * np.sin(TIME), "calm", hold="zero")
    result = validate(Plant(escape, {"a": 30.0}), record)
    assert np.isinf(result.rmse[0])
    assert result.fit[0] == -np.inf
    assert "The free run on calm diverges: it is not finite from t = " in result.notes[0]
    assert "diverges" in str(result)
    assert np.all(np.isfinite(result.predictions[0].outputs))


def test_constant_output_has_no_fit_but_an_error():
    plant = Plant(lambda t, x, u, p: p.a * u, {"a": 1.0})
    record = Record(TIME, np.ones(1001), np.full(1001, 2.0), "flat", hold="zero")
    result = validate(plant, record)
    assert np.isfinite(result.rmse[0])
    assert np.isinf(result.nrmse[0])


def test_table_names_output_unit_and_numbers():
    result = validate(mass_spring_damper(), swing())
    lines = str(result).splitlines()
    assert lines[0] == "Free run, 1 record, 951 samples (4.755 s) scored"
    assert lines[2].split()[0] == "position"
    assert lines[2].split()[-1] == "m"
    assert float(lines[2].split()[1]) == pytest.approx(result.rmse[0], rel=1e-4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"records": []}, "`records` must hold at least one record"),
        ({"initial_samples": 2}, "`initial_samples` must exceed 2"),
        ({"initial_samples": 1001}, "`record swing` must have valid samples after the first 1001"),
        ({"window": -1.0}, "`window` must be positive"),
        ({"window": 0.1}, "`window` must be longer than 50 samples"),
        ({"substeps": 0}, "`substeps` must be an integer ≥ 1"),
    ],
)
def test_wrong_calls_name_field_rule_and_value(change, message):
    call = {"records": swing()} | change
    with pytest.raises(ValueError, match=message):
        validate(mass_spring_damper(), **call)


def test_too_few_first_samples_name_the_internal_states():
    plant = plant_from_text({"z": "-k*z"}, {"k": 1.0}, ["y"], output={"y": "z"}, initial={"z": 1.0})
    record = Record(0.1 * np.arange(100), np.zeros((100, 0)), np.exp(-0.1 * np.arange(100)))
    with pytest.raises(ValueError, match=r"must exceed 2, .* and of internal states, whose"):
        validate(plant, record, initial_samples=2)


def test_channels_must_match_the_plant():
    with pytest.raises(
        ValueError, match=r"`records\[swing\].outputs` must have 3 channels \(position_1"
    ):
        validate(three_mass_spring_damper(), swing())
    both = Record(TIME, np.stack([FORCE, FORCE], axis=1), FORCE, "two")
    with pytest.raises(ValueError, match=r"`records\[two\].inputs` must have 1 channel \(volt"):
        validate(mass_spring_damper(), both)


def test_silverbox_arrow_is_predicted_to_about_a_millivolt(data_directory):
    """Parameters from spectral regression alone, on the record that extrapolates in amplitude."""
    from scipy.io import loadmat

    part = slice(100, 40575)
    data = loadmat(data_directory / "silverbox" / "SNLS80mV.mat")
    u, y = (data[key].ravel()[part] for key in ("V1", "V2"))
    record = Record.from_period(2**14 / 1e7, u, y, "arrow", hold="smooth")
    model = duffing_oscillator(reference=True)
    result = validate(model, record)
    # rms of y is 53 mV; a regression in discrete time with the same terms reaches 1.8 mV.
    assert result.rmse[0] < 1.8e-3
    linear = validate(model.with_parameters({"cubic_stiffness": 0.0}), record)
    assert linear.rmse[0] > 5.0 * result.rmse[0]
    held = Record.from_period(2**14 / 1e7, u, y, "arrow", hold="zero")
    assert validate(model, held).rmse[0] > 2.0 * result.rmse[0]  # the input is band-limited


def test_predictions_are_what_simulate_gives_from_the_same_start():
    def dynamics(t, x, u, p):
        return jnp.stack([-p.a * x.y[0, 0] + u[0]])

    plant = Plant(dynamics, {"a": 2.0})
    record = simulate(plant, TIME, FORCE, 0.7, hold="linear", substeps=4)
    result = validate(plant, record)
    # One exponential mode: the estimated start is the true one up to rounding.
    np.testing.assert_allclose(result.predictions[0].outputs, record.outputs, atol=1e-12)
    assert result.predictions[0].name == "simulation (free run)"


class Heads(_Heads):
    """Two runs of one unknown v each, with the error unit·(exp(v) - 1)."""

    unit: np.ndarray
    sign: float

    def __init__(self, unit, sign=1.0):
        plant = SimpleNamespace(free_internal=np.zeros(0, bool))
        vars(self).update(unit=unit, sign=sign, run=SimpleNamespace(plant=plant))  # it is frozen

    def part(self, which):
        return Heads(self.unit[which], self.sign)

    def errors(self, trials):
        errors = self.unit[:, None, None] * np.expm1(trials)
        return np.sum(errors**2, axis=-1), errors

    def slopes(self, values, error, free):
        return -self.sign * (error + self.unit[:, None])[..., None]

    def errors_and_slopes(self, trials, free):
        costs, errors = self.errors(trials)
        return costs, errors, self.slopes(trials[:, 0], errors[:, 0], free)


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_start_states_are_fitted_to_their_end_in_any_unit(unit):
    heads: Any = Heads(np.array([unit, 3.0 * unit]))
    cost, values = _descend(heads, np.array([[[1.5]], [[-0.5]]]), np.array([True]))
    np.testing.assert_allclose(values, 0.0, atol=1e-3)
    np.testing.assert_allclose(cost, heads.errors(values[:, None])[0][:, 0])


def test_a_step_that_does_not_help_is_not_taken():
    start = np.array([[[1.5]], [[-0.5]]])
    heads: Any = Heads(np.array([1.0, 3.0]), sign=-1.0)  # slopes that point uphill
    cost, values = _descend(heads, start, np.array([True]))
    np.testing.assert_array_equal(values, start[:, 0])
    np.testing.assert_array_equal(cost, heads.errors(start)[0][:, 0])


def test_a_chain_that_has_run_begins_anew():
    plant = mass_spring_damper(true=True)
    drive = Drive(TIME[None, :-1], np.array([5e-3]), np.ones((1, 1000, 3, 1)), 1, np.ones((1, 1)))
    start, chain = State(np.array([[[0.01], [-0.05]]]), np.zeros((1, 0))), Chain(plant, (0,))
    first, second = chain.outputs(drive, start), chain.outputs(drive, start)
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(first, Chain(plant, (0,)).outputs(drive, start))


def test_starts_of_runs_that_diverge_in_any_steps_are_estimated_once(monkeypatch):
    estimated, estimate = [], planned_runs.window_starts

    def counted(*args):
        estimated.append(args[0].substeps)
        return estimate(*args)

    monkeypatch.setattr(planned_runs, "window_starts", counted)
    escape = Plant(lambda t, x, u, p: p.a * x.y[0] ** 3 + u, {"a": 30.0})
    record = Record(TIME, np.zeros(1001), 1.0 + 0.1 * np.sin(TIME), "calm", hold="zero")
    result = validate(escape, record, window=np.inf)
    assert np.all(np.isinf(result.rmse))
    assert len(estimated) == 1


def test_a_start_whose_run_is_finite_but_not_over_the_spread_gives_no_warning():
    """Warnings are errors here: of trials that are given up nothing is printed."""
    time = 0.1 * np.arange(60)
    growth = plant_from_text({"y": "a*y"}, {"a": 147.6}, inputs=(), outputs=("y",))  # to 1e302
    record = Record(time, np.zeros((60, 0)), 1e-12 * np.sin(time))
    result = validate(growth, record, initial_samples=50, window=np.inf, substeps=64)
    assert np.isinf(result.rmse[0])


def test_a_diverged_prediction_is_shown_within_a_thousand_ranges_of_the_measurement():
    time = 0.1 * np.arange(100)
    record = Record(time, 0.0 * time, 1.0 + 1e-3 * np.sin(time))
    diverged = np.full((100, 1), np.inf)
    shown = _record(record, diverged).outputs
    np.testing.assert_allclose(shown, np.mean(record.outputs) + 1e3 * np.ptp(record.outputs))


def test_a_short_record_starts_from_a_third_of_itself():
    """Of forty samples fifty cannot start a run."""
    time = 0.25 * np.arange(40)
    decay = Plant(lambda t, x, u, p: -p.rate * x.y[0], {"rate": 0.4}, inputs=())
    noise = 1e-3 * np.random.default_rng(0).standard_normal(40)
    record = Record(time, np.zeros((40, 0)), np.exp(-0.4 * time) + noise)
    result = validate(decay, record)
    assert result.scored == 40 - 13
    assert result.rmse[0] == pytest.approx(1e-3, rel=0.3)


def test_short_windows_start_from_a_share_of_themselves():
    """As those of a search in free runs, whose heads are shorter than the usual ones."""

    def shifted(t, x, u, p):
        return -p.a * x.z

    plant = Plant(lambda t, x, u, p: p.b * u - p.a * x.y[0], {"a": 0.5, "b": 1.0}, 1)
    stored = Plant(
        plant.dynamics, plant.parameters, 1, internal=shifted, internal_initial=[0.0] * 12
    )
    record = simulate(plant, np.arange(60.0), np.sin(np.arange(60.0))[:, None])
    whole, windows = whole_and_windows(plant, (record,), 12.0)
    assert windows is not None
    assert whole.window is None
    assert windows.window == 12.0
    assert windows.rmse[0] < 0.01
    # More states than a window has samples: its starts are not told.
    assert whole_and_windows(stored, (record,), 12.0)[1] is None
