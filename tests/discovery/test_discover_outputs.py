"""Effects on outputs that are functions of the states, and of the inputs that they show at once."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from output_cases import BATTERY, accelerometer, battery, battery_record, current, mixed, shaken
from scipy.linalg import expm
from scipy.signal import lfilter

from eoi_jax.comparators import (
    PlainExplicit,
    StateVariableFilter,
    StateVariableInstruments,
    VSSDirect,
)
from eoi_jax.data.record import Record
from eoi_jax.discovery.acceptance import answered, judged
from eoi_jax.discovery.cosine_modes import modal_record, motion
from eoi_jax.discovery.diagnose import diagnose
from eoi_jax.discovery.discover import discover
from eoi_jax.estimation.defaults import output_noise
from eoi_jax.estimation.identify import identify
from eoi_jax.models.effects import ConstantOffset, QuadraticDrag
from eoi_jax.models.effects.library import standard
from eoi_jax.models.equations.text_model import plant_from_text
from eoi_jax.models.placements import placements
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.refine import refine
from eoi_jax.refinement.remaining import remaining

START = {"R0": 0.027, "R1": 0.022, "C1": 1400.0, "Q": 7300.0}
SAMPLES = 1200


def cell_record(seed: int, change: Any = None, extra: Any = None, lag: float = 0.0) -> Record:
    """The cell under a changed current, which reaches it behind a lag; `extra` on its voltage.

    Exact for a held current: one matrix exponential of the lag, v1 and soc a second.
    """
    draw = np.random.default_rng(seed)
    time = np.arange(float(SAMPLES))
    amperes = current(seed, SAMPLES) + np.repeat(draw.normal(0.0, 0.5, SAMPLES // 6), 6)
    acting = amperes if change is None else change(amperes)
    rate = 1.0 / lag if lag else 0.0
    direct = 0.0 if lag else 1.0
    capacity, tau = BATTERY["C1"], BATTERY["R1"] * BATTERY["C1"]
    matrix = np.zeros((4, 4))
    matrix[0] = [-rate, 0.0, 0.0, rate]
    matrix[1] = [(1.0 - direct) / capacity, -1.0 / tau, 0.0, direct / capacity]
    matrix[2] = [-(1.0 - direct) / BATTERY["Q"], 0.0, 0.0, -direct / BATTERY["Q"]]
    step, states = expm(matrix)[:3], [np.array([acting[0], 0.0, 0.8])]
    for i in acting[:-1]:
        states.append(step @ np.append(states[-1], i))
    behind, v1, soc = np.transpose(states)
    behind = behind if lag else acting
    voltage = 3.4 + 0.7 * soc - BATTERY["R0"] * behind - v1
    voltage = voltage + (0.0 if extra is None else extra(time))
    return Record(
        time,
        amperes,
        voltage + 1e-3 * draw.standard_normal(SAMPLES),
        f"cell {seed}",
        hold="zero",
        input_names=("current",),
        output_names=("voltage",),
        units={"current": "A", "voltage": "V"},
    )


CASES: dict[str, Any] = {
    "constant_offset": ({"extra": lambda t: 0.02 + 0.0 * t}, {"constant_offset": 0.02}),
    "drift": ({"extra": lambda t: -4e-5 * t}, {"drift": -4e-5}),
    "sinusoidal_disturbance": (
        {"extra": lambda t: 0.01 * np.sin(0.2 * t)},
        {"sinusoidal_disturbance_sine": 0.01, "sinusoidal_disturbance_frequency": 0.2},
    ),
    "input_quadratic": (
        {"change": lambda i: i + 0.15 * i * np.abs(i)},
        {"input_quadratic": 0.15},
    ),
    "input_asymmetry": ({"change": lambda i: i + 0.2 * np.abs(i)}, {"input_asymmetry": 0.2}),
    "input_saturation": ({"change": lambda i: np.clip(i, -1.6, 1.6)}, {"input_saturation": 1.6}),
    "input_dead_zone": (
        {"change": lambda i: np.sign(i) * np.maximum(np.abs(i) - 0.4, 0.0)},
        {"input_dead_zone": 0.4},
    ),
    "input_delay": (
        {"change": lambda i: np.concatenate([i[:1].repeat(3), i[:-3]])},
        {"input_delay": 3.0},
    ),
    "actuator_lag": ({"lag": 4.0}, {"actuator_lag": 4.0}),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", list(CASES))
def test_an_effect_on_an_output_or_its_input_is_found(name):
    arguments, values = CASES[name]
    records = [cell_record(seed, **arguments) for seed in (1, 2, 3)]
    found = discover(battery(**START), records[:2], records[2])
    assert (found.status.code, found.effects) == ("complete", (name,))
    assert found.after is not None
    np.testing.assert_allclose(found.after.rmse, 1e-3, rtol=0.1)
    for key, value in values.items():
        np.testing.assert_allclose(found.plant.parameters[key], value, rtol=0.03)


@pytest.mark.slow
def test_a_model_that_lacks_nothing_gets_nothing():
    records = [cell_record(seed) for seed in (1, 2, 3)]
    found = discover(battery(**START), records[:2], records[2])
    assert (found.status.code, found.effects) == ("nothing_missing", ())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plant", "outputs", "name"),
    [
        (accelerometer(b=3.0, k=80.0), ("acc",), "constant_offset"),
        (mixed(b=3.0, k=80.0, gain=0.9), ("x", "acc"), "constant_offset_acc"),
    ],
)
def test_an_offset_of_an_accelerometer_is_found(plant, outputs, name):
    records = []
    for seed in (1, 2, 3):
        record = shaken(seed, 0.05, outputs)
        small = np.random.default_rng(seed).standard_normal(record.outputs.shape)
        noise = small * [2e-5 * (key == "x") for key in outputs]
        shift = np.asarray([0.3 * (key == "acc") for key in outputs])
        records.append(
            Record(
                record.time,
                record.inputs,
                record.outputs + noise + shift,
                record.name,
                hold="linear",
                input_names=("base",),
                output_names=outputs,
            )
        )
    found = discover(plant, records[:2], records[2])
    assert found.effects == ("constant_offset",)
    np.testing.assert_allclose(found.plant.parameters[name], 0.3, rtol=0.02)


def position_in(unit: float) -> Plant:
    """Position, of so many units in a metre, and acceleration of a mass on a base that moves."""

    def both(t, x, u, p):
        acceleration = (-p.b * x.y[1, 0] - p.k * (x.y[0, 0] - unit * u[0])) / p.m
        return jnp.stack([acceleration, acceleration / unit])

    return Plant(
        both, {"m": 3.0, "b": 3.0, "k": 80.0}, (2, 0), inputs=("base",), outputs=("x", "acc"),
        fixed=("m",),
    )  # fmt: skip


@pytest.mark.slow
def test_an_answer_does_not_depend_on_the_unit_of_another_output():
    """A bias of the accelerometer, beside a position in metres and in micrometres."""
    answers = []
    for unit in (1.0, 1e6):
        records = []
        for seed in (1, 2, 3):
            record = shaken(seed, 0.05, ("x", "acc"))
            noise = np.random.default_rng(seed).standard_normal(record.outputs.shape)
            measured = (record.outputs + noise * [2e-5, 0.0] + [0.0, 0.3]) * [unit, 1.0]
            records.append(
                Record(
                    record.time,
                    record.inputs,
                    measured,
                    record.name,
                    hold="linear",
                    input_names=("base",),
                    output_names=("x", "acc"),
                )
            )
        answers.append(discover(position_in(unit), records[:2], records[2]))
    metres, micrometres = answers
    assert metres.effects == micrometres.effects == ("constant_offset",)
    assert metres.status.code == micrometres.status.code == "complete"
    assert micrometres.explained == pytest.approx(metres.explained, rel=1e-4)
    shares = [
        {(row.effect, row.output): row.explained for row in answer.ranking} for answer in answers
    ]
    assert shares[1] == pytest.approx(shares[0], abs=1e-4)


@pytest.mark.slow
def test_a_pair_that_the_cell_lacks_is_found():
    """Open-circuit voltage and drop are declared, the relaxation of the RC pair is not."""
    plant = Plant(
        lambda t, x, u, p: 3.4 + p.slope * x.z[0] - p.R0 * u[0], {"slope": 0.6, "R0": 0.03}, 0,
        inputs=("current",), outputs=("voltage",), internal_initial=(0.8,),
        internal=lambda t, x, u, p: jnp.stack([-u[0] / BATTERY["Q"]]),
    )  # fmt: skip
    found = discover(plant, cell_record(1), validation=cell_record(2))
    assert found.effects == ("relaxation",)
    assert found.status.code == "complete"
    values = found.plant.parameters
    assert values["relaxation_gain"] == pytest.approx(BATTERY["R1"], rel=0.03)
    assert values["relaxation_time"] == pytest.approx(BATTERY["R1"] * BATTERY["C1"], rel=0.03)
    assert values["R0"] == pytest.approx(BATTERY["R0"], rel=0.03)


@pytest.mark.slow
def test_a_pair_that_is_small_beside_the_level_of_the_voltage_is_found():
    """A hundredth of the voltage is a tenth of what it moves by."""
    decay, records = np.exp(-1.0 / 180.0), []
    for seed in (1, 2, 3):
        record = cell_record(seed)
        behind = np.asarray(lfilter([0.0, 1.0 - decay], [1.0, -decay], record.inputs[:, 0]))
        records.append(record.with_outputs(record.outputs - 0.03 * behind[:, None], record.name))
    found = discover(battery(**START), records[:2], records[2])
    assert (found.status.code, found.effects) == ("complete", ("relaxation",))
    assert found.plant.parameters["relaxation_gain"] == pytest.approx(0.03, rel=0.05)
    assert found.plant.parameters["relaxation_time"] == pytest.approx(180.0, rel=0.1)


@pytest.mark.slow
def test_a_second_pair_that_leaves_noise_is_the_answer_whatever_it_takes_of_the_injection():
    """It takes 80 % to 90 % of that; a sinusoid, or Q that changes in time, stood in for it."""
    table = np.array([[0.0, 0.3, 0.6, 0.8, 1.0], [3.0, 3.6, 3.7, 3.88, 4.18]])
    decays, records = np.exp(-1.0 / np.array([30.0, 300.0])), []
    for seed in (5, 6):
        draw = np.random.default_rng(seed)
        amperes = np.repeat(draw.choice([0.0, 0.0, 1.3, 2.6, -1.3, 3.9], 60), 45)
        soc = 0.85 - np.concatenate([[0.0], np.cumsum(amperes[:-1])]) / 9360.0
        fast, slow = (
            np.asarray(lfilter([0.0, 1.0 - decay], [1.0, -decay], amperes)) for decay in decays
        )
        voltage = np.interp(soc, *table) - 0.03 * amperes - 0.02 * fast - 0.015 * slow
        voltage = np.round(voltage + 3e-4 * draw.standard_normal(len(amperes)), 3)
        records.append(
            Record(np.arange(len(amperes)) * 1.0, amperes, voltage, f"run {seed}", hold="zero",
                   input_names=["current"], output_names=["voltage"])
        )  # fmt: skip
    plant = Plant(
        lambda t, x, u, p: jnp.interp(x.z[0], *table) - p.R0 * u[0] - x.z[1],
        {"R0": 0.02, "R1": 0.03, "C1": 1000.0, "Q": 8600.0}, 0,
        inputs=("current",), outputs=("voltage",), internal_initial=(0.85, 0.0),
        internal=lambda t, x, u, p: jnp.stack([-u[0] / p.Q, (u[0] - x.z[1] / p.R1) / p.C1]),
    )  # fmt: skip
    found = discover(plant, records[0], validation=records[1])
    assert (found.status.code, found.effects) == ("complete", ("relaxation",))
    assert found.plant.parameters["relaxation_gain"] == pytest.approx(0.015, rel=0.02)
    assert found.explained < 0.95
    assert {"relaxation", "drift"} <= {row.effect for row in found.ranking}


def test_what_an_output_moves_by_has_nothing_to_do_with_its_level():
    plant, record = battery(**START), cell_record(1)
    raised = record.with_outputs(record.outputs + 100.0, "raised")
    moving = [motion(modal_record(plant, part, 0.5), 0, 0) for part in (record, raised)]
    np.testing.assert_allclose(*moving, rtol=1e-6, atol=1e-9)


def test_effects_of_a_state_have_no_place_on_such_an_output():
    names = {placed.effect.name for placed in placements(battery(), standard())}
    assert names == set(CASES)
    on_both = placements(mixed(), [QuadraticDrag(), ConstantOffset()])
    assert [(placed.effect.name, placed.channel) for placed in on_both] == [
        ("quadratic_drag", 0),
        ("constant_offset", 0),
        ("constant_offset", 1),
    ]
    record = cell_record(1)
    message = r"`effects` must hold one that fits battery, got quadratic_drag\. It has voltage of "
    with pytest.raises(ValueError, match=message + "relative degree 0"):
        discover(battery(**START), record, 0.3, effects=["quadratic_drag"])


def test_the_residual_of_a_right_model_is_noise_and_of_a_wrong_one_is_not():
    right = identify(battery(**START), cell_record(1))
    assert not any(diagnose(right).more_than_noise)
    wrong = identify(battery(**START), cell_record(1, extra=lambda t: 0.01 * np.sin(0.2 * t)))
    assert all(diagnose(wrong).more_than_noise)


def test_jumps_of_a_held_input_are_no_noise():
    record = battery_record()
    assert record.noise[0] > 2e-3
    np.testing.assert_allclose(output_noise(battery(), record), 1e-3, rtol=0.1)
    assert output_noise(battery(), cell_record(1)) == cell_record(1).noise  # it is never still
    found = diagnose(identify(battery(**START), record))
    np.testing.assert_allclose(found.noise, 1e-3, rtol=0.1)


def test_what_free_runs_lack_is_not_asked_of_such_a_plant():
    refined = refine(battery(**START), cell_record(1))
    message = (
        "`refinement` must be of a plant whose outputs are all states, got voltage of relative"
    )
    with pytest.raises(ValueError, match=message):
        remaining(refined)


def speeds(seed: int) -> Record:
    """A car's speed by its wheels, 5 % too high, and by a receiver that is six samples late."""
    draw, step, pole = np.random.default_rng(seed), 0.05, np.exp(-0.1 * 0.05)
    throttle = np.repeat(draw.uniform(0.0, 60.0, 50), 60)
    speed = np.asarray(lfilter([0.0, 0.5 * (1.0 - pole)], [1.0, -pole], throttle))
    late = np.r_[np.zeros(6), speed[:-6]]
    noise = draw.standard_normal((len(speed), 2)) * [0.05, 0.1]
    outputs = np.c_[1.05 * speed, late] + noise
    time = step * np.arange(len(speed))
    names = ("wheel", "gps")
    return Record(time, throttle, outputs, f"drive {seed}", input_names=("u",), output_names=names)


