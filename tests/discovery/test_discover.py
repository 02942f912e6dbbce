"""Discovery from end to end on short records, and how it answers when something is wrong."""

import importlib
from functools import cache

import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery.additions import uncertain_effects
from eoi_jax.discovery.candidates import CandidateColumns
from eoi_jax.discovery.regression import Base, Fit
from eoi_jax.discovery.result import Added
from eoi_jax.discovery.rivals import akin, ambiguous
from eoi_jax.discovery.search import RankedSets, SearchProblem
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.effects.effect import AbstractTerm, Parameter

mpl.use("Agg")


def spring(t, x, u, p):
    position, rate = x.y
    return -p.k * position - p.c * rate + p.b * u


def crossed(t, x, u, p):
    """v y², damping that grows with the displacement: no law that the injection is searched for."""
    position, rate = x.y
    return spring(t, x, u, p) - p.hidden * rate * position**2


def swaying(t, x, u, p):
    """Outside the library: a stiffness that varies with time, about a point far from zero."""
    return spring(t, x, u, p) + p.hidden * jnp.sin(5.0 * t) * (x.y[0] + 2.0)


def position_gain(t, x, u, p):
    """Outside the library: a drive that grows with the position, and rests on a bias."""
    return spring(t, x, u, p) + p.hidden * (u[0] * x.y[0] + 6.0)


def damper(t, x, u, p):
    """A damper that is harder one way: its slope differs between the directions."""
    rate = x.y[1]
    return spring(t, x, u, p) - p.hidden * jnp.abs(rate)


def driven(t, x, u, p):
    rate = x.y[1]
    return spring(t, x, u, p) + p.hidden * rate * jnp.abs(rate)


TRUE = {"k": 20.0, "c": 0.8, "b": 2.0}
DECLARED = {"k": 26.0, "c": 0.6, "b": 1.6}
KNOWN = {"relative_degree": 2, "inputs": ("force",), "outputs": ("position",)}
UNITS = {"force": "N", "position": "m"}
MASS = eoi.Plant(spring, DECLARED, **KNOWN, units=UNITS, name="one mass")
# Friction, offset, springs and delay, and what each is easily taken for.
FEW = (
    "coulomb_friction",
    "asymmetric_friction",
    "quadratic_drag",
    "cubic_stiffness",
    "constant_offset",
    "input_delay",
)
SAMPLES, PERIOD = 8000, 5e-3
RELATIVE = 1e-4  # noise, of rms(y)


def measured(plant: eoi.Plant, seed: int, samples: int = SAMPLES, bias: float = 0.0) -> eoi.Record:
    time = PERIOD * np.arange(samples)
    drive = bias + eoi.excitation.multisine(time, 3.0, (0.1, 3.0), 16, seed=seed)
    clean = eoi.simulate(plant, time, drive, substeps=2, hold="linear").outputs
    noise = RELATIVE * np.std(clean) * np.random.default_rng(seed).standard_normal(clean.shape)
    return eoi.Record(
        time,
        drive,
        clean + noise,
        f"run {seed}",
        input_names=plant.inputs,
        output_names=plant.outputs,
        units=UNITS,
        hold="linear",
    )


def hiding(several: dict[effects.AbstractEffect, tuple[float, ...]]) -> eoi.Plant:
    """The true plant, with effects that the declared one lacks."""
    plant = MASS.with_parameters(TRUE)
    placed = [place(plant, effect, 0) for effect in several]
    values = {
        name: value
        for one in placed
        for name, value in zip(one.names, several[one.effect], strict=True)
    }
    return augmented(plant, placed, values)


HIDDEN = {
    "nothing": hiding({}),
    "coulomb": hiding({effects.CoulombFriction(): (0.5,)}),
    "delay": hiding({effects.InputDelay(): (0.031,)}),
    "level and offset": hiding(
        {effects.CoulombFriction(): (0.5,), effects.ConstantOffset(): (0.08,)}
    ),
    "asymmetric": hiding({effects.AsymmetricFriction(): (0.7, 0.35)}),
    "outside": eoi.Plant(crossed, {**TRUE, "hidden": 3.0}, **KNOWN, units=UNITS),
}


@cache
def records(case: str) -> tuple[eoi.Record, eoi.Record]:
    return measured(HIDDEN[case], 1), measured(HIDDEN[case], 2)


@cache
def found(case: str) -> eoi.Discovery:
    fit, held = records(case)
    tried = None if case == "coulomb" else FEW
    return eoi.discover(MASS, fit, held, tried)


def values(discovery: eoi.Discovery) -> dict[str, float]:
    return {name: value for one in discovery.added for name, value in one.parameters.items()}


