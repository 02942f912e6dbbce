"""The missing acceleration, mode by mode: order of convergence, noise, weights, thinning."""

import jax.numpy as jnp
import numpy as np
import pytest
from elastic_drive import elastic_drive

import eoi_jax as eoi
from eoi_jax.discovery.cosine_modes import (
    ModalRecord,
    averaged,
    averaging,
    informative_band,
    modal_record,
    model_rows,
    smoothing_cutoff,
    thinned,
)

BAND = 40.0  # [rad/s]


def spring(t, x, u, p):
    position, rate = x.y
    return -p.k * position - p.c * rate + p.b * u


def pendulum(t, x, u, p):
    angle, rate = x.y
    return -p.a * jnp.sin(angle) - p.b * rate + p.d * u


def push(t, x, u, p):
    return p.b * u


def rough(t, x, u, p):
    return p.b * u - p.c * jnp.sign(x.y[1])


MASS = eoi.Plant(spring, {"k": 20.0, "c": 0.8, "b": 2.0}, relative_degree=2)
PENDULUM = eoi.Plant(pendulum, {"a": 30.0, "b": 0.8, "d": 20.0}, relative_degree=2)
ROUGH = eoi.Plant(rough, {"b": 2.0, "c": 1.0}, relative_degree=2)


DRIVE = elastic_drive(b=30.0, c=1.0, k=100.0, d=0.3, r=2.0)


def size(one: ModalRecord, errors: np.ndarray) -> float:
    """Of what the model leaves, over y^(r), both rms."""
    whole = np.concatenate([one.rows(part, j) for j, part in enumerate(one.highest)])
    return float(np.sqrt(np.sum(errors**2) / np.sum(whole**2)))


def slope(errors: list[float]) -> float:
    """Order of convergence, each error at half the step of the one before."""
    return float(np.log2(errors[0] / errors[-1]) / (len(errors) - 1))


# -- the average that a difference sees -----------------------------------------------------------


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_difference_is_the_fourth_order_average_of_the_derivative(degree: int):
    """The r-th difference of sin is the integral of its r-th derivative over a B-spline."""
    errors = []
    for steps in (50, 100, 200):
        h = 3.0 / steps
        grid = h * np.arange(steps + 1)
        difference = np.diff(np.sin(2.0 * grid), degree)[1:-1] / h**degree
        middle = grid[:-1] + 0.5 * h
        derivative = 2.0**degree * np.sin(2.0 * middle + 0.5 * np.pi * degree)
        average = np.asarray(averaged(degree, jnp.asarray(derivative)))
        assert average.shape == difference.shape
        errors.append(float(np.max(np.abs(average - difference))))
    assert slope(errors) == pytest.approx(4.0, abs=0.1)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_average_has_the_moments_of_the_b_spline(degree: int):
    """Weight one, centred, variance r/12 less that of the step that each value stands for."""
    taps = averaging(degree)
    place = np.arange(len(taps)) - 0.5 * (len(taps) - 1)
    assert np.sum(taps) == pytest.approx(1.0)
    assert np.sum(taps * place) == pytest.approx(0.0, abs=1e-15)
    assert np.sum(taps * place**2) == pytest.approx(degree / 12.0)


# -- the true model leaves nothing ----------------------------------------------------------------


def smooth_record(plant: eoi.Plant, samples: int) -> eoi.Record:
    """A motion in closed form and the input that makes it."""
    h = 20.0 / samples
    time = h * np.arange(samples + 1)
    omega, phase = np.array([0.7, 1.9, 3.3, 5.1]), np.array([0.3, 1.0, 2.0, 5.0])
    turns = time[:, None] * omega + phase
    y, v, a = (np.sum(np.sin(turns + 0.5 * np.pi * k) * omega**k, axis=1) for k in range(3))
    state = jnp.asarray(np.stack([y, v]))  # all instants side by side
    forces = plant.dynamics(0.0, eoi.State(state, jnp.zeros(0)), 0.0, plant.named(plant.theta))
    drive = (a - np.asarray(forces)) / float(plant.theta[-1])
    return eoi.Record(time, drive, y, hold="smooth")


@pytest.mark.parametrize("plant", [MASS, PENDULUM], ids=["mass", "pendulum"])
def test_true_model_leaves_an_error_of_fourth_order(plant: eoi.Plant):
    errors = []
    for samples in (1000, 2000, 4000):
        one = modal_record(plant, smooth_record(plant, samples), 15.0)
        assert one.sample_period == pytest.approx(20.0 / samples)  # no sub-steps
        errors.append(size(one, model_rows(plant, [one])[0]))
    assert errors[-1] < 1e-6
    assert slope(errors) == pytest.approx(4.0, abs=0.3)  # interpolated states in their part


