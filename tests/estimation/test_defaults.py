"""Gains and cut-off chosen from the records."""

import re

import jax.numpy as jnp
import numpy as np
import pytest
from problems import SWAY, Motion, grid, moved_mass_spring

import eoi_jax as eoi
from eoi_jax._checks import RecordWarning
from eoi_jax.data.record import Record
from eoi_jax.data.spectrum import Spectrum, foreign_lines, spectrum
from eoi_jax.estimation.defaults import (
    check_runs_of_samples,
    default_lowpass,
    default_observer,
    default_smoothing,
    default_substeps,
    default_transient,
    short_record_notes,
    too_short,
)
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.observers import FirstOrder, HighOrder, PerOutput, SecondOrder
from eoi_jax.models.library import Plant, level_tank, mass_spring_damper

H = 2e-3
TRUE = mass_spring_damper(true=True).parameters
PLANT = mass_spring_damper()
FREE = Plant(lambda t, x, u, p: -p.k * x.y[0], {"k": 50.0}, 2, inputs=())


def made(motion=SWAY, samples=8001, h=H, noise=0.0):
    u, y = moved_mass_spring(grid(samples, h), TRUE, motion)
    y = y + noise * np.random.default_rng(0).standard_normal(samples)
    return Record.from_period(h, u, y, hold="smooth")


def cutoff_of(*records, plant=PLANT):
    return default_lowpass(plant, records)[0].cutoff


@pytest.mark.parametrize("samples", [10, 20, 60, 150])
def test_one_very_short_record_has_no_say(samples):
    """Over its few samples any spectrum looks as wide as they are short."""
    record = made(noise=1e-3)
    several = [record, record[1000 : 1000 + samples]]
    lowpass, reason = default_lowpass(PLANT, [record])
    assert default_lowpass(PLANT, several) == (lowpass, reason)
    assert default_lowpass(PLANT, several[::-1]) == (lowpass, reason)
    for chosen in (
        lambda some: default_smoothing(PLANT, some, lowpass.cutoff),
        lambda some: default_transient(some, lowpass, explicit=False),
    ):
        assert chosen(several) == chosen([record])
    (note,) = short_record_notes(several, lowpass.cutoff, "left out")
    assert note.startswith(f"{record.name}: {samples * H:.3g} s are too short")


def test_records_of_similar_length_all_have_their_say():
    """The shortest a fifth of the longest: its own band, which is wider, counts."""
    quick = made(Motion((1.0, 0.5), (4.0, 60.0), (0.0, 1.0)), 1601)
    slow = made(Motion((1.0, 0.5), (4.0, 8.0), (0.0, 1.0)))
    assert too_short([slow, quick], 0.1) == (False, False)
    assert cutoff_of(slow, quick) == pytest.approx(60.0, abs=5.0)
    assert cutoff_of(slow) < 10.0


@pytest.mark.parametrize("top", [15.0, 60.0])
def test_cutoff_follows_the_band_of_the_highest_derivative(top):
    lowpass, reason = default_lowpass(PLANT, [made(Motion((1.0, 0.5), (4.0, top), (0.0, 1.0)))])
    # A line of the spectrum is smeared over two bins of 2π/16 s by the window.
    assert lowpass.cutoff == pytest.approx(top, abs=1.0)
    assert reason.startswith(f"cut-off {lowpass.cutoff:.4g} rad/s")
    assert "99 % of the power" in reason


