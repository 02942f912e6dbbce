"""What a refined model still lacks: effects are named by what they do to the free run."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax._status import Status
from eoi_jax.models.augmented import augmented, place
from eoi_jax.refinement.refine import refine
from eoi_jax.refinement.remaining import Remaining, _further_maxima, remaining
from eoi_jax.refinement.score_test import Candidate, Try

PERIOD = 5e-3
TIME = np.arange(4001) * PERIOD


def oscillating(t, x, u, p):
    position, rate = x.y
    return p.gain * u - p.damping * rate - p.stiffness * position + p.offset


PLANT = eoi.Plant(
    oscillating, {"gain": 1.2, "damping": 0.5, "stiffness": 9.0, "offset": 0.1}, 2, ("u",), ("y",)
)
NOISE = 1e-3


def force():
    draw = np.random.default_rng(4)
    steps = np.repeat(draw.normal(size=100), 41)[: len(TIME)]
    return steps + np.sin(2.0 * TIME)


def with_hidden(*placed, values):
    plant = augmented(PLANT, [place(PLANT, *one) for one in placed], values)
    record = eoi.simulate(plant, TIME, force(), hold="zero", substeps=2)
    noise = NOISE * np.random.default_rng(0).standard_normal(record.outputs.shape)
    return eoi.Record(TIME, force(), record.outputs + noise, "lab", hold="zero")


def left_of(record):
    return remaining(refine(PLANT, record, substeps=2), substeps=2)


@pytest.mark.slow
@pytest.mark.long
def test_a_hidden_drag_is_named_with_its_size():
    record = with_hidden((effects.QuadraticDrag(), 0), values={"quadratic_drag": 0.2})
    found = left_of(record)
    assert found.best is not None
    assert found.best.names == ("quadratic_drag",)
    # Linearised at no drag at all, and other parameters have taken part of it.
    assert found.best.values["quadratic_drag"] == pytest.approx(0.2, rel=0.35)
    assert "square of the velocity" in str(found)
    again = refine(found.with_best(), record, substeps=2)
    assert again.rmse[0] == pytest.approx(NOISE, rel=0.05)
    assert again.parameters["quadratic_drag"] == pytest.approx(0.2, rel=0.05)
    nothing = remaining(again, substeps=2)
    assert nothing.best is None
    assert "None of them is significant" in str(nothing)
    assert nothing.with_best() is nothing.plant


def test_a_changed_input_is_named():
    found = left_of(with_hidden((effects.InputDelay(), 0), values={"input_delay": 0.04}))
    assert found.best is not None
    assert found.best.names in (("input_delay",), ("actuator_lag",))  # near twins
    assert list(found.best.values.values()) == [pytest.approx(0.04, rel=0.5)]


def test_two_effects_are_named_that_hide_each_other():
    hidden = (effects.Drift(), 0), (effects.CubicStiffness(), 0)
    values = {"drift": 0.05, "cubic_stiffness": 6.0}
    found = left_of(with_hidden(*hidden, values=values))
    assert {"drift", "cubic_stiffness"} in [set(one.names) for one in found.pairs]
    # A spring with a gap beside the declared one is its near twin at one amplitude.
    assert found.best is not None
    assert set(found.best.names) - {"cubic_stiffness", "free_play"} == {"drift"}


@pytest.mark.slow
@pytest.mark.long
def test_held_out_records_confirm_what_is_there_and_refuse_what_only_fits():
    """A slow wave that comes once, in the records of the fit, looks like any slow disturbance."""
    hidden = with_hidden((effects.QuadraticDrag(), 0), values={"quadratic_drag": 0.2})
    run, held_out = hidden[:2500], hidden[2500:]
    found = remaining(refine(PLANT, run, substeps=2), validation=held_out, substeps=2)
    assert found.answer is not None
    assert found.answer.candidate.names == ("quadratic_drag",)
    assert found.best is found.answer.candidate
    assert found.with_best() is found.answer.refinement.plant
    assert found.held_out is not None
    assert found.answer.held_out.rmse[0] < 0.5 * found.held_out.rmse[0]
    assert "held out with quadratic_drag: " in str(found)

    clean = with_hidden(values={})
    wave = 0.02 * np.sin(0.4 * TIME[:2500])
    shaken = eoi.Record(TIME[:2500], force()[:2500], clean.outputs[:2500] + wave[:, None],
                        "lab", hold="zero")  # fmt: skip
    found = remaining(refine(PLANT, shaken, substeps=2), validation=clean[2500:], substeps=2)
    assert found.significant
    assert len(found.trials) > 0
    assert found.answer is None
    assert found.with_best() is found.plant
    assert "None of them reduces the error on held-out records" in str(found)


@pytest.mark.parametrize(
    ("shares", "first", "others"),
    [
        # Two that leave less than half of what one leaves go first, else one goes first.
        ({"one": (0.5, 0.4), "two": (0.76, 0.3)}, "two0", ["one0", "one1", "two1"]),
        ({"one": (0.5, 0.4), "two": (0.74, 0.3)}, "one0", ["two0", "one1", "two1"]),
        ({"one": (0.5, 0.4), "two": ()}, "one0", ["one1"]),
        ({"one": (), "two": (0.2, 0.1)}, "two0", ["two1"]),
        ({"one": (), "two": ()}, None, []),
    ],
)
def test_two_effects_are_the_answer_where_they_leave_less_than_half(shares, first, others):
    """Each is once among the significant ones, by its probability; what may be chance is not."""

    def made(kind: str, chance: float, share: float) -> Candidate:
        return Candidate(
            tuple(place(PLANT, one, 0) for one in (effects.Drift(), effects.ConstantOffset())),
            {kind: 1.0}, share, chance,
        )  # fmt: skip

    several = {
        kind: [made(f"{kind}{i}", 1e-6 * (i + 1), share) for i, share in enumerate(values)]
        + [made("chance", 0.02, 0.9)]
        for kind, values in shares.items()
    }
    found = Remaining(
        PLANT, tuple(several["one"][::-1]), tuple(several["two"][::-1]), np.ones(1), 0.01
    )
    names = [next(iter(one.values)) for one in found.significant]
    assert names == ([first, *others] if first else [])
    assert (found.best is None) if first is None else (found.best is found.significant[0])
    assert found.answer is None


@pytest.mark.parametrize(
    ("shares", "further"),
    [
        ([0.1, 0.5, 0.1, 0.4, 0.1], [3]),  # the wave number of a ripple, and another one
        ([0.4, 0.1, 0.5, 0.1, 0.3], [0, 4]),  # also at the ends of the grid
        ([0.1, 0.5, 0.35, 0.4, 0.1], []),  # a dent is no other maximum
        ([None, 0.5, None, 0.4, None], [3]),  # shapes that are not physical explain nothing
        ([0.1, 0.2, 0.3, 0.2, 0.1], []),
    ],
)
def test_other_maxima_of_the_share_over_the_grid_are_further_shapes(shares, further):
    ripple = place(PLANT, effects.PositionRipple(), 0)
    tries = [Try(ripple, np.array([float(k)]), np.zeros((1, 2))) for k in range(len(shares))]
    order = [2, 0, 4, 1, 3]  # the grid need not be sorted
    found = _further_maxima([tries[i] for i in order], [shares[i] for i in order])
    assert [int(attempt.shape[0]) for attempt in found] == further


def test_effects_of_several_shapes_and_of_none_have_no_further_ones():
    stop = Try(place(PLANT, effects.ConstantOffset(), 0), np.zeros(0), np.zeros((1, 1)))
    assert _further_maxima([stop, stop, stop], [0.5, 0.1, 0.4]) == []


def test_only_given_effects_are_tried():
    record = with_hidden((effects.QuadraticDrag(), 0), values={"quadratic_drag": 0.2})
    result = refine(PLANT, record, substeps=2)
    found = remaining(result, [effects.CubicDamping(), effects.Hysteresis()], substeps=2)
    assert [one.names for one in found.ranking] == [("cubic_damping",)]
    assert found.pairs == ()


def test_wrong_calls_are_named():
    record = with_hidden(values={})
    result = refine(PLANT, record, substeps=2)
    lost = replace(result, status=Status("diverged", "far away"))
    with pytest.raises(ValueError, match="`refinement` must have an answer"):
        remaining(lost)
    with pytest.raises(ValueError, match="`level` must lie in"):
        remaining(result, level=2.0)
    with pytest.raises(ValueError, match=r"`validation\[.*\]` must have valid samples after the 8"):
        remaining(result, validation=eoi.Record(TIME[:8] + 1e3, force()[:8], np.ones(8)))
    with pytest.raises(ValueError, match=r"`validation\[.*\]` must not be one of the records"):
        remaining(result, validation=record)


def test_a_drag_is_named_behind_a_lag_of_the_input():
    lag = (effects.ActuatorLag(), 0)
    record = with_hidden(
        lag, (effects.QuadraticDrag(), 0), values={"actuator_lag": 0.05, "quadratic_drag": 0.2}
    )
    lagged = augmented(PLANT, [place(PLANT, *lag)], {"actuator_lag": 0.03})
    found = remaining(refine(lagged, record, substeps=2), substeps=2)
    assert found.best is not None
    assert found.best.names == ("quadratic_drag",)
    assert found.best.values["quadratic_drag"] == pytest.approx(0.2, rel=0.35)


def test_internal_states_and_several_runs_are_followed():
    def tank(t, x, u, p):
        return p.a * jnp.sqrt(jnp.maximum(x.z[0], 0.0)) - p.b * x.y[0]

    def upper(t, x, u, p):
        return u - p.a * jnp.sqrt(jnp.maximum(x.z, 0.0))

    plant = eoi.Plant(tank, {"a": 0.6, "b": 0.4}, 1, ("u",), ("level",), internal=upper,
                      internal_initial=lambda p: [1.0 + 0.0 * p.a])  # fmt: skip
    hidden = augmented(plant, [place(plant, effects.Drift(), 0)], {"drift": 0.02})
    inflow = 1.0 + 0.5 * np.sign(np.sin(0.7 * TIME))
    record = eoi.simulate(hidden, TIME, inflow, [0.9], hold="zero")
    draw = np.random.default_rng(2)
    noisy = record.outputs + NOISE * draw.standard_normal(record.outputs.shape)
    record = eoi.Record(TIME, inflow, noisy, hold="zero")
    result = refine(plant, [record, record[:2000]], substeps=1, window=8.0)
    found = remaining(result, [effects.Drift(), effects.QuadraticStiffness()], substeps=1)
    assert found.best is not None
    assert found.best.names == ("drift",)
    # Found from windows: in each, what time adds since the start of the record.
    assert found.best.values["drift"] == pytest.approx(0.02, rel=0.3)


@pytest.mark.parametrize(("swing", "told"), [(0.05, False), (5.0, True)])
def test_an_input_that_stands_still_shows_no_effect_but_an_offset(swing, told):
    # A box between a heater and a room, into which something else brings 0.3 K/s.
    box = eoi.Plant(lambda t, x, u, p: p.gain * u[0] - p.loss * (x.y[0] - u[1]),
                    {"gain": 1.0, "loss": 0.05}, 1, ("heater", "room"), ("air",))  # fmt: skip
    draw, time = np.random.default_rng(1), np.arange(600.0)
    room = 20.0 + swing * np.repeat(draw.standard_normal(20), 30)
    u = np.column_stack([np.repeat(draw.integers(0, 2, 60), 10), room])
    hidden = augmented(box, [place(box, effects.ConstantOffset(), 0)], {"constant_offset": 0.3})
    air = eoi.simulate(hidden, time, u, hold="zero", initial=[[20.0]]).outputs
    air = air + 0.02 * draw.standard_normal(air.shape)
    record = eoi.Record(time, u, air, hold="zero", input_names=("heater", "room"),
                        output_names=("air",))  # fmt: skip
    tried = [effects.InputQuadratic(odd=True), effects.InputDeadZone(), effects.ConstantOffset()]
    found = remaining(refine(box, record), tried)
    at_room = [candidate.placed[0].effect.name for candidate in found.ranking
               if candidate.placed[0].on_input and candidate.placed[0].channel == 1]  # fmt: skip
    assert bool(at_room) is told
    assert "constant_offset" in [candidate.names[0] for candidate in found.ranking]