def test_wrong_model_leaves_what_it_lacks():
    """Modes of y^(r) - f of a model without spring are those of the spring's force."""
    one = modal_record(MASS, smooth_record(MASS, 2000), 15.0)
    without = model_rows(MASS.with_parameters({"k": 0.0}), [one])[0][0]
    slopes = model_rows(MASS, [one])[1][0]
    np.testing.assert_allclose(without, 20.0 * slopes[:, 0], atol=1e-5 * np.max(np.abs(without)))


def test_staircase_input_is_averaged_exactly():
    """f of the input alone: what remains of y'' = b u is rounding, jumps of u or not."""
    plant = eoi.Plant(push, {"b": 2.0}, relative_degree=2)
    time = 0.01 * np.arange(3000)
    drive = eoi.excitation.prbs(time, 1.0, 0.07, seed=5)
    one = modal_record(plant, eoi.simulate(plant, time, drive, hold="zero"), BAND)
    # The corrected samples are the inverse of the average to fourth order only: 1/24² of a jump.
    assert size(one, model_rows(plant, [one])[0]) < 1e-3
    jumps = plant, (one.u[None], one.u[None] * 0.99)
    apart = [model_rows(jumps[0], [one], [u])[0] for u in jumps[1]]
    assert size(one, apart[1]) == pytest.approx(0.01, rel=0.1)


