"""Which records may be held out."""

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.held_out import held_out

TIME = 0.01 * np.arange(1000)


def free(t, x, u, p):
    return p.b * u - p.c * x.y[0]


PLANT = eoi.Plant(free, {"b": 1.0, "c": 1.0}, 1)


def run(seed: int, start: float = 0.0) -> eoi.Record:
    draw = np.random.default_rng(seed)
    return eoi.Record(start + TIME, draw.normal(size=1000), draw.normal(size=1000), f"run {seed}")


def moved(record: eoi.Record, by: float) -> eoi.Record:
    """The same signals at another time."""
    return eoi.Record(record.time + by, record.inputs, record.outputs, "later")


@pytest.mark.parametrize(
    ("fit", "held", "count"),
    [
        (run(1), run(1)[200:600], 350),
        (run(1)[200:600], run(1), 400),
        (run(1)[:600], run(1)[400:], 150),
        (run(1), moved(run(1), 1e-6)[200:600], 350),
    ],
)
def test_a_part_of_a_record_of_the_fit_is_not_held_out(fit, held, count):
    with pytest.raises(ValueError, match=f"must not hold samples that the fit sees, got {count}"):
        held_out(PLANT, [run(2), fit], held)


@pytest.mark.parametrize(
    "held",
    [
        run(2),
        run(1)[600:],
        run(1)[550:],  # the first 50 start its free run, and are not scored
        moved(run(1), 1.0),  # a plant in a steady motion may well repeat it
        moved(run(1), 4e-3),
        eoi.Record(TIME, run(1).inputs, run(2).outputs),
        eoi.Record(2.0 * TIME, run(1).inputs, run(1).outputs),
    ],
)
def test_other_samples_are_held_out(held):
    assert held_out(PLANT, [run(1)[:600]], held) == (held,)


def test_two_runs_that_rest_at_first_are_two():
    rest = np.zeros(1000)
    fit = eoi.Record(TIME, rest, rest, "rest")
    later = eoi.Record(TIME[500:], rest[500:], rest[500:], "rest too")
    assert held_out(PLANT, [fit], later) == (later,)
