"""Real worker processes: a Dask cluster that loses a worker, a client that is killed."""

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from problems import grid, moved_mass_spring

import eoi_jax as eoi
from eoi_jax.estimation.observers import SecondOrder, gains
from eoi_jax.estimation.sweep.store import Store

pytestmark = pytest.mark.filterwarnings("ignore")  # of dask and of forks, not ours

PLANT = eoi.plants.mass_spring_damper()
CHUNKS = 12


def settings(samples=4000):
    t = grid(samples, 2e-3)
    u, y = moved_mass_spring(t, {"alpha": 40.0, "beta": 1.2, "rho": 3.0})
    sets = gains(SecondOrder, {"c1": 60.0, "c2": 2e3, "c3": np.linspace(150.0, 300.0, 2 * CHUNKS)})
    return {
        "plant": PLANT,
        "records": eoi.Record(t, u, y, hold="smooth"),
        "observers": sets,
        "lowpass": eoi.LowPass(20.0),
        "passes": 2,
        "substeps": 1,
        "smoothing": False,
        "chunk": 2,
    }


def same(a, b):
    for name in a.data_vars:
        np.testing.assert_allclose(a[name], b[name], rtol=1e-12, err_msg=name)


@pytest.fixture(scope="module")
def local():
    return eoi.sweep(**settings())


@pytest.mark.slow
@pytest.mark.long
def test_a_dask_cluster_that_loses_a_worker_gives_the_same_numbers(local, tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed")
    landed: list[tuple] = []
    write, enough = Store.write, threading.Event()

    def counted(self, place, arrays):
        write(self, place, arrays)
        landed.append(place)
        enough.set()

    monkeypatch.setattr(Store, "write", counted)
    cluster = distributed.LocalCluster(
        n_workers=3, threads_per_worker=1, processes=True, dashboard_address=None
    )
    with cluster, distributed.Client(cluster) as client:
        workers = client.run(os.getpid)

        def kill_one():
            enough.wait(300)
            os.kill(next(iter(workers.values())), signal.SIGKILL)

        killer = threading.Thread(target=kill_one)
        killer.start()
        result = eoi.sweep(**settings(), store=tmp_path / "s", executor=client.get_executor())
        killer.join()
        after = client.run(os.getpid)
    assert set(after.values()) != set(workers.values())  # one was lost, and replaced
    assert len(landed) == len(set(landed)) == CHUNKS
    same(result, local)


@pytest.mark.slow
def test_processes_of_the_standard_library_give_the_same_numbers(local):
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as executor:
        same(eoi.sweep(**settings(), executor=executor), local)


CLIENT = """
import warnings; warnings.simplefilter("ignore")
import sys; sys.path[:0] = {tests!r}
import eoi_jax as eoi
eoi.configure(cache=False)
import test_sweep_cluster as one
eoi.sweep(**one.settings(), store={store!r})
"""


@pytest.mark.slow
def test_a_killed_client_resumes_and_computes_nothing_twice(local, tmp_path):
    store = tmp_path / "s"
    here = Path(__file__).resolve()
    folders = [str(here.parent), str(here.parents[2])]  # of this file and of `problems`
    code = CLIENT.format(tests=folders, store=str(store))
    client = subprocess.Popen([sys.executable, "-c", code])
    deadline = time.monotonic() + 240
    while len(_marks(store)) < 3:
        assert client.poll() is None, "the client ended before it could be killed"
        assert time.monotonic() < deadline
        time.sleep(0.01)
    client.kill()
    client.wait()
    before = _marks(store)
    assert 3 <= len(before) < CHUNKS
    result = eoi.sweep(**settings(), store=store)
    after = _marks(store)
    assert len(after) == CHUNKS
    assert all(after[path] == stamp for path, stamp in before.items())
    same(result, local)


def _marks(store: Path) -> dict[Path, int]:
    """When each chunk was marked as done."""
    return {one: one.stat().st_mtime_ns for one in store.glob("done/c/**/*") if one.is_file()}