def test_test_records_choose_nothing_and_are_scored_before_and_after():
    fit, held = records("level and offset")
    unseen = measured(HIDDEN["level and offset"], 3, 4000)
    answer = eoi.discover(MASS, fit, held, FEW, test=unseen)
    without = found("level and offset")
    assert answer.effects == without.effects
    assert answer.found.parameters == without.found.parameters
    before, after = answer.test_before, answer.test_after
    assert before is not None
    assert after is not None
    want = eoi.validate(answer.plant, unseen)
    np.testing.assert_allclose(after.rmse, want.rmse, rtol=1e-6)
    assert before.rmse[0] > 10.0 * after.rmse[0]
    assert answer.test_windows_after is not None
    assert "; on test data " in str(answer).splitlines()[0]
    assert "test RMSE of position" in str(answer)
    assert without.test_after is None
    assert "test" not in str(without)


def test_test_records_must_be_new():
    fit, held = records("nothing")
    for seen in (fit, held):
        with pytest.raises(ValueError, match=r"`test\[.*\]` must not be one of the records"):
            eoi.discover(MASS, fit, held, FEW, test=seen)


# -- what is found --------------------------------------------------------------------------------


def test_coulomb_friction_is_named_out_of_the_whole_library():
    answer = found("coulomb")
    assert answer.effects == ("coulomb_friction",)
    assert answer.status.code == "complete"
    assert values(answer)["coulomb_friction"] == pytest.approx(0.5, rel=1e-2)
    for name, value in TRUE.items():
        assert answer.plant.parameters[name] == pytest.approx(value, rel=1e-2)
    assert answer.explained > 0.99
    assert not answer.in_sample


def test_error_on_data_not_used_falls_to_the_noise():
    answer = found("coulomb")
    noise = RELATIVE * np.std(records("coulomb")[1].outputs)
    assert answer.before is not None
    assert answer.after is not None
    assert answer.windows_before is not None
    assert answer.windows_after is not None
    assert answer.before.rmse[0] > 30.0 * noise
    assert answer.after.rmse[0] < 3.0 * noise
    assert answer.windows_after.rmse[0] < answer.windows_before.rmse[0]


def test_delay_is_named():
    answer = found("delay")
    assert answer.effects == ("input_delay",)
    # Half a sample is a matter of how a record is read.
    assert values(answer)["input_delay"] == pytest.approx(0.031, abs=0.5 * PERIOD)
    assert answer.added[0].output == "force"


def test_one_level_and_an_offset_are_read_as_such():
    answer = found("level and offset")
    assert set(answer.effects) == {"coulomb_friction", "constant_offset"}
    assert values(answer)["coulomb_friction"] == pytest.approx(0.5, rel=0.02)
    assert values(answer)["constant_offset"] == pytest.approx(0.08, rel=0.1)
    assert "asymmetric_friction" in answer.ambiguous_with
    assert answer.advice


def test_levels_of_ratio_two_are_read_as_asymmetric_friction():
    answer = found("asymmetric")
    assert answer.effects == ("asymmetric_friction",)
    expected = {"asymmetric_friction_forward": 0.7, "asymmetric_friction_backward": 0.35}
    assert values(answer) == pytest.approx(expected, rel=0.03)
    assert {"coulomb_friction", "constant_offset"} <= set(answer.ambiguous_with)
    assert answer.advice


@pytest.mark.slow
@pytest.mark.long
def test_unequal_stops_at_both_ends_are_found_together():
    """One alone leaves as much as a cubic spring and a ripple: they enter in one round."""
    rig = hiding({effects.EndStop(+1): (300.0, 0.3), effects.EndStop(-1): (200.0, -0.2)})
    tried = ["end_stop", "cubic_stiffness", "position_ripple", "free_play"]
    answer = eoi.discover(MASS, measured(rig, 1), measured(rig, 2), tried)
    assert answer.effects == ("end_stop",)
    assert len(answer.added) == 2
    truth = {
        "end_stop_stiffness": 300.0, "end_stop_position": 0.3,
        "end_stop_lower_stiffness": 200.0, "end_stop_lower_position": -0.2,
    }  # fmt: skip
    assert {name: answer.plant.parameters[name] for name in truth} == pytest.approx(truth, rel=1e-2)
    # Each has a line of its own, told apart by the names of its parameters.
    assert {name for one in answer.ranking[:2] for name in one.parameters} == set(truth)


def test_nothing_is_added_to_a_model_that_lacks_nothing():
    answer = found("nothing")
    assert answer.effects == ()
    assert answer.added == ()
    assert answer.status.code == "nothing_missing"
    assert answer.explained == 0.0
    assert answer.plant.names == MASS.names
    assert answer.after is answer.before


