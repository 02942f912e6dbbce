"""Coefficients that depend on a measured signal are found, and only where they are."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import eoi_jax as eoi
from eoi_jax.discovery import round as round_of_search

H = 0.02


def slow_signal(draw: np.random.Generator, samples: int) -> np.ndarray:
    """Between 20 and 60."""
    place = np.linspace(0.0, 4.3, samples)
    parts = [np.sin(2.0 * np.pi * (f * place + draw.uniform())) for f in (0.37, 1.0, 1.9)]
    total = np.sum(parts, axis=0)
    return 20.0 + 40.0 * (total - np.min(total)) / np.ptp(total)


def integrated(rate, start, inputs, period) -> np.ndarray:
    """States at the samples, by SciPy; inputs are held."""
    states = [np.array(start, dtype=float)]
    for row in inputs[:-1]:
        run = solve_ivp(lambda t, x, w=row: rate(x, w), (0.0, period), states[-1], rtol=1e-8)
        states.append(run.y[:, -1])
    return np.array(states)


def heated_motor(seed: int, slope: float, noise: float = 1e-3, samples: int = 600) -> eoi.Record:
    """A speed whose friction falls with the temperature, which was measured."""
    draw = np.random.default_rng(seed)
    voltage = np.repeat(draw.uniform(-10.0, 10.0, samples // 12), 12)
    inputs = np.stack([voltage, slow_signal(draw, samples)], axis=1)

    def rate(x, w):
        return 3.0 * w[0] - 2.0 * np.exp(slope * (w[1] - 40.0)) * x

    speed = integrated(rate, [0.0], inputs, H)
    speed += noise * np.std(speed) * draw.standard_normal(speed.shape)
    return eoi.Record(H * np.arange(samples), inputs, speed, hold="zero",
                      input_names=("voltage", "temperature"), output_names="speed")  # fmt: skip


MOTOR = eoi.plant_from_text(
    {"speed": "k*voltage - d*speed"}, {"k": 2.0, "d": 1.5}, ["speed"], ["voltage", "temperature"],
    units={"speed": "rad/s", "voltage": "V", "temperature": "°C"},
)  # fmt: skip
NAME = "parameter_dependence_d_temperature"


def names(found: eoi.Discovery) -> list[str]:
    return [added.label for added in found.added]


def test_friction_that_falls_with_a_temperature_is_found_among_those_asked_for():
    tried = ["parameter_dependence", "coulomb_friction", "input_action", "constant_offset"]
    records = heated_motor(1, -0.02), heated_motor(2, -0.02)
    found = eoi.discover(MOTOR, records[0], validation=records[1], effects=tried)
    assert names(found) == ["parameter_dependence (d of temperature)"]
    assert found.plant.parameters[NAME] == pytest.approx(-0.02, rel=5e-3)
    assert found.status.code == "complete"
    assert "a dependence of d on temperature of -0.0" in str(found)
    assert "which halves over 34." in str(found)
    assert f"d·exp({NAME}·(temperature - " in str(found)


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("noise", [1e-3, 1e-2])
def test_it_is_found_among_all_effects(noise):
    records = heated_motor(1, -0.02, noise), heated_motor(2, -0.02, noise)
    found = eoi.discover(MOTOR, records[0], validation=records[1])
    assert names(found) == ["parameter_dependence (d of temperature)"]
    assert found.plant.parameters[NAME] == pytest.approx(-0.02, rel=0.02)


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("seed", range(4))
def test_it_is_not_found_where_it_is_not(seed):
    records = heated_motor(10 + 2 * seed, 0.0, 1e-2), heated_motor(11 + 2 * seed, 0.0, 1e-2)
    found = eoi.discover(MOTOR, records[0], validation=records[1])
    assert names(found) == []


def tank(seed: int, law, samples: int = 500) -> eoi.Record:
    """A level whose outflow depends on the temperature of the oil, or of which something else."""
    draw = np.random.default_rng(seed)
    inputs = np.stack([np.repeat(draw.uniform(1.0, 6.0, samples // 25), 25),
                       slow_signal(draw, samples)], axis=1)  # fmt: skip
    level = integrated(lambda x, w: 0.02 * w[0] - 0.03 * law(w[1]) * np.sqrt(np.maximum(x, 0.0)),
                       [4.0], inputs, 1.0)  # fmt: skip
    level += 1e-3 * np.std(level) * draw.standard_normal(level.shape)
    return eoi.Record(np.arange(samples), inputs, level, hold="zero",
                      input_names=("pump", "oil"), output_names="level")  # fmt: skip


TANK = eoi.plant_from_text(
    {"level": "k*pump - c*sqrt(level)"}, {"k": 0.03, "c": 0.04}, ["level"], ["pump", "oil"],
    units={"level": "dm", "pump": "V", "oil": "°C"},
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.long
def test_the_form_of_the_law_is_told_and_no_action_of_the_signal_stands_in_for_it():
    """Where the level varies little, an action of the temperature does nearly the same."""
    fit, held_out = (tank(seed, lambda oil: 1.0 + 0.012 * (oil - 30.0)) for seed in (1, 2))
    found = eoi.discover(TANK, fit, validation=held_out)
    assert names(found) == ["parameter_dependence (c of oil, linear)"]
    (added,) = found.added
    (slope,) = added.parameters.values()
    assert isinstance(added.effect, eoi.effects.ParameterDependence)
    center = added.effect.center
    assert slope == pytest.approx(0.012 / (1.0 + 0.012 * (center - 30.0)), rel=0.01)


def test_a_score_test_of_free_runs_says_which_parameter_changes():
    record = heated_motor(3, -0.005, samples=300)
    refinement = eoi.refine(MOTOR, record)
    pairs = eoi.effects.parameter_dependences(MOTOR, [record])
    tested = eoi.remaining(refinement, [*pairs, eoi.effects.CoulombFriction()])
    best = tested.ranking[0]
    assert best.placed[0].effect.form == "d of temperature"
    assert best.share > 0.9


def test_of_a_parameter_of_an_internal_state_there_is_no_score():
    plant = eoi.plant_from_text(
        {"speed": "k*force - d*speed", "force": "(voltage - force)/lag"},
        {"k": 3.0, "d": 2.0, "lag": 0.1}, ["speed"], ["voltage", "temperature"],
        initial={"force": 0.0},
    )  # fmt: skip
    record = heated_motor(3, -0.005, samples=300)
    pairs = eoi.effects.parameter_dependences(plant, [record])
    assert "lag of temperature" in {effect.form for effect in pairs}
    tested = eoi.remaining(eoi.refine(plant, record), pairs)
    forms = {candidate.placed[0].effect.form for candidate in tested.ranking}
    assert "d of temperature" in forms
    assert "lag of temperature" not in forms


def test_each_pair_of_a_parameter_and_a_signal_counts_as_tried(monkeypatch):
    """The level of false alarms is for all of them together."""
    counts = []
    problem = round_of_search.SearchProblem

    def counted(*arguments):
        counts.append(arguments[4])
        return problem(*arguments)

    monkeypatch.setattr(round_of_search, "SearchProblem", counted)
    record = heated_motor(1, 0.0, 1e-2, samples=300)
    pairs = eoi.effects.parameter_dependences(MOTOR, [record])
    eoi.discover(MOTOR, record, effects=["parameter_dependence", "coulomb_friction"])
    assert counts[0] == len(pairs) + 1


COIL = eoi.plant_from_text(
    {"i": "(u - r*i - b*v/1000)/l", "x": "v", "v": "1000*(b*i - k*x/1000 - c*v/1000)/0.0145"},
    {"r": 5.0, "l": 5e-4, "b": 6.0, "c": 1.0, "k": 2000.0}, ["i", "x"], ["u"],
    units={"u": "V", "i": "A", "x": "mm"},
)  # fmt: skip


def woofer(seed: int, samples: int = 2500, period: float = 1e-4) -> eoi.Record:
    """A loudspeaker whose force factor falls with the square of its stroke, by Runge and Kutta."""
    draw, x, rows = np.random.default_rng(seed), np.zeros(3), []
    time = period * np.arange(samples)
    phases = 2.0 * np.pi * (np.outer(np.arange(20.0, 400.0, 20.0), time)
                            + draw.uniform(size=(19, 1)))  # fmt: skip
    voltage = np.sum(np.cos(phases) / np.sqrt(np.arange(1.0, 20.0))[:, None], axis=0) * 4.0

    def rate(x, u):
        force = 6.2 * (1.0 - 0.03 * x[1] ** 2)
        current = (u - 5.6 * x[0] - force * x[2] / 1000.0) / 6e-4
        push = 1000.0 * force * x[0] - 2300.0 * x[1] - 1.3 * x[2]
        return np.array([current, x[2], push / 0.0145])

    h = period / 4.0
    for u in voltage:
        rows.append(x[:2])
        for _ in range(4):
            first = rate(x, u)
            second = rate(x + 0.5 * h * first, u)
            third = rate(x + 0.5 * h * second, u)
            last = rate(x + h * third, u)
            x = x + h / 6.0 * (first + 2.0 * second + 2.0 * third + last)
    rows = np.array(rows)
    rows = rows + 1e-3 * np.std(rows, axis=0) * draw.standard_normal(rows.shape)
    return eoi.Record(time, voltage[:, None], rows, hold="zero", input_names="u",
                      output_names=("i", "x"))  # fmt: skip


@pytest.mark.slow
def test_a_force_factor_that_falls_to_both_sides_is_found():
    found = eoi.discover(COIL, woofer(1), validation=woofer(2))
    assert names(found) == ["parameter_dependence (b of x, even)"]
    values = found.plant.parameters
    assert values["parameter_dependence_b_x_i"] == pytest.approx(-0.03, rel=0.02)
    wanted = {"r": 5.6, "l": 6e-4, "b": 6.2, "c": 1.3, "k": 2300.0}
    for name, value in wanted.items():
        assert values[name] == pytest.approx(value, rel=0.01)


def sagging(seed: int, samples: int = 3000, period: float = 0.02) -> eoi.Record:
    """A roll rate whose gain falls by 30 % over the record, by a gyro that is off by 0.02 rad/s."""
    draw = np.random.default_rng(seed)
    drive = np.repeat(draw.uniform(-2.0, 2.0, samples // 30), 30)
    rate, decay = np.zeros(samples), np.exp(-4.0 * period)
    for k in range(samples - 1):
        gain = 5.0 * (1.0 - 0.3 * (k + 0.5) / samples)
        rate[k + 1] = decay * rate[k] + (1.0 - decay) / 4.0 * gain * drive[k]
    measured = rate + 0.02 + 0.005 * draw.standard_normal(samples)
    return eoi.Record(period * np.arange(samples), drive, measured, str(seed), hold="zero",
                      input_names="drive", output_names="rate")  # fmt: skip


@pytest.mark.slow
def test_effects_are_sought_beside_a_parameter_that_changes_with_time():
    plant = eoi.Plant(lambda t, x, u, p: p.gain * u[0] - p.damping * x.y[0],
                      {"gain": 4.0, "damping": 3.0}, inputs="drive", outputs="rate")  # fmt: skip
    found = eoi.discover(plant, sagging(1), sagging(2))
    assert (found.status.code, names(found)) == (
        "complete",
        [
            "parameter_dependence (gain of t, linear)",
            "constant_offset",
        ],
    )
    assert found.after is not None
    assert found.after.rmse[0] < 0.0055
    assert len(set(found.notes)) == len(found.notes)
