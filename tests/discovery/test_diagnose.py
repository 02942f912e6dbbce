"""Diagnosis: the null hypothesis is right, and each defect put in is what is found."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from elastic_drive import elastic_drive
from scipy.integrate import quad
from scipy.linalg import expm
from scipy.signal import butter, sosfilt

import eoi_jax as eoi
from eoi_jax.data.clipping import saturations
from eoi_jax.discovery.diagnose import diagnose
from eoi_jax.discovery.diagnosis import Diagnosis
from eoi_jax.discovery.residual import views_of
from eoi_jax.estimation.regression.noise_autocorrelation import ljung_box, prediction_from, whitened
from eoi_jax.report.diagnosis import findings
from eoi_jax.report.health import health

TRUE = {"k": 900.0, "d": 12.0, "b": 50.0}
NOMINAL = {"k": 800.0, "d": 10.0, "b": 40.0}
H = 2e-3
TIME = np.arange(6000) * H
DRIVE = eoi.excitation.multisine(TIME, 1.0, (0.2, 12.0), 40, seed=1)


def spring(t, x, u, p):
    y, rate = x.y
    return -p.k * y - p.d * rate + p.b * u


def rough(t, x, u, p):
    return spring(t, x, u, p) - 4.0 * jnp.sign(x.y[1])


def twins(t, x, u, p):
    y = x.y[0]
    return spring(t, x, u, p) - p.k2 * y * (1.0 + 0.02 * y)


def plant(dynamics=spring, values=TRUE, **more):
    units = {"y": "m", "u": "V"}
    return eoi.Plant(dynamics, {**values, **more}, relative_degree=2, units=units)


def noisy(outputs, seed, level=1e-3):
    draw = np.random.default_rng(seed)
    return outputs + level * np.std(outputs) * draw.standard_normal(outputs.shape)


def record(dynamics=spring, seed=0, drive=DRIVE, late=0, level=1e-3, name="run", **more):
    u = np.concatenate([np.full(late, drive[0]), drive[: len(drive) - late]])
    run = eoi.simulate(plant(dynamics, **more), TIME[: len(drive)], u, hold="smooth")
    y = noisy(run.outputs, seed, level)
    return eoi.Record(run.time, drive, y, name, hold="smooth")


def found(measured, dynamics=spring, **more) -> Diagnosis:
    return diagnose(eoi.identify(plant(dynamics, NOMINAL, **more), measured), measured)


def said(diagnosis, words):
    return [line for line in diagnosis.findings if words in line]


def of(diagnosis, variable):
    return next(one for one in diagnosis.maps if one.variable == variable)


@pytest.fixture(scope="module")
def clean():
    return found(record())


@pytest.fixture(scope="module")
def coulomb():
    return found(record(rough))


# -- the null hypothesis ----------------------------------------------------------------------


def test_the_noise_floor_is_the_integral_of_the_known_spectrum():
    measured = record(level=3e-4)
    result = eoi.identify(plant(), measured, smoothing=False, passes=2)
    k, d = result.parameters["k"], result.parameters["d"]
    cutoff, order = result.lowpass.cutoff, result.lowpass.order

    def density(w):
        return abs((1j * w) ** 2 + d * 1j * w + k) ** 2 / (1.0 + (w / cutoff) ** (2 * order))

    power = quad(density, 0.0, np.pi / H, limit=400)[0] * H / np.pi * measured.noise[0] ** 2
    # The sampled filter and differences depart from the continuous ones near the Nyquist frequency.
    assert diagnose(result).noise_floor[0] == pytest.approx(np.sqrt(power), rel=0.02)


def test_the_noise_floor_knows_of_every_smoothing():
    """A second filter far above the cut-off of F changes the floor as little as the residual."""
    once = record(level=3e-4).smooth(60.0)
    floors = [
        diagnose(eoi.identify(plant(), one, smoothing=False, passes=2))
        for one in (once, once.smooth(90.0))
    ]
    assert floors[1].noise[0] == pytest.approx(floors[0].noise[0], rel=1e-6)
    assert floors[1].noise_floor[0] == pytest.approx(floors[0].noise_floor[0], rel=0.05)


def test_the_residual_of_a_right_model_has_the_predicted_size(clean):
    # About 500 independent values: 3.2 % standard deviation of the rms.
    assert clean.residual_rms[0] == pytest.approx(clean.noise_floor[0], rel=0.1)
    assert not clean.more_than_noise[0]
    assert clean.white[0]


@pytest.mark.parametrize("level", [1e-3, 1e-2])
def test_noise_that_rings_in_an_internal_resonance_is_known(level):
    """A drive with a load that is not measured: its measured speed drives the shaft."""
    model = elastic_drive(b=30.0, c=1.0, k=900.0, d=2.0, r=0.8)
    time, random = 4e-3 * np.arange(3000), np.random.default_rng(5)
    command = np.repeat(random.uniform(-1.5, 1.5, 120), 25)
    clean = eoi.simulate(model, time, command, hold="zero")
    outputs = clean.outputs + level * np.std(clean.outputs) * random.standard_normal((3000, 1))
    measured = eoi.Record(time, clean.inputs, outputs, hold="zero")
    found = diagnose(eoi.identify(model, measured))
    assert not found.more_than_noise[0]
    assert found.white[0]


def test_a_clean_record_gives_one_finding_that_there_is_none(clean):
    assert len(clean.findings) == 1
    assert clean.findings[0].startswith("No findings")
    assert clean.strongest == (None,)


def test_whitening_restores_the_level_of_the_ljung_box_test():
    """Noise differentiated twice and filtered, thinned: rejected always raw, at 1 % whitened."""
    runs, thin, count = 1000, 8, 400
    sections = butter(3, 0.1, output="sos")
    draw = np.random.default_rng(5)
    noise = draw.standard_normal((runs, thin * count + 500))
    coloured = np.asarray(sosfilt(sections, np.diff(noise, 2, axis=1), axis=1))[:, 400::thin]
    impulse = np.zeros(4096)
    impulse[1:4] = 1.0, -2.0, 1.0
    response = sosfilt(sections, impulse)
    covariance = np.correlate(response, response, "full")[4095:][: 13 * thin : thin]
    prediction = prediction_from(covariance)
    p_values = np.array([ljung_box([whitened(one, prediction)])[1] for one in coloured])
    raw = np.array([ljung_box([one])[1] for one in coloured[:50]])
    assert np.all(raw < 0.01)
    # Binomial, 1000 at 1 %: 10 expected, more than 22 in three of ten thousand.
    assert np.sum(p_values < 0.01) <= 22
    # 100 at 10 %: five standard deviations either way.
    assert 53 <= np.sum(p_values < 0.1) <= 147


@pytest.mark.slow
@pytest.mark.long
def test_false_alarms_of_a_right_model_are_at_the_stated_level():
    """Every test on 40 noisy records of a right model, estimated together, one by one."""
    drives = [eoi.excitation.multisine(TIME[:3000], 1.0, (0.2, 12.0), 40, seed=s) for s in range(4)]
    records = [record(seed=1000 + s, drive=drives[s % 4], name=str(s)) for s in range(40)]
    result = eoi.identify(plant(), records, passes=2)
    parts = [
        diagnose(replace(result, records=(one,), residual=[e]), one)
        for one, e in zip(result.records, result.residual, strict=True)
    ]
    p_values = np.array(
        [
            [d.whiteness[0], d.cross[0].p_value, d.cross[0].future_p_value]
            + [one.p_value for one in d.maps]
            for d in parts
        ]
    )
    assert np.all(np.isfinite(p_values))
    # Binomial, 40 at 1 %: more than 4 in one of twenty thousand, for each of the tests.
    assert np.all(np.sum(p_values < 0.01, axis=0) <= 4)
    assert sum(d.more_than_noise[0] for d in parts) <= 4
    # The whiteness test is exact, not only bounded: its p-values are uniform.
    assert 0.32 < np.mean(p_values[:, 0]) < 0.68  # four standard deviations


# -- what is put in is found ------------------------------------------------------------------


def test_missing_dry_friction_shows_as_a_step_of_the_map_against_velocity(coulomb):
    assert coulomb.more_than_noise[0]
    assert not coulomb.white[0]
    assert coulomb.strongest[0].variable == "y′"
    assert said(coulomb, "more than noise")
    assert "depends most on y′" in said(coulomb, "more than noise")[0]
    rate = of(coulomb, "y′")
    slow = np.abs(rate.centre) < 0.3 * np.max(np.abs(rate.centre))
    before, after = (
        rate.mean[slow & (rate.centre * sign > 0.05 * rate.centre.max())] for sign in (-1, 1)
    )
    # 4 m/s² on each side of rest, less what the filter rounds off and the damper takes on.
    assert np.min(before) > 1.0
    assert np.max(after) < -1.0
    assert np.all(of(coulomb, "y′").band > 0)


def test_a_late_input_is_called_late_by_its_delay():
    diagnosis = found(record(late=5))
    assert diagnosis.cross[0].delay == pytest.approx(0.010, abs=5e-4)
    assert said(diagnosis, "u seems to act on y with a delay of about 0.01")
    assert diagnosis.cross[0].p_value < 1e-4


def test_no_delay_and_no_feedback_is_suspected_without_one(clean, coulomb):
    for diagnosis in (clean, coulomb):
        assert np.isnan(diagnosis.cross[0].delay)
        assert not diagnosis.cross[0].feedback


def test_a_regulator_against_an_unmeasured_load_is_called_feedback():
    block = np.array([[0.0, 1.0, 0.0], [-TRUE["k"], -TRUE["d"], TRUE["b"]], [0.0, 0.0, 0.0]])
    step = expm(block * H)
    draw = np.random.default_rng(3)
    x, load, old, u, y = np.zeros(2), 0.0, 0.0, [], []
    for reference in DRIVE:
        level = x[0] + 1e-5 * draw.standard_normal()
        u.append(0.3 * reference - 15.0 * level - 0.5 * (level - old) / H)
        y.append(level)
        old = level
        load += -5.0 * load * H + np.sqrt(10.0 * H) * draw.standard_normal()
        x = step[:2, :2] @ x + step[:2, 2] * (u[-1] + load)
    diagnosis = found(eoi.Record(TIME, u, y, hold="zero"))
    assert diagnosis.cross[0].feedback
    assert said(diagnosis, "u seems to be computed from y")


def test_a_clipped_sensor_is_named_with_level_and_share():
    measured = record()
    limit = 0.8 * np.max(np.abs(measured.outputs))
    y = np.clip(measured.outputs, -limit, limit)
    diagnosis = found(eoi.Record(TIME, DRIVE, y, hold="smooth"))
    levels = {one.level: one.share for one in diagnosis.saturation}
    assert set(levels) == {limit, -limit}
    for level, share in levels.items():  # some samples are within a thousandth of the end
        assert share == pytest.approx(np.mean(y == level), rel=0.1)
    assert "saturates" in diagnosis.findings[0]
    assert "Mask those samples" in diagnosis.findings[0]


def test_an_input_at_its_limit_is_not_to_be_masked():
    measured = record()
    limit = 0.8 * np.max(measured.inputs)
    u = np.clip(measured.inputs, -limit, limit)
    diagnosis = found(eoi.Record(TIME, u, measured.outputs, hold="smooth"))
    (finding, *_) = [line for line in diagnosis.findings if "saturates" in line]
    assert "If that is what acts, as the output of a controller at its limit" in finding
    assert "Mask" not in finding


@pytest.mark.parametrize(
    "signal",
    [
        np.sin(7.0 * TIME),
        1.0 - np.exp(-TIME),
        eoi.excitation.square(TIME, 1.0, 0.5),
        eoi.excitation.random_steps(TIME, -1.0, 1.0, 0.1, seed=1),
        np.round(100.0 * np.sin(7.0 * TIME)),
        TIME % 1.0,
    ],
    ids=["sine", "settling", "square", "random steps", "coarse sine", "saw"],
)
def test_a_signal_that_turns_settles_or_switches_is_not_called_saturated(signal):
    assert saturations(eoi.Record(TIME, DRIVE, signal)) == []


@pytest.mark.parametrize(("offset", "ends"), [(0.0, 0), (0.2, 1)])
def test_an_input_that_is_off_does_not_saturate(offset, ends):
    """As the sun at night."""
    sun = offset + np.clip(DRIVE, 0.0, None)
    assert len(saturations(eoi.Record(TIME, sun, record().outputs))) == ends
    off = eoi.Record(TIME, DRIVE, sun)
    assert [end.channel for end in saturations(off)] == ["y"]


def test_a_coarse_sensor_is_called_quantised():
    measured = record()
    step = np.std(measured.outputs) / 40.0
    y = np.round(measured.outputs / step) * step
    diagnosis = found(eoi.Record(TIME, DRIVE, y, hold="smooth"))
    assert diagnosis.quantum[0] == pytest.approx(step, rel=1e-6)
    assert said(diagnosis, "y is quantised in steps of")
    # Steps without noise at all, of a signal that is computed, are not its noise.
    exact = findings(replace(diagnosis, noise=np.zeros(1)), eoi.Status("converged", ""))
    assert not any("quantised" in one for one in exact)


def test_a_hum_of_the_sensor_is_named_with_its_frequency_and_size(clean, coulomb):
    measured = record()
    rms = 3e-3 * np.std(measured.outputs)
    hum = np.sqrt(2.0) * rms * np.sin(2.0 * np.pi * 33.3 * TIME + 0.4)[:, None]
    diagnosis = found(eoi.Record(TIME, DRIVE, measured.outputs + hum, "run", hold="smooth"))
    (line,) = diagnosis.lines
    assert (line.output, line.record) == ("y", "run")
    assert line.frequency == pytest.approx(2.0 * np.pi * 33.3, rel=1e-3)
    assert line.rms == pytest.approx(rms, rel=0.05)
    assert line.share > 0.5
    (told,) = said(diagnosis, "y of run contains a line at 209.2 rad/s (33.3 Hz) of ")
    assert told.endswith(f"It makes up {line.share:.0%} of the residual.")
    (look,) = [one for one in health(diagnosis) if one.name == "Noise"]
    assert not look.good
    assert clean.lines == coulomb.lines == ()


def test_two_parameters_that_do_the_same_are_called_confounded():
    diagnosis = found(record(twins, k2=0.0), twins, k2=0.0)
    pair = diagnosis.confounded[0]
    assert {pair.first, pair.second} == {"k", "k2"}
    assert pair.correlation < -0.999
    assert said(diagnosis, "k and k2 are confounded")
    assert said(diagnosis, "The least certain combination of parameters is")
    assert {"k", "k2"} == {one.split("·")[1] for one in diagnosis.worst_combination.split()}


def test_windows_in_which_nothing_moves_are_named(clean):
    assert not any(one.poor for one in clean.windows)
    still = DRIVE * np.clip((6.0 - TIME) / 0.5, 0.0, 1.0)
    diagnosis = found(record(drive=still))
    # The mass comes to rest within half a second (d = 12 1/s).
    assert all(one.poor for one in diagnosis.windows if one.start > 6.5)
    assert not any(one.poor for one in diagnosis.windows if one.stop < 5.5)
    assert said(diagnosis, "There is no excitation in")


def test_excitation_is_that_of_the_filtered_regressors():
    """Scaled regressors of a clean record, formed by hand, have the same smallest eigenvalue."""
    measured = record(level=0.0)
    result = eoi.identify(plant(), measured)
    signals = np.column_stack(
        [measured.outputs[:, 0], np.gradient(measured.outputs[:, 0], H), DRIVE]
    )
    sections = butter(result.lowpass.order, result.lowpass.cutoff, fs=2.0 * np.pi / H, output="sos")
    Phi = sosfilt(sections, signals, axis=0)[np.isfinite(result.residual[0][:, 0])]
    Phi = Phi / np.sqrt(np.mean(Phi**2, axis=0))
    smallest = np.linalg.eigvalsh(Phi.T @ Phi / len(Phi))[0]
    # Central differences and the bilinear filter against the observer's: second order in h.
    assert diagnose(result).excitation == pytest.approx(smallest, rel=0.02)


def test_an_observer_that_cannot_follow_is_called_so():
    observer = eoi.observers.SecondOrder(c1=20.0, c2=100.0, c3=1.0)
    measured = record()
    result = eoi.identify(plant(values=NOMINAL), measured, observer, passes=1)
    assert said(diagnose(result), "is in sliding mode in only")


def test_a_constant_force_shows_as_the_mean_of_the_residual():
    diagnosis = found(record(lambda t, x, u, p: spring(t, x, u, p) + 3.0))
    assert diagnosis.offset[0] == pytest.approx(3.0, rel=0.2)
    assert diagnosis.offset_error[0] < 0.3
    assert said(diagnosis, "has a mean of")
    # From four standard errors on.
    for share, told in ((3.5, False), (4.5, True)):
        near = replace(diagnosis, offset=share * diagnosis.offset_error, method_floor=np.zeros(1))
        sentences = findings(near, eoi.Status("converged", ""))
        assert told == any("has a mean of" in one for one in sentences)


def test_what_is_small_but_not_noise_is_said_so(clean, coulomb):
    status = eoi.Status("converged", "")
    odd = replace(clean, white=np.array([False]), whiteness=np.array([1e-5]))
    assert "the noise is coloured" in findings(odd, status)[0]
    hidden = replace(coulomb, more_than_noise=np.array([False]))
    assert "within the noise in size" in findings(hidden, status)[0]
    assert "depends most on y′" in findings(hidden, status)[0]


def test_an_estimate_that_failed_is_said_first(clean):
    status = eoi.Status("unidentifiable", "no trace in the data of b")
    assert findings(clean, status)[0] == "There is no valid estimate: no trace in the data of b."


# -- edges ------------------------------------------------------------------------------------


def test_a_record_without_a_scored_sample_says_so_instead_of_numbers():
    flat = eoi.Record(TIME, DRIVE, np.zeros(len(TIME)), hold="smooth")
    diagnosis = diagnose(eoi.identify(plant(), flat))
    assert diagnosis.findings[0].startswith("No sample was scored")
    assert np.isnan(diagnosis.residual_rms[0])
    assert str(diagnosis)


def test_a_plant_without_inputs_has_no_cross_correlations():
    free = eoi.Plant(
        lambda t, x, u, p: -p.k * x.y[0] - p.d * x.y[1], {"k": 850.0, "d": 1.0}, 2, inputs=()
    )
    still = np.zeros((len(TIME), 0))
    run = eoi.simulate(free.with_parameters({"k": 900.0}), TIME, still, [0.1, 0.0])
    measured = eoi.Record(TIME, still, noisy(run.outputs, 0))
    diagnosis = diagnose(eoi.identify(free, measured))
    assert diagnosis.cross == ()
    assert {one.variable for one in diagnosis.maps} == {"y", "y′", "time"}


def test_records_that_do_not_fit_the_plant_are_refused():
    two = eoi.Record(TIME, DRIVE, np.column_stack([DRIVE, DRIVE]))
    result = eoi.identify(plant(), record(), passes=1)
    with pytest.raises(ValueError, match="outputs` must have 1 channel"):
        diagnose(result, two)


def test_a_level_outside_its_range_is_refused():
    with pytest.raises(ValueError, match=r"`level` must lie in \(0, 0.5\), got 1.0"):
        diagnose(eoi.identify(plant(), record(), passes=1), level=1.0)


def test_it_prints_plots_and_survives_a_file(coulomb, tmp_path):
    text = str(coulomb)
    assert text.startswith("- The residual of y is more than noise")
    assert "m/s²" in text
    assert "strongest" in text
    assert max(len(line) for line in text.splitlines() if not line.startswith("-")) <= 100
    figure = coulomb.plot()
    assert len(figure.axes) == 4 + 2 + 1  # maps; autocorrelation and cross-correlation; windows
    coulomb.save(tmp_path / "diagnosis.npz")
    back = eoi.load(tmp_path / "diagnosis.npz")
    assert str(back) == text
    np.testing.assert_array_equal(back.maps[1].mean, coulomb.maps[1].mean)


def test_variables_of_the_residual_are_where_they_are_measured():
    """A filter that starts on the first sample: what stands still is seen where it stands."""
    drive = np.concatenate([np.full(2000, 1.5), DRIVE[:4000]])
    measured = record(drive=drive)
    (view,), _ = views_of(eoi.identify(plant(values=NOMINAL), measured))
    np.testing.assert_allclose(view.inputs[: 1000 // view.thin], 1.5, rtol=1e-9)
    np.testing.assert_array_equal(view.variables[:, -1], measured.time[:: view.thin])
