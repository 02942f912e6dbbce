"""BLAS has one thread while the library computes; freed memory goes back to the system."""

import threading
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import eoi_jax as eoi
from eoi_jax._process import _trim, memory_returned, one_thread


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


def resident():
    """Memory of this process that is in use [MB]."""
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return float(status["VmRSS"].split()[0]) / 1e3


@pytest.mark.skipif(_trim() is None, reason="a C library without malloc_trim")
def test_freed_memory_goes_back_though_blocks_between_stay():
    """200 MB in blocks of 50 kB, of which every fortieth stays."""
    blocks, remaining = [np.ones(6250) for _ in range(4000)], []
    with memory_returned():
        remaining = blocks[::40]
        del blocks
        freed = resident()
    assert resident() < freed - 100.0
    assert sum(map(len, remaining)) == 100 * 6250
