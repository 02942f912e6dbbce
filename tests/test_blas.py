"""BLAS has one thread while the library computes, and its own number after."""

import threading

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import eoi_jax as eoi
from eoi_jax._blas import one_thread


class EnoughError(Exception):
    """Ends a call that has been watched for long enough."""


def threads():
    return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}


@pytest.fixture
def two():
    """Two threads, whatever this machine has."""
    one_thread()(threads)()  # all BLAS is loaded then
    with threadpool_limits(2, "blas"):
        yield
        assert threads() == {2}


@pytest.fixture(scope="module")
def swing():
    """A pendulum and a record of it."""
    plant, time = eoi.plants.pendulum(), 2e-3 * np.arange(1000)
    return plant, eoi.simulate(plant, time, np.sin(3.0 * time))


def test_a_discovery_and_its_end_by_an_error(two, swing):
    seen = []

    def told(stage, done, stages):
        if stage.startswith("searching"):
            seen.append(threads())
            raise EnoughError

    with pytest.raises(EnoughError):
        eoi.discover(*swing, callback=told)
    assert seen == [{1}]


@pytest.mark.slow
@pytest.mark.parametrize("verb", [eoi.identify, eoi.refine])
def test_an_estimate(verb, two, swing):
    seen = []
    verb(*swing, callback=lambda *_: seen.append(threads()))
    assert seen[0] == {1}


def test_one_call_within_another(two):
    @one_thread()
    def outer():
        return one_thread()(threads)(), threads()

    assert outer() == ({1}, {1})


def test_a_call_from_another_thread_leaves_it_as_it_is(two):
    seen = []
    thread = threading.Thread(target=one_thread()(lambda: seen.append(threads())))
    thread.start()
    thread.join()
    assert seen == [{2}]