def test_a_line_that_no_input_drives_does_not_widen_the_band():
    record = made(noise=1e-3)
    size = np.std(record.outputs)
    hum = 5e-3 * size * np.sin(2.0 * np.pi * 50.0 * record.time + 0.4)[:, None]
    loud = Record(record.time, record.inputs, record.outputs + hum, hold="smooth")
    one = spectrum(loud, 0, 2)
    assert one.frequency_below(0.5, one.signal) == pytest.approx(100.0 * np.pi, rel=0.05)
    assert cutoff_of(loud) == pytest.approx(cutoff_of(record), rel=0.1)
    # Where there is no input, or the input has that line as well, it may be the motion itself.
    alone = Record(record.time, np.zeros((len(loud), 0)), loud.outputs)
    driven = Record(record.time, record.inputs * (1.0 + hum / size), loud.outputs, hold="smooth")
    stirred = Record(record.time, record.inputs + 40.0 * hum / size, loud.outputs, hold="smooth")
    assert cutoff_of(alone, plant=FREE) > 3.0 * cutoff_of(record)
    assert cutoff_of(stirred) > 3.0 * cutoff_of(record)
    assert cutoff_of(driven) == pytest.approx(cutoff_of(record), rel=0.1)
    ((frequency, rms),) = foreign_lines(loud, 0)
    assert frequency == pytest.approx(100.0 * np.pi, rel=1e-3)
    assert rms == pytest.approx(5e-3 * size / np.sqrt(2.0), rel=0.2)  # noise of 1e-3 beside it
    for other in (record, alone, stirred):
        assert foreign_lines(other, 0) == []


def test_single_missing_samples_do_not_cut_a_spectrum_to_pieces():
    t = H * np.arange(40)
    y = np.sin(9.0 * t)
    y[3::4] = np.nan
    with pytest.warns(RecordWarning):
        record = Record(t, np.cos(5.0 * t), y)
    omega = spectrum(record, 0, 2).omega
    period = record.output_periods[0]
    assert period == pytest.approx(H * 38.0 / 29.0)  # three of four, the last of them at 38
    assert np.pi / period - omega[1] < omega[-1] <= np.pi / period
    assert cutoff_of(record) > 0.0


def test_band_grows_with_the_derivative_that_is_looked_at():
    record = made(Motion((1.0, 0.01), (3.0, 30.0), (0.0, 1.0)))
    slow = Plant(lambda t, x, u, p: p.a * u, {"a": 1.0})
    # 30 rad/s holds 1e-4 of the power of y, 1 % of that of ẏ, and half of that of ÿ.
    assert cutoff_of(record, plant=slow) < 4.0
    assert cutoff_of(record) == pytest.approx(30.0, abs=1.0)


@pytest.mark.parametrize("noise", [1e-5, 1e-4, 1e-3])
def test_noise_does_not_widen_the_band(noise):
    # ω⁴ lifts white noise far above the signal's ÿ at the Nyquist frequency of 1571 rad/s.
    cutoff = cutoff_of(made(noise=noise))
    assert cutoff <= cutoff_of(made()) + 1.0
    assert cutoff >= 6.0  # the motions at 7 and 12 rad/s hold most of the power of ÿ


def bins_with_signal(seed, tone=0.0, samples=3000):
    y = np.random.default_rng(seed).standard_normal(samples)
    y += tone * np.sin(300.0 * H * np.arange(samples))
    return np.count_nonzero(spectrum(Record.from_period(H, np.zeros(samples), y), 0, 2).signal)


def test_chance_lifts_no_bins_of_noise_above_its_floor():
    # At most 1 record of 1000 by design. Eight standard deviations of independent bins, the rule
    # before, are passed by 13: neighbouring bins of a windowed spectrum rise and fall together.
    assert sum(bins_with_signal(seed, samples=300) > 0 for seed in range(1000)) <= 2


def test_a_tone_that_stands_out_of_the_noise_is_seen():
    assert all(bins_with_signal(seed, tone=0.8) > 0 for seed in range(20))


def test_widest_record_decides():
    wide = made(Motion((1.0, 0.5), (4.0, 60.0), (0.0, 1.0)))
    assert cutoff_of(made(), wide) == cutoff_of(wide)


def test_cutoff_stays_a_decade_below_the_sampling_rate_and_says_so():
    record = made(Motion((1.0,), (200.0,), (0.0,)), samples=2001, h=1e-2)
    lowpass, reason = default_lowpass(PLANT, [record])
    assert lowpass.cutoff == pytest.approx(0.1 * 2.0 * np.pi / 1e-2)
    assert "a tenth of the sampling rate" in reason