@pytest.mark.slow
@pytest.mark.long
def test_effect_outside_those_that_are_asked_for_is_unexplained():
    answer = found("outside")
    assert answer.effects == ()
    assert answer.status.code == "unexplained"
    assert "none of the tested effects" in answer.status.message
    assert answer.plant.names == MASS.names


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "nearly"), [(swaying, "sinusoidal_disturbance"), (position_gain, "constant_offset")]
)
def test_what_is_nearly_an_effect_is_not_given_its_name(law, nearly):
    """The effect takes nearly all of the residual; a product of signals takes the rest."""
    plant = eoi.Plant(law, {**TRUE, "hidden": 0.3}, **KNOWN, units=UNITS)
    fit, held = (measured(plant, seed, 4000) for seed in (1, 2))
    answer = eoi.discover(MASS, fit, held, [nearly])
    evidence = answer.ranking[0]
    assert evidence.explained > 0.9
    assert evidence.remark == "a product of signals takes most of the rest"
    assert answer.effects == ()
    assert answer.status.code == "unexplained"


def filled(t, x, u, p):
    return p.inflow * u[0] - p.outflow * jnp.sqrt(jnp.maximum(x.y[0], 0.0))


def filled_through_a_long_pipe(t, x, u, p):
    """The pump delivers less, or more, against a higher level."""
    return filled(t, x, u, p) + p.hidden * u[0] * x.y[0]


def pumped(seed: int, hidden: float) -> eoi.Record:
    known = {"relative_degree": 1, "inputs": ("pump",), "outputs": ("level",)}
    values = {"outflow": 0.0268, "inflow": 0.003, "hidden": hidden}
    plant = eoi.Plant(filled_through_a_long_pipe, values, **known)
    time = 0.5 * np.arange(8000)
    pump = 3.0 + eoi.excitation.multisine(time, 0.6, (1e-3, 0.02), 12, seed=seed)
    level = eoi.simulate(plant, time, pump, 0.2, hold="linear").outputs
    noise = RELATIVE * np.std(level) * np.random.default_rng(seed).standard_normal(level.shape)
    return eoi.Record(time, pump, level + noise, f"run {seed}", hold="linear",
                      input_names=("pump",), output_names=("level",))  # fmt: skip


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("hidden", [0.002, -0.002])
def test_several_effects_that_imitate_one_product_are_not_given_their_names(hidden):
    """A level follows its pump: u y is nearly a parabola of u, an offset and a leak."""
    declared = eoi.Plant(filled, {"outflow": 0.03, "inflow": 0.0025}, 1, ("pump",), ("level",))
    few = ["input_quadratic", "constant_offset", "leak"]
    answer = eoi.discover(declared, pumped(1, hidden), pumped(2, hidden), few)
    assert answer.effects == ()
    assert answer.status.code == "unexplained"
    assert any(one.remark.startswith("a product of signals") for one in answer.ranking)


@pytest.mark.slow
def test_what_is_rare_is_tried_where_the_rest_explains_nothing():
    plant = eoi.Plant(damper, {**TRUE, "hidden": 0.3}, **KNOWN, units=UNITS)
    fit, held = measured(plant, 1), measured(plant, 2)
    got = eoi.discover(MASS, fit, held)
    assert got.effects == ("asymmetric_friction",)
    assert values(got) == pytest.approx({"asymmetric_friction_slope": 0.3}, rel=5e-3)
    assert got.after is not None
    assert got.after.nrmse[0] < 3.0 * RELATIVE


def heated(t, x, u, p):
    """A heater: its power grows with the square of the voltage, the room is warm."""
    return p.gain * u[0] ** 2 - p.loss * (x.y[0] - p.room)


def proportional(t, x, u, p):
    return p.gain * u[0] - p.loss * x.y[0]


@pytest.mark.slow
@pytest.mark.long
def test_an_actuator_that_is_purely_quadratic_gives_the_square_of_its_input():
    time = 0.5 * np.arange(6000)
    known = {"relative_degree": 1, "inputs": ("voltage",), "outputs": ("heat",)}
    truth = eoi.Plant(heated, {"gain": 0.02, "loss": 0.01, "room": 20.0}, **known)
    declared = eoi.Plant(proportional, {"gain": 0.03, "loss": 0.012}, **known)

    def record(seed: int) -> eoi.Record:
        voltage = np.repeat(np.random.default_rng(seed).uniform(0.0, 5.0, 60), 100)
        return eoi.simulate(truth, time, voltage, 20.0, hold="zero", name=f"heating {seed}")

    got = eoi.discover(declared, record(1), record(2), ["input_quadratic", "constant_offset"])
    assert got.effects == ("input_square", "constant_offset")
    assert got.found.parameters["gain"] == pytest.approx(0.02, rel=0.01)
    assert any("input_quadratic" in note and "no better in free runs" in note for note in got.notes)

    class Bent(effects.InputQuadratic):
        def limit(self, kind=""):
            return None

    endless = eoi.discover(declared, record(1), record(2), [Bent(odd=True), "constant_offset"])
    assert endless.found.parameters["gain"] * values(endless)["input_quadratic"] == pytest.approx(
        0.02, rel=0.01
    )
    assert any("hardly tell the size of input quadratic" in note for note in endless.notes)