def test_several_inputs_at_once_are_those_one_by_one():
    one = modal_record(MASS, smooth_record(MASS, 1000), 15.0)
    inputs = np.stack([one.u, 0.5 * one.u, one.u**2])
    together, slopes = model_rows(MASS, [one], [inputs])
    for i, u in enumerate(inputs):
        alone, own = model_rows(MASS, [one], [u[None]])
        np.testing.assert_allclose(together[i], alone[0], rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(slopes[i], own[0], rtol=1e-10, atol=1e-12)


def test_stretches_stand_one_behind_the_other():
    both = [modal_record(MASS, smooth_record(MASS, samples), 15.0) for samples in (1000, 2000)]
    error, slopes = model_rows(MASS, both)
    apart = [model_rows(MASS, [one])[0][0] for one in both]
    np.testing.assert_array_equal(error[0], np.concatenate(apart))
    assert slopes.shape == (1, len(error[0]), 3)


# -- measurement noise ----------------------------------------------------------------------------

TIME = 5e-3 * np.arange(8000)
MOVING = eoi.excitation.multisine(TIME, 1.0, (0.1, 2.0), 12, seed=1)
RESTING = eoi.excitation.square(TIME, 1.0, 0.1)
NOISY = {
    "mass": (MASS, 3.0 * MOVING),
    "mass with rests": (MASS.with_parameters({"c": 8.0}), 3.0 * RESTING),
    "pendulum": (PENDULUM, 0.6 * MOVING),
    "pendulum with rests": (PENDULUM.with_parameters({"b": 6.0}), 0.6 * RESTING),
    "motor behind whose shaft a load swings": (DRIVE, 0.5 * MOVING),
}


def noisy(clean: eoi.Record, share: float, seed: int) -> eoi.Record:
    noise = share * np.std(clean.outputs) * np.random.default_rng(seed).standard_normal(len(clean))
    return eoi.Record(
        clean.time, clean.inputs, clean.outputs + noise[:, None], hold=clean.hold, name=f"{seed}"
    )


def stretches(case: str, share: float) -> tuple[eoi.Plant, list[ModalRecord]]:
    plant, drive = NOISY[case]
    clean = eoi.simulate(plant, TIME, drive, substeps=2)
    return plant, [modal_record(plant, noisy(clean, share, seed), BAND) for seed in range(8)]


@pytest.mark.parametrize(
    ("case", "share", "tolerance"),
    [
        ("mass", 1e-2, 0.1),
        ("pendulum", 1e-3, 0.1),
        ("pendulum", 1e-2, 0.1),
        # What edges let in is spread over the modes as over their mean only.
        ("mass with rests", 1e-3, 0.15),
        ("mass with rests", 1e-2, 0.15),
        ("pendulum with rests", 1e-3, 0.15),
        ("pendulum with rests", 1e-2, 0.15),
    ],
)
def test_noise_in_each_mode_is_predicted(case: str, share: float, tolerance: float):
    """Eight seeds of some 500 modes: the mean ratio is known to three per cent."""
    plant, several = stretches(case, share)
    ratios = [np.mean(model_rows(plant, [one])[0][0] ** 2 / one.noise[:, 0]) for one in several]
    assert min(len(one.omega) for one in several) > 400
    if "rests" in case:
        assert np.mean(several[0].weight[0]) < 0.5
    assert np.mean(ratios) == pytest.approx(1.0, abs=tolerance)


def test_noise_that_an_internal_resonance_takes_up_is_predicted():
    """The measured speed drives the twist: noise rings at the antiresonance of the drive."""
    plant, several = stretches("motor behind whose shaft a load swings", 1e-2)
    resonance = np.sqrt(plant.parameters["r"] * plant.parameters["k"])
    omega, noise = several[0].omega, several[0].noise[:, 0]
    near, below = np.abs(omega - resonance) < 1.0, omega < 0.7 * resonance
    ratios = [model_rows(plant, [one])[0][0] ** 2 / one.noise[:, 0] for one in several]
    for modes in (near, below):
        assert np.mean(np.asarray(ratios)[:, modes]) == pytest.approx(1.0, abs=0.3)
    # Of the speed alone, without the shaft, it would be as in the neighbourhood.
    direct = omega**2 * np.mean(
        noise[omega > 2.5 * resonance] / omega[omega > 2.5 * resonance] ** 2
    )
    assert np.mean(noise[near] / direct[near]) > 30.0


@pytest.mark.parametrize("share", [1e-4, 1e-3])
def test_smoothing_leaves_less_than_the_floor_of_the_noise_model(share: float):
    """What all seeds have in common is no noise: the smoothing takes from the states."""
    plant, several = stretches("mass", share)
    errors = np.stack([model_rows(plant, [one])[0][0] for one in several])
    common = np.sum(errors.mean(axis=0) ** 2) - np.sum(errors.var(axis=0, ddof=1)) / len(errors)
    whole = np.sum(several[0].rows(several[0].highest[0], 0) ** 2)
    # The estimate has a spread of its own, from the noise that the edges at rests let in.
    assert np.sqrt(max(common, 0.0) / whole) < 2e-3  # the floor


def test_noise_at_sharp_edges_is_predicted_to_a_factor_of_two():
    """Small noise: moments of rest are cut out, and the edges leak."""
    plant, several = stretches("mass", 1e-4)
    assert np.mean(several[0].weight[0]) < 0.95
    errors = np.stack([model_rows(plant, [one])[0][0] for one in several])
    ratio = np.mean(errors.var(axis=0, ddof=1) / several[0].noise[:, 0])
    assert 0.5 < ratio < 2.0


def test_states_carry_less_noise_than_the_record():
    plant, drive = NOISY["mass"]
    clean = eoi.simulate(plant, TIME, drive, substeps=2)
    record = noisy(clean, 1e-2, 0)
    one = modal_record(plant, record, BAND)
    assert one.state_noise[0] < 0.6 * record.noise[0]


def lines(highest: float, share: float) -> eoi.Record:
    """Lines at 5, 10, … up to `highest` [rad/s], as strong in y'' each, and white noise."""
    time = 2e-3 * np.arange(20_000)
    omega = 5.0 * 2.0 ** np.arange(np.log2(highest / 5.0) + 0.5)
    clean = np.sum(np.cos(np.outer(time, omega) + omega) / omega**2, axis=1)
    noise = share * np.std(clean) * np.random.default_rng(1).standard_normal(len(time))
    return eoi.Record(time, np.zeros_like(time), clean + noise)


@pytest.mark.parametrize("share", [1e-3, 1e-2, 5e-2])
def test_band_ends_where_noise_hides_the_highest_derivative(share: float):
    """Lines as strong as these stand above the noise up to one of them, and no further."""
    record = lines(640.0, share)
    omega = 5.0 * 2.0 ** np.arange(8)
    # Power of y'' in a line of amplitude one, and that of the noise at all frequencies below.
    below = record.noise[0] ** 2 * 2e-3 / np.pi * omega**5 / 5.0
    top = omega[np.flatnonzero(np.diff(below, prepend=0.0) < 0.5)[-1]]
    # Power is averaged over neighbours, 5 % of the frequency on each side, before it is judged.
    assert top == pytest.approx(2.0 * informative_band(MASS, [record]), rel=0.1)


def test_more_noise_means_a_narrower_band():
    several = [informative_band(MASS, [lines(640.0, share)]) for share in (1e-3, 1e-2, 5e-2)]
    assert several[0] > 1.5 * several[1] > 2.0 * several[2]


@pytest.mark.parametrize("share", [1e-4, 1e-3])
def test_smoothing_passes_a_state_far_above_its_noise(share: float):
    """A line that stands out keeps all but the floor and what noise makes of it anyway."""
    record = lines(20.0, share)
    cutoff = smoothing_cutoff(MASS, record)
    assert cutoff is not None
    assert (20.0 / cutoff) ** 8 < 3e-3  # 2e-3 and some leakage of the window


# -- samples that do not count --------------------------------------------------------------------


def test_samples_in_a_gap_do_not_count():
    record = smooth_record(MASS, 4000)
    outputs = record.outputs.copy()
    outputs[1500:1900] = np.nan
    with pytest.warns(eoi.RecordWarning):
        gap = eoi.Record(record.time, record.inputs, outputs, hold="smooth")
    whole, one = (modal_record(MASS, one, 15.0) for one in (record, gap))
    assert not np.any(one.weight[0][1500:1895])
    assert np.max(one.weight[0]) == pytest.approx(1.0)
    assert size(whole, model_rows(MASS, [one])[0]) < 1e-5


def test_samples_at_rest_do_not_count_where_friction_is_dry():
    time = 5e-3 * np.arange(8000)
    drive = eoi.excitation.square(time, 1.0, 0.1) * (np.mod(time, 10.0) < 4.0)
    record = eoi.simulate(ROUGH, time, drive, substeps=4)
    still = np.abs(np.gradient(record.outputs[:, 0])) < 1e-9
    assert 0.1 < np.mean(still) < 0.9
    one = modal_record(ROUGH, record, BAND)
    assert np.mean(one.weight[0][still[2:-2]]) < 0.05
    # Friction at rest is a reaction: with those samples in, it would be a tenth of y''.
    assert size(one, model_rows(ROUGH, [one])[0]) < 0.01


def test_rows_before_the_relative_degree_are_empty():
    mixed = eoi.Plant(
        lambda t, x, u, p: jnp.stack([p.b * u[0] - x.y[1, 0], -p.a * x.y[0, 1]]),
        {"a": 1.0, "b": 2.0},
        relative_degree=(2, 1),
        outputs=("cart", "level"),
    )
    time = 0.01 * np.arange(1500)
    drive = eoi.excitation.multisine(time, 1.0, (0.2, 2.0), 6, seed=3)
    record = eoi.simulate(mixed, time, drive, [[0.0, 1.0], [0.0, 0.0]], hold="linear")
    one = modal_record(mixed, record, 15.0)
    assert not np.any(one.y[:, 1, 1])
    assert len(one.highest) == len(one.weight) == 2
    assert size(one, model_rows(mixed, [one])[0]) < 1e-3


# -- thinning -------------------------------------------------------------------------------------


def test_thinning_is_one_linear_operation():
    random = np.random.default_rng(2)
    one = modal_record(MASS, smooth_record(MASS, 4000), 15.0)
    first, second = random.standard_normal((2, len(one.weight[0])))
    apart = [np.asarray(thinned(part, one.weight[0], one.kernel)) for part in (first, second)]
    both = np.asarray(thinned(np.stack([3.0 * first - second, first]), one.weight[0], one.kernel))
    np.testing.assert_allclose(both[0], 3.0 * apart[0] - apart[1], atol=1e-12)
    np.testing.assert_allclose(both[1], apart[0], atol=1e-12)


def test_thinning_spreads_each_sample_over_four_nodes_of_weight_one():
    one = modal_record(MASS, smooth_record(MASS, 4000), 15.0)
    assert one.kernel.shape[1] == 4
    assert len(one.kernel) > 1
    np.testing.assert_allclose(one.kernel.sum(axis=1), 1.0)
    impulse = np.zeros(len(one.weight[0]))
    impulse[1000] = 1.0
    nodes = np.asarray(thinned(impulse, np.ones_like(impulse), one.kernel))
    assert np.sum(nodes) == pytest.approx(1.0)
    assert np.count_nonzero(nodes) <= 4


def test_modes_hold_the_power_of_a_signal_within_the_band():
    one = modal_record(MASS, smooth_record(MASS, 4000), 15.0)
    time = one.time[1:-2] + 0.5 * one.sample_period  # of the second difference
    window = np.sin(np.pi * np.arange(len(time)) / len(time)) ** 2
    signal = np.sin(2.0 * time) + 0.3 * np.cos(3.0 * time)
    rows = one.rows(np.asarray(thinned(signal, window, one.kernel)), 0)
    power = one.sample_period * np.sum((window * signal) ** 2)
    # The B-splines take (ω spacing)²/3 of the power.
    assert np.sum(rows**2) == pytest.approx(power, rel=(3.0 * 8 * 5e-3) ** 2 / 3.0)
    peak = one.omega[np.argmax(np.abs(rows))]
    assert peak == pytest.approx(2.0, abs=np.pi / 20.0)


def test_band_stays_below_half_of_the_nyquist_frequency():
    record = smooth_record(MASS, 1000)
    one = modal_record(MASS, record, 1e6)
    assert one.omega[-1] <= 0.5 * np.pi / record.sample_period
    assert one.sample_period < record.sample_period  # fast against the step: sub-steps
