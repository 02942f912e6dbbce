"""One record without `validation`: what its own answer leaves open, its end judges."""

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.discovery.drift import drift_of_parameters
from eoi_jax.discovery.own_judge import divided

RATE, NOISE = 60.0, 4e-4


def swing(seed: int, friction: float, samples: int = 400) -> eoi.Record:
    """A mass on a spring, released: damped half-swings about the displaced rest position.

    y'' + 0.15 y' + 49 y = -friction sign(y'), by the closed form of each half-swing.
    """
    square, decay = 49.0, 0.075
    rate = np.sqrt(square - decay**2)
    time = np.arange(samples) / RATE
    y, begin, place = np.empty(samples), 0.0, 0.08
    while square * abs(place) > friction and begin < time[-1]:
        rest = np.sign(place) * friction / square
        late = time - begin
        swinging = (late >= 0.0) & (late < np.pi / rate)
        angle = rate * late[swinging]
        wave = np.cos(angle) + decay / rate * np.sin(angle)
        y[swinging] = rest + (place - rest) * np.exp(-decay * late[swinging]) * wave
        place = rest - (place - rest) * np.exp(-decay * np.pi / rate)
        begin += np.pi / rate
    y[time >= begin] = place
    y += NOISE * np.random.default_rng(seed).standard_normal(samples)
    return eoi.Record(time, np.zeros((samples, 0)), y, input_names=(), output_names=("x",))


def spring(t, x, u, p):
    return -p.stiffness * x.y[0] - p.damping * x.y[1]


def spring_with_friction(t, x, u, p):
    return spring(t, x, u, p) - p.friction * jnp.sign(x.y[1])


PLANT = eoi.Plant(
    spring, {"stiffness": 40.0, "damping": 0.1}, 2, inputs=(), outputs=("x",), units={"x": "m"}
)


@pytest.mark.slow
def test_dry_friction_is_no_sinusoid_in_time():
    found = eoi.discover(PLANT, swing(2, 0.25))
    assert found.effects == ("coulomb_friction",)
    assert found.plant.parameters["coulomb_friction"] == pytest.approx(0.25, abs=0.01)
    assert not found.in_sample
    assert any("no `validation` was given" in note for note in found.notes)


def test_a_model_that_lacks_nothing_is_not_accused_for_a_record_that_goes_on_at_rest():
    values = {"stiffness": 40.0, "damping": 0.1, "friction": 0.3}
    plant = eoi.Plant(spring_with_friction, values, 2, inputs=(), outputs=("x",))
    found = eoi.discover(plant, swing(3, 0.6))
    assert found.status.code == "nothing_missing"
    assert found.plant.parameters["stiffness"] == pytest.approx(49.0, rel=0.05)


def test_what_is_held_out_is_the_end_of_the_motion_and_the_rest():
    record = swing(4, 0.6)  # at rest after 1.35 s, a fifth, of 6.65 s
    parts = divided(PLANT, [record])
    assert parts is not None
    (fitted,), (judging,) = parts.fitted, parts.judging
    assert fitted.time[-1] == pytest.approx(0.7 * 0.2 * 6.65, abs=0.1)
    assert len(fitted) + len(judging) == len(record)


def test_an_end_in_which_nothing_is_seen_does_not_show_that_nothing_is_missing():
    """A body that cools by radiation: its end is as that of a body that does not."""
    time, kelvin = 30.0 * np.arange(200), [673.15]
    for _ in time[1:]:
        radiated = 1e-11 * (kelvin[-1] ** 4 - 294.15**4)
        kelvin.append(kelvin[-1] - 30.0 * (4e-4 * (kelvin[-1] - 294.15) + radiated))
    noise = 0.5 * np.random.default_rng(0).standard_normal(200)
    record = eoi.Record(time, np.zeros((200, 0)), np.asarray(kelvin) - 273.15 + noise)
    body = eoi.Plant(lambda t, x, u, p: -p.k * (x.y[0] - 21.0), {"k": 3e-4}, 1, inputs=())
    found = eoi.discover(body, record, effects=["coulomb_friction"])
    assert found.status.code == "unexplained"
    assert "on the records of the fit, though not on the end" in found.status.message


def test_records_too_short_to_judge_stay_as_they_are():
    assert divided(PLANT, [swing(5, 0.1, samples=16)]) is None


HOURS = np.r_[0, 0.25, 0.5, 0.75, 1, 1.5, 2, 3, 4, 6, 8, 12, 16, 24]
DOSED = eoi.plant_from_text(
    {"gut": "-absorption*gut + dose/0.25", "level": "absorption*gut/volume - loss*level"},
    {"absorption": 1.0, "loss": 0.1, "volume": 20.0}, outputs=["level"], inputs=["dose"],
    initial={"gut": 0.0, "level": 0.0},
)  # fmt: skip


def dosed(seed: int, dose: float, noise: float = 0.1) -> eoi.Record:
    """A dose that runs in for a quarter of an hour is absorbed and lost: fourteen samples."""
    truth = DOSED.with_parameters({"absorption": 1.4, "loss": 0.2, "volume": 30.0})
    time = np.arange(97) * 0.25
    drive = np.where(time == 0.0, dose, 0.0)
    level = eoi.simulate(truth, time, drive, hold="zero", substeps=4).outputs[:, 0]
    places = np.round(HOURS / 0.25).astype(int)
    values = level[places] + noise * np.random.default_rng(seed).standard_normal(len(HOURS))
    return eoi.Record(
        HOURS, drive[places], values, f"run {seed}", input_names=["dose"], output_names=["level"],
        hold="zero",
    )  # fmt: skip