def turning(t, x, u, p):
    return p.gain * u[0] - p.loss * x.y[0]


def test_dry_friction_of_a_measured_speed_is_named():
    """A motor with a tachometer: relative degree one, and it stands still now and then."""
    known = {"relative_degree": 1, "inputs": ("voltage",), "outputs": ("speed",),
             "units": {"voltage": "V", "speed": "rad/s"}}  # fmt: skip
    motor = eoi.Plant(turning, {"gain": 40.0, "loss": 2.0}, **known)
    rubbing = place(motor, effects.CoulombFriction(), 0)
    truth = augmented(motor, [rubbing], {"coulomb_friction": 8.0})
    time = 2e-3 * np.arange(6000)

    def record(seed: int) -> eoi.Record:
        voltage = eoi.excitation.multisine(time, 1.0, (0.1, 4.0), 12, seed=seed)
        clean = eoi.simulate(truth, time, voltage, hold="zero", substeps=2)
        noise = 1e-3 * np.std(clean.outputs) * np.random.default_rng(seed).standard_normal(6000)
        return eoi.Record(time, voltage, clean.outputs[:, 0] + noise, f"run {seed}", hold="zero",
                          input_names=["voltage"], output_names=["speed"])  # fmt: skip

    declared = motor.with_parameters({"gain": 30.0, "loss": 2.6})
    one = record(1)
    assert np.mean(np.abs(one.outputs) < 1e-2 * np.std(one.outputs)) > 0.01
    got = eoi.discover(declared, one, record(2))
    assert got.effects == ("coulomb_friction",)
    assert values(got) == pytest.approx({"coulomb_friction": 8.0}, rel=2e-3)
    assert got.plant.units["coulomb_friction"] == "rad/s²"
    assert "speed' = gain·voltage - loss·speed - coulomb_friction·sign(speed)" in str(got)
    assert "leak" not in {one.effect for one in got.ranking}  # a speed is no level
    assert got.after is not None
    assert got.after.nrmse[0] < 3e-3
    assert got.plot() is not None


def test_no_friction_is_tried_on_a_level():
    level = eoi.plants.level_tank(true=True)
    time = 0.05 * np.arange(3000)
    pump = 5.0 + 2.0 * np.sign(np.sin(0.1 * time))
    one = eoi.simulate(level, time, pump, 0.1, hold="zero")
    assert np.min(one.outputs) > 0.0
    tried = {one.effect for one in eoi.discover(level, one, 0.3).ranking}
    assert "leak" in tried
    assert not tried & {"coulomb_friction", "viscous_friction", "quadratic_drag"}


@pytest.mark.slow
def test_unexplained_residual_comes_with_its_diagnosis(tmp_path):
    answer = found("outside")
    assert answer.diagnosis is not None
    assert answer.diagnosis.more_than_noise.all()
    assert all(finding in str(answer) for finding in answer.diagnosis.findings)
    assert found("coulomb").diagnosis is None
    answer.save(tmp_path / "answer.npz")
    again = eoi.load(tmp_path / "answer.npz")
    assert again.diagnosis.findings == answer.diagnosis.findings


def test_ranking_holds_every_candidate_once_with_the_found_first():
    ranking = found("coulomb").ranking
    assert ranking[0].effect == "coulomb_friction"
    assert ranking[0].parameters["coulomb_friction"] == pytest.approx(0.5, rel=1e-2)
    assert ranking[0].score > 0
    by_name = {one.effect: one for one in ranking}
    inside = {"leak", "overflow", "internal_friction"}
    mechanical = {one.name for one in effects.standard()} - inside
    assert set(by_name) == mechanical
    for name in ("viscous_friction", "linear_stiffness"):
        assert by_name[name].remark == "already in the model"
    assert all(0.0 <= one.explained <= 1.0 for one in ranking)


