"""The fuzzing of equations: thousands of inputs here, a million in the benchmark; and its eyes."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def run(*arguments):
    """In a process of its own: an audit cannot be taken off again."""
    paths = [str(ROOT), os.environ.get("PYTHONPATH", "")]
    there = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    return subprocess.run(
        [sys.executable, *arguments], env=there, capture_output=True, text=True, timeout=120
    )


def test_thousands_of_hostile_texts_run_nothing():
    done = run(str(ROOT / "benchmarks" / "robustness" / "fuzz_equations.py"), "--quick")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "all was well" in done.stdout


SEES = """
import sys
from benchmarks.robustness import fuzz_equations as fuzz
watch = fuzz.Watch()
sys.addaudithook(watch)
seen = fuzz.tried(iter(["1 + 1", "open('/dev/null')", "1/0"]), eval, watch)
assert watch.events["exec"] == 3, watch.events
assert watch.events["compile"] == 3, watch.events
assert watch.events["open"] == 1, watch.events
assert seen.wrong == ["ZeroDivisionError: '1/0'"], seen
"""


def test_the_audit_sees_what_runs():
    done = run("-c", SEES)
    assert done.returncode == 0, done.stderr
