"""Inputs of which records show next to no influence, or one of the other sign, are told."""

from dataclasses import replace

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.discovery.input_influence import input_notes

TIME = 60.0 * np.arange(600)


def room(t, x, u, p):
    heating, outdoor = u
    return (p.loss * (outdoor - x.y[0]) + heating) / p.capacity


ROOM = eoi.Plant(room, {"loss": 0.1, "capacity": 500.0}, 1, ("heating", "outdoor"), ("T",))


def record(seed, connected, heating=True):
    draw = np.random.default_rng(seed)
    heat = np.repeat(draw.uniform(0.0, 2.0, 20), 30) * heating
    outdoor = 5.0 + 4.0 * np.sin(2e-4 * TIME + seed)
    drive = np.column_stack([connected * heat, outdoor])
    made = eoi.simulate(ROOM, TIME, drive, hold="zero")
    measured = made.outputs + 0.02 * draw.standard_normal(made.outputs.shape)
    inputs = np.column_stack([heat, outdoor])
    return eoi.Record(TIME, inputs, measured, f"run {seed}", input_names=ROOM.inputs,
                      output_names=ROOM.outputs, hold="zero")  # fmt: skip


@pytest.fixture(scope="module", params=[True, False])
def answer(request):
    fit, held = (record(seed, request.param) for seed in (1, 2))
    return request.param, eoi.discover(ROOM, fit, held, ["constant_offset"])


def test_an_input_that_is_not_connected_is_told(answer):
    connected, found = answer
    told = [note for note in found.notes if "next to no influence of heating" in note]
    assert bool(told) is not connected
    assert not any("influence of outdoor" in note for note in found.notes)


def test_an_input_that_stands_still_tells_nothing(answer):
    _, found = answer
    still = replace(found, held_out=(record(3, False, heating=False),))
    assert not any("of heating" in note for note in input_notes(still, (record(1, False),)))


@pytest.mark.parametrize("count", [600, 160])  # windows of 16 samples are shorter than a start
def test_an_input_that_counts_in_the_other_direction_is_told(count):
    """With bounds parameters cannot take over its sign: they run to where it does nothing."""
    cooled = eoi.Plant(
        lambda t, x, u, p: (p.loss * (u[1] - x.y[0]) - u[0]) / p.capacity,
        {"loss": 0.1, "capacity": 500.0}, 1, ("heating", "outdoor"), ("T",),
        bounds={"loss": (0.0, 10.0), "capacity": (10.0, 1e5)},
    )  # fmt: skip
    fitted, held_out = (record(seed, True)[:count] for seed in (1, 2))
    found = eoi.discover(cooled, fitted, held_out, ["constant_offset"])
    told = [note for note in found.notes if "in the other direction" in note]
    assert [note.split()[0] for note in told] == ["heating"]
    assert not any("next to no influence" in note for note in found.notes)
