"""Places where an effect can act, and how each candidate is called."""

import pytest

import eoi_jax as eoi
from eoi_jax import effects, plants
from eoi_jax.models.placements import place_text, placed_label, placements, position_text


@pytest.mark.parametrize(
    "plant",
    [plants.three_mass_spring_damper(), plants.cascaded_tanks(), plants.pendulum()],
    ids=lambda plant: plant.name,
)
def test_no_two_candidates_are_called_the_same(plant: eoi.Plant):
    library = effects.standard(), effects.rare(), effects.wider(), effects.on_request()
    candidates = [effect for part in library for effect in part]
    labels = [placed_label(plant, placed) for placed in placements(plant, candidates)]
    assert len(labels) > 20
    assert len(set(labels)) == len(labels)


def test_curves_are_told_apart_by_their_signals():
    curves = (effects.Curve("y", ()), effects.Curve("v", ()), effects.Curve("y", (), "v"))
    assert [curve.label for curve in curves] == [
        "curve (of y)", "curve (of y')", "curve (of y, times y')",
    ]  # fmt: skip


def test_a_place_is_said_where_there_is_more_than_one():
    assert position_text("x1", against="x2") == "x1 towards x2"
    assert position_text("x1", through="force") == "x1 beside force"
    (alone,) = placements(plants.pendulum(), [effects.CoulombFriction()])
    assert place_text(plants.pendulum(), alone) == ""
    masses = plants.three_mass_spring_damper()
    first = placements(masses, [effects.CoulombFriction()])[0]
    assert place_text(masses, first) == " at position_1"