def test_effect_of_the_wrong_sign_is_remarked():
    """A drag that drives is no drag."""
    fit = measured(eoi.Plant(driven, {**TRUE, "hidden": 0.1}, **KNOWN, units=UNITS), 1, 4000)
    answer = eoi.discover(MASS, fit, effects=["quadratic_drag"])
    assert [one.remark for one in answer.ranking] == ["wrong sign"]
    assert answer.effects == ()
    assert answer.status.code == "unexplained"


def test_several_records_make_one_answer():
    both = [measured(HIDDEN["coulomb"], seed, 4000) for seed in (1, 3)]
    answer = eoi.discover(MASS, both, records("coulomb")[1], FEW)
    assert answer.effects == ("coulomb_friction",)
    assert values(answer)["coulomb_friction"] == pytest.approx(0.5, rel=1e-2)
    assert len(answer.found.residual) == 2


def test_without_held_out_record_the_error_is_in_sample_and_says_so():
    fit, _ = records("coulomb")
    answer = eoi.discover(MASS, fit, effects=FEW)
    assert answer.in_sample
    assert answer.effects == ("coulomb_friction",)
    assert any("no held-out record: errors are in-sample" in note for note in answer.notes)
    assert not found("coulomb").notes


def test_an_effect_of_free_runs_alone_is_said_to_be_one():
    answer = eoi.discover(MASS, records("coulomb")[0], records("coulomb")[1],
                          ["coulomb_friction", "input_yield"])  # fmt: skip
    assert answer.effects == ("coulomb_friction",)
    assert any(note.startswith("input_yield is tried in free runs") for note in answer.notes)


@pytest.mark.slow
@pytest.mark.long
def test_effect_that_makes_the_free_run_worse_is_refused():
    """The other record is of a plant without it."""
    answer = eoi.discover(MASS, records("coulomb")[0], records("nothing")[1], FEW)
    assert answer.effects == ()
    assert answer.status.code == "unexplained"
    assert any(note.startswith("refused: coulomb_friction would make") for note in answer.notes)
    assert answer.after is answer.before


@pytest.mark.slow
@pytest.mark.long
def test_effect_that_the_held_out_records_contradict_is_refused():
    """A spring that hardens in one record and softens in the other."""
    fit, held = (
        measured(hiding({effects.CubicStiffness(): (gain,)}), seed, 4000)
        for seed, gain in ((1, 8.0), (2, -8.0))
    )
    answer = eoi.discover(MASS, fit, held, ["cubic_stiffness", "constant_offset"])
    assert answer.effects == ()
    assert answer.status.code == "unexplained"
    remarks = {one.effect: one.remark for one in answer.ranking}
    assert remarks["cubic_stiffness"] == "held-out error grows"
    assert all("declared model was refined" in note for note in answer.notes)


@pytest.mark.slow
@pytest.mark.long
def test_a_held_out_record_at_rest_is_told_and_what_it_refuses_stays_in_view():
    """Of no motion the sign of its noise is all that friction would be checked on."""
    time = PERIOD * np.arange(4000)
    noise = 1e-5 * np.random.default_rng(0).standard_normal(4000)
    rest = eoi.Record(time, np.zeros(4000), noise, "rest", input_names="force",
                      output_names="position", hold="linear")  # fmt: skip
    answer = eoi.discover(MASS, records("coulomb")[0], rest, FEW)
    assert answer.effects == ()
    assert answer.status.code == "unexplained"
    assert answer.status.message.startswith("coulomb_friction would explain 100.0%")
    assert "but the held-out records do not confirm it" in answer.status.message
    (note,) = answer.notes
    assert note.startswith("position does not move beyond its noise on the held-out record rest")
    first = answer.ranking[0]
    assert (first.effect, first.remark) == ("coulomb_friction", "held-out error grows")
    text = str(answer)
    assert text.startswith(
        "The model lacks something that none of the tested effects explains on all records"
    )
    assert any(line.endswith("held-out error grows") for line in text.splitlines())


@pytest.mark.parametrize(
    ("bias", "name", "other"),
    [(6.0, "input_dead_zone", "constant_offset"), (12.0, "constant_offset", "input_dead_zone")],
)
def test_held_out_record_tells_a_dead_zone_from_an_offset(bias: float, name: str, other: str):
    """The force of the record of the fit is never small; that of the other is at times."""
    plant = hiding({effects.InputDeadZone(): (0.6,)})
    fit = measured(plant, 1, bias=12.0)
    assert np.min(fit.inputs) > 0.6
    answer = eoi.discover(MASS, fit, measured(plant, 2, bias=bias), (*FEW, "input_dead_zone"))
    assert answer.effects == (name,)
    assert answer.ambiguous_with == (other,)
    remark = next(one.remark for one in answer.ranking if one.effect == other)
    assert remark == ("the held-out records prefer input_dead_zone" if bias < 12.0 else "")