@pytest.mark.filterwarnings("ignore::eoi_jax.RecordWarning")  # stamps are far and unevenly apart
@pytest.mark.slow
def test_of_records_whose_ends_are_too_short_to_judge_one_is_held_out():
    records = [dosed(16 + i, dose) for i, dose in enumerate((320.0, 160.0, 320.0, 240.0))]
    parts = divided(DOSED, records)
    assert parts is not None
    assert [record.name for record in parts.judging] == ["run 19"]
    found = eoi.discover(DOSED, records)
    assert found.status.code == "nothing_missing"
    assert any("run 19 was held out as a whole" in note for note in found.notes)
    for name, value in {"absorption": 1.4, "loss": 0.2, "volume": 30.0}.items():
        assert abs(found.plant.parameters[name] - value) < 4.0 * found.found.standard_errors[name]


@pytest.mark.filterwarnings("ignore::eoi_jax.RecordWarning")
def test_a_record_of_which_nothing_can_be_held_out_is_judged_with_the_model_refined():
    record = dosed(3, 320.0)
    assert divided(DOSED, [record]) is None
    found = eoi.discover(DOSED, record, effects="actuator_lag")
    assert (found.status.code, found.in_sample) == ("nothing_missing", True)
    assert any("too short, or too few, to hold any of them out" in note for note in found.notes)
    assert found.plant.parameters["volume"] == pytest.approx(30.0, rel=0.05)


def test_what_free_runs_alone_hint_at_is_told():
    """A pendulum with dry friction so small that its injection is within the noise."""

    def pendulum(t, x, u, p):
        return -p.square * jnp.sin(x.y[0]) - p.damping * x.y[1]

    def rubbing(t, x, u, p):
        return pendulum(t, x, u, p) - 0.05 * jnp.sign(x.y[1])

    values, time = {"square": 17.6, "damping": 0.05}, np.arange(400) / 30.0
    plants = [eoi.Plant(f, values, 2, inputs=(), outputs=("angle",)) for f in (pendulum, rubbing)]
    notes = []
    for plant in plants:
        run = eoi.simulate(plant, time, np.zeros((400, 0)), {"angle": (0.5, 0.0)}, substeps=32)
        noise = 3e-3 * np.random.default_rng(0).standard_normal(run.outputs.shape)
        answer = eoi.discover(plants[0], run.with_outputs(run.outputs + noise, "measured"))
        assert answer.status.code == "nothing_missing"
        notes.append([note for note in answer.notes if "hint at coulomb_friction" in note])
    assert (len(notes[0]), len(notes[1])) == (0, 1)


def test_a_gain_that_falls_with_time_is_found_where_the_residual_follows_time():
    def heated(t, x, u, p):
        return -x.y[0] / p.lag + p.gain * u

    def run(seed: int) -> eoi.Record:
        rng, lag, step, count = np.random.default_rng(seed), 30.0, 2.0, 1800
        u = rng.uniform(20.0, 80.0, count // 60).repeat(60)
        time, y = step * np.arange(count), np.zeros(count)
        decay = np.exp(-step / lag)
        for k in range(count - 1):
            level = lag * 0.02 * (1.0 - 1e-4 * (time[k] + 0.5 * step)) * u[k]
            y[k + 1] = level + (y[k] - level) * decay
        return eoi.Record(time, u, y + 0.02 * rng.standard_normal(count), hold="zero")

    plant = eoi.Plant(heated, {"lag": 25.0, "gain": 0.015}, 1, inputs=("u",), outputs=("y",))
    found = eoi.discover(plant, run(1), run(2))
    assert found.effects == ("parameter_dependence",)
    assert found.added[0].parameters["parameter_dependence_gain_time"] < 0.0


def heating(seed: int, rise: float) -> eoi.Record:
    """A coil whose resistance rises by that share a second, behind volts without a mean."""
    rng, period, count = np.random.default_rng(seed), 1.0 / 20e3, 3000
    volts = rng.uniform(-10.0, 10.0, count // 40).repeat(40)
    time, current, inductance = period * np.arange(count), np.zeros(count), 0.8e-3
    for k in range(count - 1):
        resistance = 1.2 * (1.0 + rise * (time[k] + 0.5 * period))
        level = volts[k] / resistance
        current[k + 1] = level + (current[k] - level) * np.exp(-period * resistance / inductance)
    noisy = current + 5e-3 * rng.standard_normal(count)
    return eoi.Record(time, volts, noisy, hold="zero", input_names=("v",), output_names=("i",))


COIL = eoi.Plant(
    lambda t, x, u, p: (u[0] - p.R * x.y[0]) / p.L, {"R": 1.0, "L": 1e-3}, 1, ("v",), ("i",)
)


def test_a_resistance_that_rises_with_time_is_found_though_the_residual_has_no_mean():
    answer = eoi.discover(COIL, heating(1, 1.5), heating(2, 1.5))
    assert (answer.status.code, answer.effects) == ("complete", ("parameter_dependence",))
    name = "parameter_dependence_R_time"
    slope, middle = 1.5, 0.5 * 2999 / 20e3  # R (1 + a (t - middle)) = R_0 (1 + slope t)
    assert answer.plant.parameters[name] == pytest.approx(slope / (1.0 + slope * middle), rel=0.01)


def test_a_coil_of_constant_resistance_has_no_drift():
    """Of twenty, at a level of one hundredth each; one that rises takes all of the residual."""
    shares = [drift_of_parameters(eoi.identify(COIL, heating(s, 0.0)), 0.01) for s in range(20)]
    assert sum(share > 0.0 for share in shares) <= 1
    assert drift_of_parameters(eoi.identify(COIL, heating(0, 1.5)), 0.01) > 0.99