def test_cutoff_leaves_twenty_time_constants_to_a_short_record_and_says_so():
    record = made(Motion((1.0,), (0.8,), (0.0,)), samples=4001)
    slow = Plant(lambda t, x, u, p: p.a * u, {"a": 1.0})
    lowpass, reason = default_lowpass(slow, [record])
    assert lowpass.cutoff == pytest.approx(20.0 / (4001 * H))
    assert "over the record's length" in reason


def test_an_output_that_stands_still_still_gets_a_filter():
    record = Record.from_period(H, np.zeros(100), np.full(100, 0.3))
    assert 0.0 < cutoff_of(record) < np.inf


def observer_for(plant, record):
    return default_observer(plant, [record], [record.midpoint_inputs()], 30.0)


def test_relay_is_twice_what_it_may_have_to_inject():
    record = made()
    observer, (reason,) = observer_for(PLANT, record)
    assert isinstance(observer, SecondOrder)
    t = grid(8001, H)
    alpha, beta, rho = PLANT.theta
    u = record.inputs[:, 0]
    missing = SWAY(t, 2) + alpha * SWAY(t) + beta * SWAY(t, 1) - rho * u
    relay = float(observer.c3[0])
    assert relay > 1.9 * np.max(np.abs(missing))
    bound = np.max(np.abs(SWAY(t, 2))) + np.max(np.abs(SWAY(t, 2) - missing))
    assert relay == pytest.approx(2.0 * bound, rel=0.01)
    # The reason names the relay, the bound, and the reach against the noise.
    numbers = re.findall(r"relay ([\d.e+]+), 2 times .*\(([\d.e+]+)\); its reach", reason)
    assert float(numbers[0][0]) == pytest.approx(relay, rel=5e-3)
    assert float(numbers[0][1]) == pytest.approx(relay / 2.0, rel=5e-3)
    assert reason.startswith("position: ")
    assert "times the measurement noise" in reason


@pytest.mark.parametrize("noise", [1e-5, 1e-3])
def test_relay_reaches_beyond_the_noise(noise):
    """In sliding while h² c3 is ten times the noise: differences of the noise are in the bound."""
    record = made(noise=noise)
    observer, _ = observer_for(PLANT, record)
    assert isinstance(observer, SecondOrder)
    assert H**2 * float(observer.c3[0]) > 8.0 * noise


def test_linear_gains_follow_the_cutoff():
    observer, _ = observer_for(PLANT, made())
    assert isinstance(observer, SecondOrder)
    assert float(observer.c1) == pytest.approx(1.4 * 30.0)
    assert float(observer.c2) == pytest.approx(30.0**2)
    assert observer.scheme == "implicit"


def test_degree_one_gets_the_first_order_observer():
    t = grid(2001, H)
    record = Record.from_period(H, np.sin(t), 0.5 + 0.1 * np.sin(3.0 * t), hold="smooth")
    observer, (reason,) = observer_for(level_tank(), record)
    assert isinstance(observer, FirstOrder)
    assert reason.startswith("level: delta ")


def test_higher_and_mixed_degrees_get_their_own_observers():
    t = grid(501, H)
    y = np.stack([SWAY(t), SWAY(t + 1.0), SWAY(t + 2.0)], axis=1)
    record = Record.from_period(H, np.sin(t), y, hold="smooth")
    mixed = Plant(lambda t, x, u, p: p.a * x.y[0], {"a": 1.0}, (1, 2, 3), outputs=("a", "b", "c"))
    observer, reasons = observer_for(mixed, record)
    assert isinstance(observer, PerOutput)
    assert [type(one) for one in observer.observers] == [FirstOrder, SecondOrder, HighOrder]
    assert [reason[:3] for reason in reasons] == ["a: ", "b: ", "c: "]
    same = Plant(lambda t, x, u, p: p.a * x.y[0], {"a": 1.0}, 3, outputs=("a", "b", "c"))
    observer, _ = observer_for(same, record)
    assert isinstance(observer, HighOrder)
    assert np.shape(observer.bound) == (3,)


