"""The benchmark of throughput: its rivals compute the same, and it says what it is asked for."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.speed import throughput
from benchmarks.speed import throughput_rivals as rivals
from eoi_jax.estimation.engines import Native

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "speed" / "throughput.py"


@pytest.fixture(scope="module")
def case():
    return throughput.Case(np.float64, 128, 1200)


@pytest.mark.slow
@pytest.mark.parametrize("rival", [rivals.C, rivals.Numba, rivals.Loop])
def test_rivals_written_by_hand_add_up_the_same(rival, case):
    if rival is rivals.C and not rivals.C.available():
        pytest.skip("no gcc")
    ours = case.engine(Native(), 128)()
    assert np.all(ours.count > 0)
    throughput.agree(rival.__name__, rival(case.problem(128), 2)(), ours, np.dtype(np.float64))


def test_rivals_leave_denormal_numbers_alone(case):
    if not rivals.C.available():
        pytest.skip("no gcc")
    rivals.C(case.problem(128), 1)()
    assert np.nextafter(0.0, 1.0) * 1.0 > 0.0


def test_a_rival_that_differs_is_found(case):
    ours = case.engine(Native(), 128)()
    wrong = throughput.as_rows(ours) * (1.0 + 1e-6)
    with pytest.raises(SystemExit, match="differs"):
        throughput.agree("wrong", wrong, ours, np.dtype(np.float64))


@pytest.mark.slow
@pytest.mark.long
def test_the_command_prints_one_object():
    """All rivals once, few lanes and steps; the machine may be busy, so no time is asserted."""
    words = ["--quick", "--json", "--lanes", "64", "--steps", "600", "--rounds", "1"]
    environment = {key: value for key, value in os.environ.items() if key != "XLA_FLAGS"}
    environment["PYTHONPATH"] = str(SCRIPT.parents[2])
    shown = subprocess.run(
        [sys.executable, str(SCRIPT), *words],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    found = json.loads(shown)
    assert (found["lanes"], found["steps"], found["dtype"]) == (64, 600, "float32")
    assert found["ns_per_lane_step"] > 0
    assert found["ratio_to_plain_vmap"] > 0
    assert (found["ratio_to_c"] is None) == (not rivals.C.available())
    assert set(found["float32_error"]) == {"index", "information"}
