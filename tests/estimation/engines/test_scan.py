"""The reference engine: lanes are single passes, and a shape is compiled once."""

import jax
import numpy as np
import pytest
from problems import grid, moved_pendulum

import eoi_jax as eoi
from eoi_jax.estimation.engines import Lanes, Scan
from eoi_jax.estimation.kernel import run_pass
from eoi_jax.estimation.observers import SecondOrder
from eoi_jax.estimation.preparation import prepare_steps, step_inputs

H = 2e-3
PLANT = eoi.plants.pendulum()
LOWPASS = eoi.LowPass(20.0)


@pytest.fixture(scope="module")
def steps():
    t = grid(500, H)
    u, y = moved_pendulum(t, {"a": 81.0, "b": 1.7, "c": 0.3, "d": 99.0})
    record = eoi.Record(t, u, y, hold="smooth")
    made = prepare_steps(PLANT, [record], [step_inputs(record, False)], 2, 0.2, LOWPASS.memory,
                   [np.zeros(1)], False, 0.1)  # fmt: skip
    return jax.tree.map(lambda leaf: leaf[0], made)


def lanes(count, dtype: type = float):
    theta = np.tile(PLANT.theta, (count, 1)) * np.linspace(0.9, 1.1, count)[:, None]
    observer = SecondOrder(np.full(count, 60.0), np.full(count, 2e3), np.linspace(20, 300, count))
    return Lanes(
        observer, theta.astype(dtype), np.zeros_like(theta, dtype), np.ones((count, 1), dtype)
    )


@pytest.mark.parametrize("count", [1, 7, 70])
def test_every_lane_is_a_pass_of_its_own(count, steps):
    filters = LOWPASS.discretise(H)
    got = Scan(tile=16).run(PLANT, lanes(count), filters, steps, "scores")
    assert len(got.square) == count
    for i in (0, count // 2, count - 1):
        own = jax.tree.map(lambda leaf, i=i: leaf[i], lanes(count))
        one, record = jax.tree.map(lambda leaf: np.asarray(leaf)[None], (filters, steps))
        want, _ = run_pass(PLANT, own.observer, one, record, own.theta, store="scores")
        for name in vars(got):
            np.testing.assert_allclose(
                getattr(got, name)[i], getattr(want, name)[0], rtol=1e-9, atol=1e-12, err_msg=name
            )


def test_single_precision_stays_single(steps):
    filters = LOWPASS.discretise(H)
    single = Scan().run(PLANT, lanes(3, np.float32), filters, steps)
    double = Scan().run(PLANT, lanes(3), filters, steps)
    assert single.information.dtype == np.float32
    np.testing.assert_allclose(single.square, double.square, rtol=1e-3)


def test_a_shape_is_compiled_once(steps):
    filters, compiled = LOWPASS.discretise(H), []

    def listen(event: str, duration_secs: float, **details: str | int) -> None:
        del duration_secs, details
        if event.endswith("backend_compile_duration"):
            compiled.append(event)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        Scan(tile=32).run(PLANT, lanes(20), filters, steps)
        assert compiled
        compiled.clear()
        Scan(tile=32).run(PLANT, lanes(31), filters, steps)  # other lanes, the same tile
        assert not compiled
    finally:
        jax.monitoring.clear_event_listeners()