class CrossedDamping(AbstractTerm):
    """-c v y²."""

    name = "crossed_damping"
    sentence = "damping that grows with the displacement"
    gains = (Parameter("", "1/(s ({y})²)", lower=0.0),)
    depends_on = "v"

    def term(self, at, gain, shape):
        return -gain[0] * at.v * at.y**2


def test_effect_of_the_users_own_is_found():
    fit, held = records("outside")
    answer = eoi.discover(MASS, fit, held, [*FEW, CrossedDamping()])
    assert answer.effects == ("crossed_damping",)
    assert values(answer)["crossed_damping"] == pytest.approx(3.0, rel=1e-2)
    assert answer.plant.units["crossed_damping"] == "1/(s (m)²)"
    assert "position²" in answer.equation


# -- the answer as an object ----------------------------------------------------------------------


def test_answer_prints_what_was_found():
    text = str(found("coulomb"))
    assert "Coulomb" in text
    assert "coulomb_friction" in text
    assert "sign" in found("coulomb").equation
    assert "operatorname{sign}" in found("coulomb").latex
    assert "nothing" in str(found("nothing"))
    assert "unexplained" in str(found("outside"))


def test_answer_plots():
    assert found("coulomb").plot().axes


def test_answer_survives_a_file(tmp_path):
    answer = found("coulomb")
    answer.save(tmp_path / "answer.npz")
    again = eoi.load(tmp_path / "answer.npz", plant=MASS)
    assert again.effects == answer.effects
    assert again.ranking == answer.ranking
    assert again.status == answer.status
    assert again.added[0].effect == answer.added[0].effect
    assert values(again) == values(answer)
    assert answer.after is not None
    np.testing.assert_array_equal(again.after.rmse, answer.after.rmse)
    state, theta = eoi.State(jnp.ones((2, 1)), jnp.zeros(0)), jnp.asarray(answer.plant.theta)
    force = [
        one.plant.derivative(jnp.asarray(0.0), state, jnp.ones(1), theta) for one in (again, answer)
    ]
    assert force[0] == force[1]


# -- wrong calls ----------------------------------------------------------------------------------


def test_validation_with_other_inputs_is_refused():
    fit, held = records("nothing")
    other = eoi.Record(held.time, np.repeat(held.inputs, 2, axis=1), held.outputs)
    with pytest.raises(ValueError, match=r"`validation.*input"):
        eoi.discover(MASS, fit, other)


def test_validation_in_other_units_is_refused():
    fit, held = records("nothing")
    other = eoi.Record(
        held.time,
        held.inputs,
        1e3 * held.outputs,
        input_names=held.input_names,
        output_names=held.output_names,
        units={"force": "N", "position": "mm"},
    )
    with pytest.raises(ValueError, match=r"`validation.*mm"):
        eoi.discover(MASS, fit, other)


def test_validation_on_the_records_of_the_fit_is_refused():
    fit, _ = records("nothing")
    with pytest.raises(
        ValueError, match=r"must not be one of the records of the fit, got the same data"
    ):
        eoi.discover(MASS, fit, fit)


@pytest.mark.parametrize("alpha", [0.0, 1.0, -0.1, float("nan")])
def test_level_of_false_alarms_lies_between_zero_and_one(alpha: float):
    with pytest.raises(ValueError, match=r"`alpha` must lie in \(0, 1\)"):
        eoi.discover(MASS, records("nothing")[0], alpha=alpha)


def test_number_of_effects_is_at_least_one():
    with pytest.raises(ValueError, match=r"`most` must be an integer ≥ 1, got 0"):
        eoi.discover(MASS, records("nothing")[0], most=0)


def test_unknown_effect_is_named_with_the_closest():
    with pytest.raises(ValueError, match=r"got 'coulomb'\. Did you mean `coulomb_friction`\?"):
        eoi.discover(MASS, records("nothing")[0], effects=["coulomb"])


def test_effects_of_which_none_fits_are_a_wrong_call():
    with pytest.raises(
        ValueError,
        match=r"must hold one that fits one mass, got leak, overflow\. It has position of rel",
    ):
        eoi.discover(MASS, records("nothing")[0], effects=["leak", "overflow"])


def test_an_effect_that_has_no_place_is_told():
    fit, held = records("coulomb")
    answer = eoi.discover(MASS, fit, held, ["coulomb_friction", "leak"])
    assert answer.effects == ("coulomb_friction",)
    assert answer.notes == (
        "leak was not tried: no output, input or internal state of one mass is of its kind",
    )


