"""Effects that are asked for and cannot be tried."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from found import discovery

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax._status import Status
from eoi_jax.discovery.requested import chain_notes, named_effects, with_requested
from eoi_jax.report.discovery import answer


def test_an_effect_that_needs_held_out_records_is_not_called_tested():
    """A hot body that radiates, of which the model knows the convection alone; a short record."""
    time, celsius = 30.0 * np.arange(24), [400.0]
    for _ in time[1:]:
        kelvin = celsius[-1] + 273.15
        radiated = (kelvin / 100) ** 4 - (294.15 / 100) ** 4
        celsius.append(celsius[-1] - 30.0 * (4e-4 * (celsius[-1] - 21.0) + 1e-3 * radiated))
    noise = 0.5 * np.random.default_rng(0).standard_normal(24)
    body = eoi.Plant(
        lambda t, x, u, p: -p.k * (x.y[0] - 21.0),
        {"k": 3e-4},
        inputs=(),
        outputs=("temperature",),
        units={"temperature": "degC"},
    )
    record = eoi.Record(time, np.zeros((24, 0)), np.asarray(celsius) + noise)
    found = eoi.discover(body, record, effects=["radiation"])
    assert found.status.code == "unexplained"
    assert "no effect was tried: those that are asked for need held-out" in found.status.message
    assert answer(found).startswith("The model lacks something, and no effect was tried: ")


def test_rare_effects_are_asked_for_by_name():
    plant = eoi.Plant(lambda t, x, u, p: -p.k * x.y[0], {"k": 1.0}, 1)
    record = eoi.Record(np.arange(8.0), np.zeros(8), np.zeros(8))
    for effect in effects.rare():
        assert effect in named_effects([effect.name], plant, [record])


@pytest.mark.parametrize("code", ["unexplained", "partial", "complete"])
def test_what_stays_open_says_that_the_caller_named_what_was_tried(code):
    status = Status(code, "none of the tested effects explains it")
    asked = [effects.Leak(), effects.ConstantOffset(), effects.Leak()]
    message = with_requested(replace(discovery(), status=status), asked).status.message
    told = ". Only what `effects` names was tried (leak, constant_offset): leave it out to try all"
    assert message == status.message + (told if code != "complete" else "")


@pytest.mark.parametrize(("rate", "told"), [("6*w", True), ("6*w - 0.1*angle", False)])
def test_a_position_whose_rate_is_an_internal_state_is_told_where_the_answer_is_open(rate, told):
    drum = eoi.plant_from_text(
        {"angle": rate, "w": "(torque - b*w)/J"}, {"J": 0.3, "b": 0.1}, ["angle"], ["torque"],
        units={"angle": "deg"}, initial={"w": 0.0},
    )  # fmt: skip
    found = discovery()
    declared = replace(found.declared, nominal=drum)
    status = Status("unexplained", "none of the tested effects explains it")
    assert chain_notes(replace(found, declared=declared)) == []
    notes = chain_notes(replace(found, declared=declared, status=status))
    assert len(notes) == told
    assert all('acceleration of angle, as a weight out of balance, were not tried: its derivative '
               '"6*w" has the internal state w.' in note for note in notes)  # fmt: skip


@pytest.mark.parametrize(
    ("outputs", "states", "friction"),
    [("v", {"v": "F - c*v - k*z", "z": "v"}, False),
     ("x", {"x": "w", "w": "F - k*(x - z)", "z": "v", "v": "k*(x - z)"}, True)],
)  # fmt: skip
def test_an_internal_position_is_told_where_the_answer_is_open(outputs, states, friction):
    """Of a sensor of the speed, and of a mass behind a spring."""
    initial = dict.fromkeys(set(states) - {outputs, "w"}, 0.0)
    given = {name: 1.0 for name in "ck" if name in str(states)}
    plant = eoi.plant_from_text(states, given, [outputs], ["F"], initial=initial)
    found = discovery()
    declared = replace(found.declared, nominal=plant)
    assert chain_notes(replace(found, declared=declared)) == []
    (note,) = chain_notes(replace(found, declared=declared, status=Status("unexplained", "")))
    assert note.startswith("effects of the internal state z (springs that harden, gaps and stops")
    assert ("stops, and friction that depends on v)" in note) is friction


def test_an_effect_that_the_records_do_not_show_is_told_as_not_tried():
    time, rng = 0.1 * np.arange(400), np.random.default_rng(0)
    lag = eoi.Plant(lambda t, x, u, p: p.b * u - x.y[0], {"b": 1.0}, 1, outputs=("x",))
    drive = np.repeat(rng.standard_normal(40), 10)
    run = eoi.simulate(lag, time, drive, hold="zero")
    record = run.with_outputs(run.outputs + 1e-3 * rng.standard_normal((400, 1)), "measured")
    found = eoi.discover(lag, record, effects=["saturating_loss", "constant_offset"])
    (note,) = [note for note in found.notes if note.startswith("saturating_loss")]
    assert note == (
        "saturating_loss was not tried: it needs an output of one sign, apart from noise, and the "
        "records of the fit show none"
    )


class WithoutName(eoi.effects.AbstractTerm):
    gains = (eoi.effects.Parameter("g", "{f}"),)

    def term(self, at, gain, shape):
        return gain[0] * at.y


class WithoutGrid(WithoutName):
    name = sentence = "steep"
    shapes = (eoi.effects.Parameter("w", "{y}"),)


class OfThree(WithoutName):
    name = sentence = "three"

    def term(self, at, gain, shape):
        return gain[0] * jnp.ones(3)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (WithoutName, "must have a `name`, a text, got WithoutName"),
        (WithoutGrid, "must have `grid`, with initial values of its `shapes`, got WithoutGrid"),
        (OfThree, r"must return a number from `term`, .* got shape \(3,\) from OfThree"),
    ],
)
def test_an_effect_that_lacks_something_is_named(kind, message):
    plant = eoi.Plant(lambda t, x, u, p: u - p.a * x.y[0], {"a": 1.0})
    record = eoi.Record.from_period(0.1, np.sin(np.arange(9.0)), np.ones(9))
    with pytest.raises(ValueError, match=message):
        named_effects([kind()], plant, [record])
