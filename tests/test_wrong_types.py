"""Arguments of a wrong type meet a house message, outside the tests' own type checks too."""

import subprocess
import sys

import pytest

CALLS = {
    "identify(plant, None)": "`records` must hold at least one record, got none",
    "identify(plant, [3])": "`records` must be a Record or several, got int",
    "identify(plant, 3)": "`records` must be a Record or several, got int",
    "identify('pendulum', run)": "`plant` must be a Plant, got str",
    "identify(plant, run, smoothing='a')": "`smoothing` must be a cut-off > 0 in rad/s, or False",
    "identify(plant, run, transient='a')": "`transient` must be a time ≥ 0 in seconds, got a",
    "sweep(plant, run, substeps=2.5)": "`substeps` must be an integer ≥ 1, got 2.5",
    "refine(3, run)": "`plant` must be a Plant, got int",
    "validate('pendulum', run)": "`plant` must be a Plant, got str",
    "validate(plant, None)": "`records` must hold at least one record, got none",
    "compare('pendulum', run)": "`plant` must be a Plant, got str",
    "sweep('pendulum', run, None)": "`plant` must be a Plant, got str",
    "diagnose(plant)": "`identification` must be what `identify` returned, got Plant",
    "bootstrap(plant, run)": "`identification` must be what `identify` returned, got Plant",
    "remaining(plant)": "`refinement` must be what `refine` returned, got Plant",
    "profile(plant, run, 'a')": "`refinement` must be what `refine` returned, got Plant",
    "uncertainty(plant)": "`estimate` must be an estimate, got Plant",
    "discover(plant, None)": "`records` must hold at least one record, got none",
    "discover(plant, run, [3])": "`validation` must be a Record or several, got int",
    "discover(plant, run, effects=[3])": "`effects` must be names or effects, got int",
    "discover(plant, run, most=1.5)": "`most` must be an integer ≥ 1, got 1.5",
    "discover(plant, run, alpha=2)": "`alpha` must lie in (0, 1), got 2",
    "observers.HighOrder(1.0, 2.0)": "`degree` must be an integer ≥ 1, got 2.0",
    "LowPass(1.0, 2.5)": "`order` must be an integer ≥ 1, got 2.5",
}
SCRIPT = """
import eoi_jax as eoi
import numpy as np
plant = eoi.plants.pendulum()
time = 0.01 * np.arange(500)
run = eoi.Record(time, np.sin(time), np.cos(time))
for call in {calls!r}:
    try:
        eval("eoi." + call)
    except ValueError as error:
        print(error)
"""


@pytest.fixture(scope="module")
def answers() -> list[str]:
    script = SCRIPT.format(calls=list(CALLS))
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=120
    )
    return done.stdout.splitlines()


@pytest.mark.parametrize("number", range(len(CALLS)), ids=list(CALLS))
def test_a_wrong_type_is_named_with_its_rule(answers: list[str], number: int):
    assert answers[number].startswith(list(CALLS.values())[number])