def test_masked_samples_do_not_enter_the_bound():
    t = grid(2001, H)
    u, y = moved_mass_spring(t, TRUE)
    clean, _ = observer_for(PLANT, Record.from_period(H, u, y, hold="smooth"))
    spoilt, hole = np.array(y), np.array(y)
    hole[900:1000] = np.nan
    with pytest.warns(UserWarning, match="not finite"):
        record = Record.from_period(H, u, hole, hold="smooth")
    masked, _ = observer_for(PLANT, record)
    assert isinstance(clean, SecondOrder)
    assert isinstance(masked, SecondOrder)
    assert float(masked.c3[0]) <= 1.01 * float(clean.c3[0])
    spoilt[950:952] += 1.0  # outliers that are not masked do; a single one would be
    outlier, _ = observer_for(PLANT, Record.from_period(H, u, spoilt, hold="smooth"))
    assert isinstance(outlier, SecondOrder)
    assert float(outlier.c3[0]) > 1e3 * float(clean.c3[0])


def test_a_model_that_is_not_finite_somewhere_still_gets_a_finite_relay():
    plant = Plant(lambda t, x, u, p: -p.a * jnp.log(x.y[0]) + u, {"a": 1.0}, 2)
    observer, _ = observer_for(plant, made())
    assert isinstance(observer, SecondOrder)
    assert np.all(np.isfinite(observer.c3))


def test_substeps_make_the_step_short_against_the_filter_and_say_so():
    record = made(samples=401, h=1e-2)
    assert default_substeps(PLANT, [record], 0.1) == (1, [])  # ω h = 1e-3 already
    substeps, (reason,) = default_substeps(PLANT, [record], 30.0)
    assert reason.startswith(f"{substeps} sub-steps a sample")
    found = re.search(r"from ([\d.e-]+) to ([\d.e-]+) of the highest derivative", reason)
    assert found
    # (ω h)²/6 of the highest derivative, before and after; printed with two digits.
    assert float(found[1]) == pytest.approx(0.3**2 / 6.0, rel=0.05)
    assert float(found[2]) == pytest.approx((0.3 / substeps) ** 2 / 6.0, rel=0.05)
    assert float(found[2]) < 1e-3


def test_substeps_follow_the_slowest_record():
    fast, slow = made(samples=401, h=1e-3), made(samples=401, h=1e-2)
    assert (
        default_substeps(PLANT, [fast, slow], 30.0)[0] == default_substeps(PLANT, [slow], 30.0)[0]
    )


@pytest.mark.parametrize(
    ("hold", "rate", "wanted"),
    [("zero", 40.0, 1), ("zero", 400.0, 8), ("smooth", 4.0, 1), ("smooth", 40.0, 8)],
)
def test_substeps_follow_internal_states_where_no_output_is_differentiated(hold, rate, wanted):
    """|λh| of a step is at most 0.5 with held inputs, 0.05 with such that move within it."""
    plant = Plant(
        lambda t, x, u, p: x.z[0], {"a": rate}, 0, internal=lambda t, x, u, p: p.a * (u - x.z),
        internal_initial=(0.0,),
    )  # fmt: skip
    record = made(samples=401, h=1e-2).with_hold(hold)
    substeps, reasons = default_substeps(plant, [record], 30.0)
    assert substeps == wanted
    assert all(f"the internal states, {rate:g} rad/s" in reason for reason in reasons)
    assert len(reasons) == (wanted > 1)


def test_quiet_cutoff_is_that_of_every_frequency_by_itself():
    draw = np.random.default_rng(0)
    omega = np.linspace(0.0, 3000.0, 4000)
    signal, noise = draw.exponential(1.0, 4000) / (1.0 + omega) ** 2, 1e-14 * omega**4
    one, order, found = Spectrum(omega, signal, signal, noise), 3, 0.0
    for cutoff in np.geomspace(omega[1], omega[-1], 200):
        gain = 1.0 / (1.0 + (omega / cutoff) ** (2 * order))
        found = cutoff if gain @ noise <= 1e-6 * (gain @ signal) else found
    assert omega[5] < found < omega[-5]
    assert one.quiet_cutoff(1e-3, order) == pytest.approx(found, rel=1e-9)