def test_an_effect_of_which_the_records_show_nothing_is_told():
    """A speed that never turns back is a level as well: no dry friction is tried on it."""
    level = eoi.plants.level_tank(true=True)
    time = 0.05 * np.arange(3000)
    one = eoi.simulate(level, time, 5.0 + 2.0 * np.sign(np.sin(0.1 * time)), 0.1, hold="zero")
    answer = eoi.discover(level, one, 0.3, ["coulomb_friction", "leak"])
    assert [one.effect for one in answer.ranking] == ["leak"]
    assert any(one.startswith("coulomb_friction was not tried: nothing") for one in answer.notes)


def test_no_effects_to_try_is_a_wrong_call():
    with pytest.raises(ValueError, match=r"`effects` must name at least one effect, got none"):
        eoi.discover(MASS, records("nothing")[0], effects=())


def test_records_that_do_not_fit_the_plant_are_refused():
    with pytest.raises(ValueError, match=r"`records` must hold at least one record"):
        eoi.discover(MASS, [])


@pytest.mark.parametrize("share", [1.5, np.float32(1.5), np.int64(2), True], ids=repr)
def test_share_that_is_held_out_lies_between_zero_and_one(share):
    rule = rf"`validation` must lie in \(0, 1\) as a share, got {share}"
    with pytest.raises(ValueError, match=rule):
        eoi.discover(MASS, records("nothing")[0], share)


def test_a_share_may_be_a_number_of_numpy():
    record = records("nothing")[0]
    found = eoi.discover(MASS, record, np.float32(0.25), effects=["coulomb_friction"])
    assert [len(held) for held in found.held_out] == [round(0.25 * len(record))]


def test_a_record_too_short_to_tell_anything_is_left_out_with_a_note():
    fit, held = records("coulomb")
    alone = eoi.discover(MASS, fit, held, "coulomb_friction")
    both = eoi.discover(MASS, [fit[1000:1020], fit], held, "coulomb_friction")
    assert both.plant.parameters == alone.plant.parameters
    assert both.status == alone.status
    (note,) = set(both.notes) - set(alone.notes)
    assert note.startswith("run 1: 0.1 s are too short beside the other records")
    assert note.endswith("left out")


def test_what_is_masked_in_records_is_told_of_fitted_held_out_and_test_records():
    records = []
    for seed in (1, 2, 3):
        whole = measured(HIDDEN["coulomb"], seed, 2000)
        outputs = np.array(whole.outputs)
        outputs[100 : 100 + 2 * seed] = np.nan
        with pytest.warns(eoi.RecordWarning, match="are not finite"):
            records.append(
                eoi.Record(
                    whole.time, whole.inputs, outputs, whole.name, input_names=MASS.inputs,
                    output_names=MASS.outputs, units=UNITS, hold="linear",
                )
            )  # fmt: skip
    fit, held, test = records
    answer = eoi.discover(MASS, fit, held, "coulomb_friction", test=test)
    told = (
        "run 1: 2 of 2000 samples are not finite (`position` 2): masked; alike in run 2 and run 3"
    )
    assert f"\n- {told}\n" in f"{answer}\n"


# -- bounds ---------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.long
def test_what_a_bound_takes_away_is_not_explained(monkeypatch):
    """The stiffness may not reach its true value: effects are judged beside that on the bound."""
    plant = MASS.declared_anew({"k": 18.0}, bounds={"k": (10.0, 19.8)})
    fit, held = records("coulomb")
    got = eoi.discover(plant, fit, held, "coulomb_friction")
    assert got.plant.parameters["k"] == 19.8
    assert any(note.startswith("k ended on its bound, 19.8: ") for note in got.notes)
    assert got.effects == ("coulomb_friction",)
    assert np.isnan(got.found.standard_errors["k"])
    # Free runs refine the answer where records are held out; the share is that of the injection.
    assert any("was refined by the error of its free runs" in note for note in got.notes)
    module = importlib.import_module("eoi_jax.discovery.discover")
    monkeypatch.setattr(module, "divided", lambda *_: None)  # as of a record too short to judge
    alone = eoi.discover(plant, fit, effects="coulomb_friction")
    assert alone.plant.parameters["k"] == 19.8
    before, after = (one.index[one.best_pass, 0] for one in (alone.declared, alone.found))
    assert after > 0.01 * before
    assert alone.explained == pytest.approx(1.0 - after / before, abs=0.02)


@pytest.mark.slow
def test_a_model_that_a_bound_keeps_from_the_records_lacks_something():
    plant = MASS.declared_anew({"k": 15.0}, bounds={"k": (10.0, 16.0)})
    fit, held = records("nothing")
    got = eoi.discover(plant, fit, held, "coulomb_friction")
    assert got.status.code == "unexplained"
    assert got.added == ()
    assert any(one.startswith("k ended on its bound, 16: ") for one in got.notes)


