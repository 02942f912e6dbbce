"""The tests of a round: what they refuse, and why; records by an integrator of scipy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery.remarks import HELD_OUT, PRODUCT_ALONE, PRODUCT_OF_REST
from eoi_jax.discovery.round import RoundResult, search_round
from eoi_jax.discovery.round_start import RoundStart
from eoi_jax.discovery.task import Task
from eoi_jax.estimation.identify import estimate
from eoi_jax.estimation.preparation import prepare_records

TIME = 0.01 * np.arange(3000)
TRUTH = {"k": 9.0, "c": 0.8, "b": 2.0}


def spring(t, x, u, p):
    y, rate = x.y
    return -p.k * y - p.c * rate + p.b * u


PLANT = eoi.Plant(spring, TRUTH, 2, inputs=("force",), outputs=("position",))


def drive(time: float, phase: float) -> float:
    return 3.0 + np.sin(0.7 * time + phase) + np.sin(2.3 * time) + 0.7 * np.sin(4.1 * time + phase)


def record(phase: float, lacking) -> eoi.Record:
    """The spring with a further acceleration, a function of position and force."""

    def rates(time: float, state: np.ndarray) -> tuple[float, float]:
        force = drive(time, phase)
        known = -TRUTH["k"] * state[0] - TRUTH["c"] * state[1] + TRUTH["b"] * force
        return state[1], known + lacking(state[0], force)

    path = solve_ivp(rates, TIME[[0, -1]], (0.6, 0.0), t_eval=TIME, rtol=1e-9, atol=1e-11)
    noise = 1e-4 * np.random.default_rng(int(10 * phase)).standard_normal(len(TIME))
    force = np.array([drive(time, phase) for time in TIME])
    return eoi.Record(TIME, force, path.y[0] + noise, hold="linear",
                      input_names=PLANT.inputs, output_names=PLANT.outputs)  # fmt: skip


def searched(lacking, held_out_lacking=None) -> RoundResult:
    """A round that may only add an offset."""
    fitted, held_out = record(0.0, lacking), record(1.3, held_out_lacking or lacking)
    prepared = prepare_records(PLANT, (fitted,))
    declared = estimate(PLANT, prepared)
    offset = (effects.ConstantOffset(),)
    task = Task(PLANT, prepared, (fitted,), (held_out,), offset, declared, 0.01, 3, None)
    start = RoundStart(task, declared.plant)
    return search_round(start, start.lacking + start.base.signal_power(start.base.target))


def test_an_offset_that_is_there_passes_all_tests():
    found = searched(lambda position, force: 1.5)
    (placed,) = found.chosen.keys
    assert found.chosen.values[placed][0] == pytest.approx(1.5, rel=0.02)
    assert found.decision.refused == {}
    assert found.decision.rejected == frozenset()
    assert found.decision.denied is None
    assert found.plausible == [(found.chosen.keys, pytest.approx(found.plausible[0][1]))]


def test_an_offset_is_refused_where_a_product_explains_what_it_leaves():
    found = searched(lambda position, force: 1.2 * position * force)
    assert not found.chosen.atoms
    (refusal,) = found.decision.refused.values()
    assert refusal in (PRODUCT_OF_REST, PRODUCT_ALONE)
    assert found.decision.denied is None  # not the held-out records refuse it


def test_an_offset_of_one_record_is_refused_by_the_held_out_one_and_said_to_be_denied():
    found = searched(lambda position, force: 1.5, lambda position, force: 0.0)
    assert not found.chosen.atoms
    assert list(found.decision.refused.values()) == [HELD_OUT]
    assert found.decision.denied is not None
    assert found.decision.denied.keys in found.decision.rejected