def test_a_late_sensor_beside_another_of_the_same_speed_is_answered():
    """Free runs, in which a response to the rate would be tried in its place, are not searched.

    They miss by more than noise, for the offset stands in for the gain of the wheels.
    """
    plant = plant_from_text(
        {"gps": "k*u - c*gps"},
        {"k": 0.04, "c": 0.08},
        ["wheel", "gps"],
        ["u"],
        output={"wheel": "gps"},
    )
    tried = ["input_delay", "constant_offset", "input_rate"]
    found = discover(plant, speeds(1), speeds(2), tried)
    assert (found.status.code, set(found.effects)) == ("partial", {*tried[:2]})
    assert "runs on the held-out records miss by more than noise" in found.status.message
    assert any(note.startswith("free runs of wheel in windows miss by ") for note in found.notes)


@pytest.mark.parametrize(
    "method", [StateVariableFilter, StateVariableInstruments, VSSDirect, PlainExplicit]
)
def test_methods_that_differentiate_say_that_they_do_not_apply(method):
    answer = method().estimate(battery(**START), [cell_record(1)])
    assert answer.status.code == "not_applicable"
    assert "voltage is a function of the states (relative degree 0)" in answer.status.message


def test_what_is_left_is_a_share_of_the_output_where_no_output_has_a_derivative():
    assert answered(0.95, 1.1e-3, (0,)).message.endswith("0.0011 of the output (rms)")
    assert answered(0.95, 1.1e-3, (2, 0)).message.endswith("0.0011 of the highest derivative (rms)")


def test_more_than_the_output_is_left_as_a_ratio():
    text = answered(0.95, 8.9, (0,)).message
    assert text.endswith("; the rms of what is left is 8.9 times that of the output")


def test_what_is_left_is_a_clause_of_its_own():
    assert answered(1.0, 0.0, (1,)).message.endswith("power; nothing is left beyond the noise")
    assert judged((), 0.0, 0.0, True, (0,)).message == "nothing is left beyond the noise"
    little = judged((), 0.0, 1e-4, True, (0,)).message
    assert little == ("what is left is 0.0001 of the output (rms): nothing that the data can name")
    more = judged((), 0.0, 0.5, False, (0,)).message
    assert more.startswith("what is left is 0.5 of the output (rms), more than noise, and none of")


def test_where_no_output_is_a_state_it_says_what_was_not_tried():
    untold = judged((), 0.0, 0.5, False, (0, 0)).message
    assert "no output is a state, so that what acts on states" in untold
    assert "of other motions" not in untold
    for degrees in ((2, 0), (1,)):
        assert judged((), 0.0, 0.5, False, degrees).message.endswith("of other motions, may tell")