def torn(kept, samples=2001):
    """A record of which only the samples in `kept` (of each ten) have an output."""
    u, y = moved_mass_spring(grid(samples, H), TRUE, SWAY)
    y = np.where(np.isin(np.arange(samples) % 10, kept), y, np.nan)
    with pytest.warns(RecordWarning):
        return Record.from_period(H, u, y, "torn", hold="smooth")


@pytest.mark.parametrize("kept", [(0, 2, 4, 6, 8), (0, 3, 6), (0, 1, 2, 3, 4, 5, 6)])
def test_no_run_of_samples_is_said_with_what_to_do(kept):
    """Two sensors of different rates look so."""
    with pytest.raises(ValueError, match=r"`records` must hold a run of at least 8 .* `refine`"):
        check_runs_of_samples([torn(kept)])


def test_a_torn_record_beside_whole_ones_has_no_say():
    whole, holed = made(), torn((0, 1, 2))
    chosen = default_lowpass(PLANT, [whole])
    assert default_lowpass(PLANT, [whole, holed]) == chosen
    assert default_lowpass(PLANT, [holed, whole]) == chosen
    assert short_record_notes([whole, holed], chosen[0].cutoff, "left out") == [
        "torn: no 8 valid samples follow each other: left out"
    ]
    assert foreign_lines(holed, 0) == []


def test_what_has_no_velocity_needs_no_smoothing():
    """A level is measured as it is: the model sees no derivative of it."""
    draw = np.random.default_rng(0)
    time = 1e-3 * np.arange(20_000)
    y = np.sin(3.0 * time) + 0.05 * draw.standard_normal(len(time))
    record = Record(time, np.cos(3.0 * time), y)
    assert default_smoothing(PLANT, [record], 10.0)[0] is not False
    assert default_smoothing(level_tank(), [record], 10.0) == (False, [])


def test_an_input_that_enters_squared_is_not_smoothed_before():
    """The square of a smoothed input is less than the smoothed square."""

    def lifted(t, x, u, p):
        return p.k * u[0] ** 2 + p.b * u[1] - p.d * x.y[1] - p.s * x.y[0]

    values = {"k": 20.0, "b": 3.0, "d": 0.5, "s": 4.0}
    plant = eoi.Plant(lifted, values, 2, inputs=("throttle", "flap"))
    time = grid(2000, 0.01)
    u = np.stack([eoi.excitation.random_steps(time, 0.3, 0.9, 0.2, seed=i) for i in (0, 1)], axis=1)
    record = eoi.simulate(plant, time, u, hold="zero")
    start = plant.with_parameters({"k": 18.0, "b": 2.0})
    found = eoi.identify(start, record, lowpass=LowPass(5.0, 3), smoothing=25.0, instruments=False)
    np.testing.assert_allclose(list(found.parameters.values()), list(values.values()), rtol=3e-4)
    noise = 1e-3 * np.random.default_rng(0).standard_normal(record.outputs.shape)
    noisy = record.with_outputs(record.outputs + noise, "noisy")
    reasons = default_smoothing(plant, [noisy], 4.0)[1]
    assert "but for those in which the model is not affine (throttle), zero phase" in reasons[0]


@pytest.mark.parametrize("period", [0.01, 3600.0])
def test_the_default_gain_of_a_slow_plant_keeps_it_in_sliding_mode(period):
    """The relay leaks within a second: it must reach the injection in steps of hours, too."""
    model = eoi.Plant(lambda t, x, u, p: -p.a * x.y[0] + p.b * u, {"a": 0.2 / period, "b": 1.0})
    true = model.with_parameters({"a": 0.1 / period, "b": 0.8})
    time = period * np.arange(400)
    u = np.random.default_rng(0).uniform(-1.0, 1.0, 40).repeat(10) / period
    found = eoi.identify(model, eoi.simulate(true, time, u, hold="zero"))
    assert found.sliding_fraction[0] == 1.0
    assert found.parameters["a"] == pytest.approx(0.1 / period, rel=1e-3)