# -- what the records cannot tell apart -----------------------------------------------------------


def undecided(rise: float) -> tuple[str, ...]:
    """What is said beside Coulomb friction, if Stribeck friction fits with this rise (level 1)."""
    rows = 400
    ones = np.ones(rows)
    base = Base(ones, np.ones((rows, 0)), np.zeros(0, int), ones, ones, np.zeros(rows, int))
    fits = []
    for effect, gains, cost in (
        (effects.CoulombFriction(), [1.0], 400.0),
        (effects.StribeckFriction(), [1.0, rise], 398.0),
    ):
        atom = CandidateColumns(
            place(MASS, effect, 0), (0.1,) * len(effect.shapes), np.ones((rows, len(gains))), None
        )
        fits.append(Fit((atom,), np.asarray(gains), np.ones(rows), cost, True))
    scores = SearchProblem(base, (), 0.01, 3, 20, 1.0).scores(ones)
    return ambiguous(RankedSets(scores, tuple(fits)), fits[0], ("coulomb_friction",))


def test_stribeck_friction_that_cannot_be_excluded_is_said_beside_coulomb():
    """It gains less than its parameters cost, but the rise may be as large as the level."""
    assert undecided(rise=0.8) == ("stribeck_friction",)


def test_stribeck_friction_of_no_rise_is_not_said_beside_coulomb():
    assert undecided(rise=0.05) == ()


def test_laws_that_contain_each_other_are_no_rivals():
    coulomb, stribeck = effects.CoulombFriction(), effects.StribeckFriction()
    assert akin(coulomb, stribeck)
    assert akin(effects.AsymmetricFriction(), stribeck)
    assert not akin(coulomb, effects.QuadraticDrag())


def test_records_that_show_no_motion_are_said_to_have_no_sample_that_counts():
    time = PERIOD * np.arange(2000)
    noise = 1e-3 * np.random.default_rng(0).standard_normal(2000)
    drive = 1e-6 * np.sin(3.0 * time)
    record = eoi.Record(
        time, drive, noise, input_names=("force",), output_names=("position",), hold="linear"
    )
    found = eoi.discover(MASS, record, effects=FEW, lowpass=eoi.LowPass(60.0, 3))
    assert found.status.code == "no_data"
    assert "no sample of the records counts" in found.status.message
    assert "Give a `lowpass` with a lower cut-off" in str(found)
    assert not found.effects


@pytest.mark.parametrize(("errors", "told"), [((0.6, 9.0), True), ((0.6, 0.9), False)])
def test_an_effect_of_unknown_size_is_said(errors, told):
    """One parameter that is known to half of its size is enough: the level of an overflow."""
    names = ("overflow_rate", "overflow_level")
    one = Added(
        effects.Overflow(), "level", dict(zip(names, (1.0, -2.0), strict=True)),
        dict(zip(names, errors, strict=True)), "an overflow",
    )  # fmt: skip
    notes = uncertain_effects([one])
    assert len(notes) == told
    assert all("overflow" in note and "half" in note for note in notes)


def test_two_effects_of_unknown_size_are_told_apart_by_their_outputs():
    both = [
        Added(effects.CoulombFriction(), output, {"friction": 1.0}, {"friction": 9.0}, "friction")
        for output in ("cart", "arm")
    ]
    notes = uncertain_effects(both)
    assert "coulomb friction at cart: " in notes[0]
    assert "coulomb friction at arm: " in notes[1]


@pytest.mark.parametrize("began", [0.0, 86_400.0], ids=["at the first sample", "a day before"])
@pytest.mark.parametrize(
    "effect", [effects.ConstantOffset(), effects.Drift()], ids=["offset", "drift"]
)
def test_offset_and_drift_are_told_apart_wherever_the_clock_began(effect, began):
    plant = eoi.Plant(lambda t, x, u, p: -p.a * x.y[0] + p.b * u, {"a": 1.2, "b": 1.8}, 1)
    time = 0.02 * np.arange(900)
    true = augmented(plant, [place(plant, effect, 0)], {effect.name: 0.3})
    run = eoi.simulate(true, time, eoi.excitation.random_steps(time, -1.0, 1.0, 0.6, seed=1))
    y = run.outputs + 1e-3 * np.random.default_rng(0).standard_normal(run.outputs.shape)
    found = eoi.discover(plant, eoi.Record(began + time, run.inputs, y, hold=run.hold))
    assert found.effects == (effect.name,)
    assert found.plant.parameters[effect.name] == pytest.approx(0.3, rel=0.02)
    assert ("(t - 86400)" in found.equation) == (effect.name == "drift" and began > 0)
