"""Parameters over time: the batch estimate at the end, errors that hold, drifts that are found.

The plant is simulated here by a Runge–Kutta step that shares no code with the package.
"""

from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

import eoi_jax as eoi
from eoi_jax.estimation import parameter_recursion
from eoi_jax.estimation.identify import estimate
from eoi_jax.estimation.parameter_drift import find_drifts
from eoi_jax.estimation.parameter_history import ParameterHistory
from eoi_jax.estimation.parameter_recursion import RecursionSettings, recursion_over_rows
from eoi_jax.estimation.part_estimates import Part, sides_of_change
from eoi_jax.estimation.preparation import prepare_records
from eoi_jax.estimation.regression.recursive_least_squares import RecursiveLeastSquares
from eoi_jax.estimation.regression.sample_rows import SampleRows

H = 0.01


def plant(**options):
    return eoi.Plant(
        lambda t, x, u, p: [u[0] - p.c * x.y[1, 0] - p.k * x.y[0, 0]],
        inputs=("force",), outputs=("position",), relative_degree=2,
        parameters={"c": 0.3, "k": 3.0}, units={"k": "N/m"}, **options,
    )  # fmt: skip


def measured(stiffness=lambda t: 4.0, seed=1, noise=0.0, duration=20.0, name="run", mass=1.0):
    """A mass on a spring whose stiffness may depend on time, under random levels of force."""
    draw = np.random.default_rng(seed)
    time = np.arange(0.0, duration, H)
    force = np.repeat(draw.uniform(-1.0, 1.0, len(time) // 25 + 1), 25)[: len(time)]
    state, positions = np.zeros(2), [0.0]

    def rate(state, u, t):
        return np.array([state[1], (u - 0.4 * state[1] - stiffness(t) * state[0]) / mass])

    for t, u in zip(time[:-1], force[:-1], strict=True):
        for part in range(4):
            d, s = H / 4, t + part * H / 4
            k1 = rate(state, u, s)
            k2 = rate(state + d / 2 * k1, u, s + d / 2)
            k3 = rate(state + d / 2 * k2, u, s + d / 2)
            k4 = rate(state + d * k3, u, s + d)
            state = state + d / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        positions.append(state[0])
    y = np.asarray(positions)
    y = y + noise * np.std(y) * draw.standard_normal(len(y))
    return eoi.Record(time, force, y, name=name, hold="zero")


def history_of(result) -> ParameterHistory:
    assert result.history is not None
    return result.history


@pytest.fixture(scope="module")
def steady():
    records = [measured(name="first"), measured(seed=2, duration=12.0, name="second")]
    return eoi.identify(plant(), records, recursive=True)


def test_without_forgetting_it_ends_at_the_batch_estimate_to_rounding(steady):
    end = np.array(list(steady.parameters.values())) + steady.increments[steady.best_pass]
    np.testing.assert_allclose(history_of(steady).values[-1][-1], end, rtol=1e-12)
    errors = list(steady.standard_errors.values())
    np.testing.assert_allclose(history_of(steady).standard_errors[-1][-1], errors, rtol=1e-9)


def test_parameters_are_open_at_first_and_known_from_some_sample_on(steady):
    values, errors = history_of(steady).values[0], history_of(steady).standard_errors[0]
    assert values.shape == errors.shape == (2000, 2)
    known = np.all(np.isfinite(values), axis=1)
    first = int(np.argmax(known))
    assert 0 < first < 1000
    assert np.all(known[first:])
    np.testing.assert_array_equal(np.isfinite(errors[:first]), False)
    assert errors[-1, 1] < 0.5 * errors[first + 100, 1]


def test_a_record_goes_on_from_the_end_of_the_one_before(steady):
    history = history_of(steady)
    np.testing.assert_array_equal(history.values[1][0], history.values[0][-1])
    np.testing.assert_array_equal(history.time[1], steady.records[1].time)
    assert history.drifts == ()


def test_with_instruments_it_ends_at_the_estimate_too():
    records = [measured(noise=1e-3, name="first"), measured(seed=2, noise=1e-3, name="second")]
    result = eoi.identify(plant(), records, recursive=True, instruments=True)
    assert np.any(result.correction)
    estimate, errors = (np.array(list(values.values()))
                        for values in (result.parameters, result.standard_errors))  # fmt: skip
    end = history_of(result).values[-1][-1]
    np.testing.assert_array_less(np.abs(end - estimate), 0.05 * errors)
    np.testing.assert_allclose(history_of(result).standard_errors[-1][-1], errors, rtol=1e-3)
    truth = np.array([0.4, 4.0])
    later = history_of(result).values[0][1000:], history_of(result).standard_errors[0][1000:]
    assert np.mean(np.abs(later[0] - truth) < 4.0 * later[1]) > 0.99


@pytest.mark.parametrize("kind", ["step", "ramp"])
@pytest.mark.parametrize("noise", [0.0, 1e-3, 1e-2])
def test_a_stiffness_that_changes_is_found_and_one_that_does_not_is_not(kind, noise):
    kinds = {"step": lambda t: 4.0 if t < 25.0 else 4.2, "ramp": lambda t: 4.0 + 0.01 * t}
    options: dict[str, Any] = {"recursive": True, "instruments": False}
    result = eoi.identify(plant(), measured(kinds[kind], noise=noise, duration=40.0), **options)
    (drift,) = history_of(result).drifts
    assert drift.parameter == "k"
    assert drift.after > drift.before + 0.1
    assert any(note.startswith("k is not constant: ") for note in result.notes)
    if kind == "step":
        assert abs(drift.time - 25.0) < 1.0
        np.testing.assert_allclose((drift.before, drift.after), (4.0, 4.2), atol=0.02)
    constant = eoi.identify(plant(), measured(noise=noise, duration=40.0), **options)
    assert history_of(constant).drifts == ()


def heavy():
    """The same with a mass, in which the acceleration is not linear."""
    return eoi.Plant(
        lambda t, x, u, p: [(u[0] - p.c * x.y[1, 0] - p.k * x.y[0, 0]) / p.m],
        inputs=("force",), outputs=("position",), relative_degree=2,
        parameters={"m": 1.2, "c": 0.3, "k": 3.0},
    )  # fmt: skip


def test_values_on_both_sides_of_a_change_are_estimates_of_their_own():
    """One linear step from the estimate of all says 0.925 and 1.53, and that c changes, too."""
    records = [measured(seed=3, noise=1e-3, name="empty"),
               measured(seed=4, noise=1e-3, name="full", mass=1.6)]  # fmt: skip
    result = eoi.identify(heavy(), records, recursive=True)
    (drift,) = history_of(result).drifts
    assert drift.parameter == "m"
    for value, error, mass in zip(
        (drift.before, drift.after), drift.errors, (1.0, 1.6), strict=True
    ):
        assert abs(value - mass) < 4.0 * error < 0.02
    assert [note for note in result.notes if note == drift.sentence]


def test_a_change_within_a_record_is_told_by_estimates_too(tmp_path):
    record = measured(lambda t: 4.0 if t < 18.0 else 6.0, seed=3, noise=1e-3, duration=40.0)
    result = eoi.identify(heavy(), record, recursive=True)
    (drift,) = history_of(result).drifts
    assert drift.parameter == "k"
    assert abs(drift.time - 18.0) < 1.0
    for value, error, stiffness in zip(
        (drift.before, drift.after), drift.errors, (4.0, 6.0), strict=True
    ):
        assert abs(value - stiffness) < 4.0 * error < 0.1
    result.save(tmp_path / "run.npz")
    assert eoi.load(tmp_path / "run.npz").history.drifts == (drift,)


def test_hidden_states_are_driven_from_the_start_of_the_record_on():
    """Of other plants the samples after a change are a record; scored are the same ones."""
    records = [measured(duration=20.0), measured(duration=20.0)]
    hidden = plant(internal=lambda t, x, u, p: -x.z, internal_initial=(0.0,))
    whole, empty = Part(1, 0, 2000), Part(0, 0, 900)
    assert sides_of_change(plant(), records, (0, 1000), 1.0) == (
        (empty,), (Part(0, 1000, 2000), whole),
    )  # fmt: skip
    assert sides_of_change(hidden, records, (0, 1000), 1.0) == (
        (empty,), (Part(0, 0, 2000, 1100), whole),
    )  # fmt: skip
    # So near to a border that the change comes from record to record.
    for place in ((0, 1950), (1, 150)):
        assert sides_of_change(hidden, records, place, 1.0) == ((Part(0, 0, 2000),), (whole,))
    prepared = prepare_records(hidden, (measured(noise=1e-3),))
    fit = estimate(hidden, prepared, transient=1.0, unscored=(800,))
    burnt = measured(noise=1e-3)
    burnt = eoi.Record(burnt.time, burnt.inputs, burnt.outputs, hold="zero", burn_in=8.0)
    same = estimate(hidden, prepare_records(hidden, (burnt,)), transient=1.0)
    np.testing.assert_allclose(fit.plant.theta, same.plant.theta, rtol=1e-9)


def test_with_forgetting_it_follows_a_change():
    record = measured(lambda t: 4.0 if t < 12.0 else 4.2)
    result = eoi.identify(plant(), record, recursive=True, forgetting=0.995)
    np.testing.assert_allclose(history_of(result).values[0][-1], (0.4, 4.2), atol=0.01)
    assert abs(result.parameters["k"] - 4.2) > 0.05
    everything = history_of(eoi.identify(plant(), record, recursive=True))
    assert history_of(result).standard_errors[0][-1, 1] > everything.standard_errors[0][-1, 1]


def test_fixed_parameters_and_those_on_a_bound_stay_where_they_are():
    record = measured()
    fixed = history_of(eoi.identify(plant(fixed=("c",)), record, recursive=True))
    np.testing.assert_array_equal(fixed.values[0][:, 0], 0.3)
    np.testing.assert_array_equal(fixed.standard_errors[0][:, 0], 0.0)
    bounded = eoi.identify(plant(bounds={"c": (0.0, 0.35)}), record, recursive=True)
    assert bounded.parameters["c"] == 0.35
    np.testing.assert_array_equal(history_of(bounded).values[0][-1, 0], 0.35)


def test_without_being_asked_for_there_is_none():
    assert eoi.identify(plant(), measured()).history is None


def test_wrong_arguments_are_named():
    record = measured(duration=5.0)
    with pytest.raises(ValueError, match=r"`forgetting` must be 1 without `recursive=True`"):
        eoi.identify(plant(), record, forgetting=0.99)
    with pytest.raises(ValueError, match=r"`forgetting` must lie in \(0, 1\]"):
        eoi.identify(plant(), record, recursive=True, forgetting=1.5)


def test_it_is_saved_printed_and_drawn(steady, tmp_path):
    steady.save(tmp_path / "run.npz")
    loaded = eoi.load(tmp_path / "run.npz").history
    np.testing.assert_array_equal(loaded.values[1], history_of(steady).values[1])
    assert str(loaded).splitlines()[0].split() == ["parameter", "last", "estimate", "±", "std.",
                                                   "error", "unit"]  # fmt: skip
    assert "no parameter is seen to change" in str(loaded)
    frame = loaded.to_pandas()
    assert list(frame.columns[:3]) == ["record", "time", "c"]
    np.testing.assert_array_equal(frame[frame["record"] == "second"]["k"], loaded.values[1][:, 1])
    figure = loaded.plot()
    assert [axes.get_ylabel() for axes in figure.axes] == ["c", "k [N/m]"]


# -- the test of drift, on rows of its own ------------------------------------------------------


def rows(draw, samples, colour, slowness, change=0.0):
    """Regressors and noise of first order, and a parameter that changes in the middle."""

    def first_order(pole, columns):
        white = draw.standard_normal((samples + 500, columns))
        signal = np.asarray(lfilter([1.0], [1.0, -pole], white, 0))
        return signal[500:] / np.std(signal)

    phi, error = first_order(slowness, 2), 0.1 * first_order(colour, 1)[:, 0]
    error[samples // 2 :] += change * phi[samples // 2 :, 0]
    places = np.zeros(samples, int), np.arange(samples) + 1
    return SampleRows(error[:, None], phi[:, None, :], None, *places)


@pytest.mark.parametrize("samples", [300, 2000])
@pytest.mark.parametrize(("colour", "slowness"), [(0.0, 0.0), (0.9, 0.0), (0.9, 0.9), (0.98, 0.98)])
def test_the_promised_chance_of_a_false_alarm_is_kept(samples, colour, slowness):
    model, time = plant(), H * np.arange(samples + 1)
    record = [eoi.Record(time, np.sin(time), np.cos(time), hold="zero")]
    draw = np.random.default_rng(5)
    cases = [rows(draw, samples, colour, slowness) for _ in range(20)]
    assert not any(find_drifts(model, case, record) for case in cases)
    if samples == 2000 and slowness == 0.0:
        (drift,) = find_drifts(model, rows(draw, samples, colour, slowness, 0.1), record)
        assert drift.parameter == "c"
        assert abs(drift.after - drift.before - 0.1) < 4.0 * np.hypot(*drift.errors)


# -- the loop of the recursion -------------------------------------------------------------


def many_rows(size, instruments, count=2, samples=400):
    """Rows of noise, some samples of which do not count."""
    draw = np.random.default_rng(3)
    phi = draw.standard_normal((samples, count, size))
    phi[100:140] = 0.0
    zeta = phi + 0.1 * draw.standard_normal(phi.shape) * (phi != 0.0) if instruments else None
    error = phi @ np.linspace(1.0, 2.0, size) + 0.1 * draw.standard_normal((samples, count))
    return SampleRows(error, phi, zeta, np.zeros(samples, int), np.arange(samples) + 1)


@pytest.mark.parametrize("instruments", [False, True])
def test_the_compiled_recursion_is_the_scan(instruments, monkeypatch):
    estimator, case = RecursiveLeastSquares(0.99), many_rows(3, instruments)
    scanned = recursion_over_rows(estimator, case, RecursionSettings(max_products=0))
    monkeypatch.delattr(parameter_recursion, "_scanned")
    compiled = recursion_over_rows(estimator, case, RecursionSettings(chunk=150))
    is_open = ~np.isfinite(scanned[1])
    assert 1 <= np.sum(np.all(is_open, axis=1)) < 10
    np.testing.assert_array_equal(~np.isfinite(compiled[1]), is_open)
    for value, want in zip(compiled, scanned, strict=True):
        np.testing.assert_allclose(value[~is_open], want[~is_open], rtol=1e-9)


def test_more_parameters_than_are_compiled_take_the_scan():
    case = many_rows(10, False)
    values, variances = recursion_over_rows(RecursiveLeastSquares(0.99), case)
    weights = case.scored.astype(float)
    want, _ = eoi.recursive(case.regressors, case.error, weights, forgetting=0.99)
    np.testing.assert_allclose(values, want, rtol=1e-12, atol=1e-12)
    assert np.all(np.isfinite(variances[50:]))
