"""A damaged store of a sweep is computed again where it does not read, or refused in a sentence."""

import random
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import eoi_jax as eoi
from benchmarks.robustness import damaged_stores as campaign
from eoi_jax._checks import StoreWarning
from eoi_jax.estimation.sweep.marks import digest

KINDS = dict(campaign.damages())


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("chunk of `parameters` missing", "computed again"),
        ("chunk of `index` flipped", "computed again"),
        ("chunk of `parameters` exchanged", "computed again"),
        ("chunk of `done` garbled", "computed again"),
        ("chunk of `blocks` folder_instead", "computed again"),
        ("chunk of `done` folder_instead", "computed again"),
        ("whole other sweep", "refused"),
        ("two chunks exchanged", "computed again"),
        ("metadata of `done` missing", "written anew"),
        ("metadata of `parameters` empty", "written anew"),
        ("metadata of `.` garbled", "written anew"),
        ("metadata of `.` exchanged", "refused"),
        ("chunk of `theta_0` truncated", "written anew"),
        ("attributes emptied", "written anew"),
        ("`done` too short", "written anew"),
        ("file in place of an array", "written anew"),
        ("leftovers of a killed process", "nothing said"),
        ("all metadata missing", "refused"),
        ("file in place of the store", "refused"),
    ],
)
def test_damage_is_computed_again_written_anew_or_refused(kind, expected):
    assert expected in campaign.outcome(kind, seed=0)


@pytest.mark.parametrize(
    ("damage", "array"), [(campaign.flipped, "index"), (campaign.folder_instead, "done")]
)
def test_only_the_damaged_chunk_is_computed_again(tmp_path, damage, array):
    store = tmp_path / "store"
    whole = campaign.swept(store).load()
    stamps = marks(store)
    damage(campaign.chunk_of(store, array, random.Random(1)), store, random.Random(1))
    with pytest.warns(StoreWarning, match=r"1 of 4 chunks .* is damaged, and shown as not_run"):
        read = eoi.open_sweep(store)
    assert np.sum(read.status.values == 0) == 2
    with pytest.warns(StoreWarning, match=r"1 of 4 chunks .* is damaged, and computed again"):
        again = campaign.swept(store)
    assert campaign.alike(again, whole)
    changed = [path for path, stamp in marks(store).items() if stamps[path] != stamp]
    assert len(changed) == 1


def marks(store):
    """When each chunk was marked as done."""
    return {one: one.stat().st_mtime_ns for one in store.glob("done/c/**/*") if one.is_file()}


def test_a_store_that_has_lost_an_array_is_refused_by_who_reads_it(tmp_path):
    store = tmp_path / "store"
    campaign.swept(store)
    (store / "index" / "zarr.json").unlink()
    with pytest.raises(ValueError, match=r"`store` must be whole.*The same sweep with this store"):
        eoi.open_sweep(store)


KILLED = """
import os, signal, sys
from pathlib import Path
from benchmarks.robustness import damaged_stores as campaign
from eoi_jax.estimation.sweep import store

def kill(*_): os.kill(os.getpid(), signal.SIGKILL)

store.digest = kill  # between the arrays and their mark
campaign.eoi.configure(cache=False)
campaign.swept(Path(sys.argv[1]))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="has no SIGKILL")
def test_a_chunk_is_marked_after_its_arrays_are_written(tmp_path):
    paths = [str(Path(campaign.__file__).parents[2]), str(Path(eoi.__file__).parents[1])]
    code = f"import sys; sys.path[:0] = {paths!r}\n{KILLED}"
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path / "a")], capture_output=True)
    assert done.returncode == -9, done.stderr
    assert marks(tmp_path / "a") == {}
    assert list((tmp_path / "a" / "parameters" / "c").rglob("*"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = campaign.swept(tmp_path / "a")
    assert campaign.alike(again, campaign.swept(None))


def test_a_mark_changes_with_whatever_it_stands_for():
    arrays = {"a": np.array([1.0, np.nan]), "b": np.array([1, 2], np.int8)}
    mark = digest("sweep", (0, 1), arrays)
    assert mark == digest("sweep", (0, 1), {**arrays, "a": np.array([1.0, -np.nan])})
    for other in (
        digest("other", (0, 1), arrays),
        digest("sweep", (1, 0), arrays),
        digest("sweep", (0, 1), {**arrays, "a": np.array([1.0, 2.0])}),
        digest("sweep", (0, 1), {**arrays, "b": np.array([2, 1], np.int8)}),
    ):
        assert other != mark
