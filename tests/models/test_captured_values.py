"""Effects of a user's class that reads numbers from outside, as in a notebook."""

import jax.numpy as jnp
import numpy as np
import pytest

from eoi_jax.compiler.programs import jit
from eoi_jax.models.effects import AbstractTerm, Parameter
from eoi_jax.models.effects.effect import At

CENTER = 0.5


class Table:
    def __init__(self, values):
        self.values = values


SETTINGS = Table([1.0, 2.0])


class Bump(AbstractTerm):
    name, sentence = "bump", "a bump"
    gains = (Parameter("height", "{f}"),)
    width = 2.0

    def __init__(self, table=None):
        self.table = table

    def term(self, at, gain, shape):
        return gain[0] * (at.y - CENTER) * self.width * jnp.asarray(SETTINGS.values)[1]


@jit
def term_of(effect, y):
    return effect.term(At(0.0, y, 0.0, 0.0, None), [1.0], [])


def test_an_effect_computes_with_the_values_of_now(monkeypatch):
    bump, y = Bump(), jnp.asarray(1.5)
    assert float(term_of(bump, y)) == 4.0
    monkeypatch.setitem(globals(), "CENTER", 1.0)
    assert float(term_of(bump, y)) == 2.0
    assert float(term_of(Bump(), y)) == 2.0
    monkeypatch.setattr(Bump, "width", 4.0)
    assert float(term_of(bump, y)) == 4.0
    SETTINGS.values[1] = 1.0
    assert float(term_of(bump, y)) == 2.0
    SETTINGS.values[1] = 2.0
    monkeypatch.undo()
    assert float(term_of(bump, y)) == 4.0


def test_effects_of_equal_content_are_one():
    assert Bump() == Bump()
    assert hash(Bump()) == hash(Bump())


@pytest.mark.parametrize("kind", [np.array, list, tuple, jnp.asarray])
def test_an_effect_may_hold_a_table(kind):
    first, second = Bump(kind([1.0, 2.0])), Bump(kind([1.0, 2.0]))
    assert first == second
    assert hash(first) == hash(second)
    assert first != Bump(kind([1.0, 3.0]))


def test_objects_are_told_apart_after_their_address_was_used_again(monkeypatch):
    contents = set()
    for number in range(20):
        monkeypatch.setitem(globals(), "SETTINGS", Table([0.0, float(number)]))
        contents.add(Bump())
    assert len(contents) == 20
