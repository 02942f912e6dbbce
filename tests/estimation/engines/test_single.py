"""Passes of one lane over several records: sums and traces of the scan, from compiled code."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import LEVEL, SWAY, grid

from eoi_jax import effects, plants
from eoi_jax.data.record import Record
from eoi_jax.estimation.engines.single import single_pass
from eoi_jax.estimation.kernel import run_pass
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.observers import FirstOrder, SecondOrder, SuperTwisting
from eoi_jax.estimation.preparation import prepare_steps, step_inputs
from eoi_jax.models.augmented import augmented, place

PERIOD = 5e-3
MASS = plants.mass_spring_damper()
LAGGED = augmented(MASS, [place(MASS, effects.ActuatorLag(), 0)], {"actuator_lag": 0.02})
CASES = {
    "level": (plants.level_tank(), FirstOrder(5.0, 1.0)),
    "friction": (plants.pendulum(), SecondOrder(20.0, 100.0, 500.0)),
    "explicit": (MASS, SuperTwisting(40.0, 10.0, scheme="explicit")),
    "three outputs": (plants.three_mass_spring_damper(), SecondOrder(20.0, 100.0, 500.0)),
}


def batch(plant, observer, counts=(400, 250)) -> Any:
    """Records of unequal lengths, their motion prescribed, and the filter of each."""
    records = []
    for j, count in enumerate(counts):
        t = grid(count, PERIOD)
        motion = LEVEL if plant.relative_degree == 1 else SWAY
        y = np.stack([motion(t + 0.3 * j + 0.2 * i) for i in range(len(plant.outputs))], 1)
        u = np.stack([np.sin(3.0 * t + i) for i in range(len(plant.inputs))], 1)
        records.append(Record.from_period(PERIOD, u, y))
    explicit = observer.scheme == "explicit"
    taps = len(np.atleast_2d(np.asarray(observer.kernel))[0])
    inputs = [step_inputs(record, explicit) for record in records]
    noise = [np.zeros(len(plant.outputs))] * len(records)
    steps = prepare_steps(plant, records, inputs, taps, 0.1, 0.1, noise, explicit, 0.02)
    one = LowPass(40.0).discretise(PERIOD)
    return steps, jax.tree.map(lambda leaf: np.stack([leaf] * len(records)), one)


def both(plant, observer, store, steps, filters) -> Any:
    """The pass by `alone`, and by the scan."""
    theta = 1.1 * plant.theta
    got = single_pass(plant, observer, filters, steps)(theta, store)
    return got, run_pass(plant, observer, filters, steps, jnp.asarray(theta), store=store)


def assert_close(got, want, counted: Any = None):
    for name, mine in vars(got).items():
        theirs = getattr(want, name)
        if mine is None:
            assert theirs is None
            continue
        mine, theirs = np.asarray(mine), np.asarray(theirs)
        if counted is not None:
            mine, theirs = mine[counted], theirs[counted]
        # Sums of some hundred numbers in another order.
        np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-11 * np.max(np.abs(theirs)))


@pytest.mark.parametrize("store", ["nothing", "signals"])
@pytest.mark.parametrize("case", list(CASES))
def test_sums_and_traces_are_those_of_the_scan(case, store):
    plant, observer = CASES[case]
    steps, filters = batch(plant, observer)
    (sums, trace), (want, shown) = both(plant, observer, store, steps, filters)
    assert np.all(np.asarray(want.count) > 0)
    assert_close(sums, want)
    assert (trace is None) == (store == "nothing")
    if trace is not None:
        assert_close(trace, shown, np.any(np.asarray(steps.score) > 0, axis=2))


def test_a_plant_behind_an_actuator_is_left_to_the_scan():
    observer = SecondOrder(20.0, 100.0, 500.0)
    steps, filters = batch(LAGGED, observer)
    (sums, trace), (want, shown) = both(LAGGED, observer, "signals", steps, filters)
    assert_close(sums, want)
    assert_close(trace, shown)


class Named(FirstOrder):
    """An observer of a user's own that carries a word beside its gains."""

    label: str

    def __init__(self):
        super().__init__(5.0, 1.0)
        self.label = "mine"


def test_an_observer_that_holds_more_than_numbers_is_left_to_the_scan():
    plant, observer = plants.level_tank(), Named()
    assert "mine" in jax.tree.leaves(observer)
    steps, filters = batch(plant, observer)
    (sums, _), (want, _) = both(plant, observer, "nothing", steps, filters)
    assert_close(sums, want)


def test_a_record_without_a_step_that_counts_adds_nothing():
    plant, observer = CASES["level"]
    steps, filters = batch(plant, observer)
    steps = jax.tree.map(np.array, steps)
    steps.score[1] = 0.0
    (sums, _), (want, _) = both(plant, observer, "signals", steps, filters)
    assert_close(sums, want)
    assert np.all(sums.count[1] == 0.0)
    assert np.all(sums.information[1] == 0.0)
