"""Rigs with published numbers: their models, and a slice of what `measured.py` reports of them."""

import random
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import wrightomega

import eoi_jax as eoi
from benchmarks.common import ROOT
from benchmarks.measured import campaign
from benchmarks.measured import measured_rigs as rigs
from benchmarks.measured import wiener_hammerstein as circuit
from benchmarks.measured.found_cases import FIRST, FOUND
from benchmarks.measured.found_driven_cases import DRIVEN
from benchmarks.measured.found_fresh_cases import FRESH
from benchmarks.measured.found_late_cases import LATE
from benchmarks.measured.found_latest_cases import LATEST
from benchmarks.measured.found_mechanical_cases import MECHANICAL
from benchmarks.measured.found_newest_cases import NEWEST
from benchmarks.measured.found_process_cases import PROCESS
from benchmarks.measured.found_sets import sets_directory
from benchmarks.measured.found_short_cases import SHORT

# Stamps that jitter and gaps of the sensors: kept in the records' notes.
pytestmark = pytest.mark.filterwarnings("ignore::eoi_jax.RecordWarning")


def test_the_diode_obeys_its_equation():
    z = np.concatenate([np.linspace(-600.0, 600.0, 1001), np.linspace(-5.0, 5.0, 1001)])
    np.testing.assert_allclose(circuit.wright(z), wrightomega(z), rtol=1e-13)


@pytest.mark.slow
@pytest.mark.long
def test_twelve_parameters_of_the_circuit_beat_the_best_published_error(data_directory: Path):
    first = circuit.TRAIN[0]
    fit = circuit.record(data_directory, (first, first + 20000), "a fifth of the estimation part")
    check = circuit.record(data_directory, circuit.TEST, "test")
    assert len(check.time) == 78800
    result = eoi.identify(circuit.plant(), fit, passes=15)
    refined = eoi.refine(result, fit)
    for one in (result, refined):
        assert one.status.code == "converged"
        assert eoi.validate(one.plant, check).rmse[0] < 0.28e-3  # 0.242 from the whole part
    # A silicon diode at room temperature: kT/q times an emission coefficient of 1 to 2.
    assert 0.025 < refined.parameters["thermal_voltage"] < 0.055
    assert refined.parameters["zero"] == pytest.approx(5.0 / np.cos(np.pi / 6.0), rel=5e-3)


def test_friction_of_an_arm_takes_its_torque_from_each_joint(data_directory: Path):
    values = rigs.dfki_arm(data_directory, "C1").reference
    frictionless = {key: 0.0 if key[:4] in ("damp", "fric") else values[key] for key in values}
    angle, rate = np.array([0.3, -0.2]), np.array([2.0, -3.0])
    x = eoi.State(jnp.stack([angle, rate]), jnp.zeros(0))
    with_it, without = (
        np.asarray(
            rigs.double_pendulum_with_friction(0.0, x, np.zeros(2), SimpleNamespace(**parameters))
        )
        for parameters in (values, frictionless)
    )
    own, other = values["inertia_2"], values["coupling"] * np.cos(angle[1])
    inertia = np.array([[values["inertia_1"] + own + 2.0 * other, own + other], [own + other, own]])
    torque = [-0.001 * 2.0 - 0.16, 0.001 * 3.0 + 0.12]
    np.testing.assert_allclose(inertia @ (with_it - without), torque, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "within"),
    [
        ("dfki_double_pendulum, C.1", {"inertia_1": 0.02, "coupling": 0.05, "moment_2": 0.02}),
        ("schmidt_lipson, one mass", {"stiffness": 0.04}),
    ],
)
def test_published_parameters_come_back_from_elsewhere(
    name: str, within: dict[str, float], data_directory: Path
):
    rig = rigs.RIGS[name](data_directory)
    result = eoi.identify(rig.case.plant, rig.case.records, lowpass=rig.case.lowpass)
    for key, share in within.items():
        start, known = rig.case.plant.parameters[key], rig.reference[key]
        assert abs(start / known - 1.0) > 2.0 * share
        assert result.parameters[key] == pytest.approx(known, rel=share), key


@pytest.mark.parametrize(
    ("seed", "cases"), [(20261127, FIRST), (20261128, SHORT), (20261129, DRIVEN)]
)
def test_a_seed_sets_half_of_the_found_cases_aside(seed, cases):
    """Those that were looked at since are not set aside any more, and said to have been."""
    drawn = set(random.Random(seed).sample(sorted(cases), len(cases) // 2))
    aside = {name for name, case in cases.items() if case.aside}
    assert aside <= drawn
    said = (ROOT / "benchmarks/defaults.md").read_text()
    assert all(name in said for name in drawn - aside)


def test_the_late_cases_are_all_set_aside():
    assert len(LATE) == 8
    assert len(FRESH) == 11
    assert len(NEWEST) == 7
    assert len(LATEST) == 4
    assert len(MECHANICAL) == 5
    assert len(PROCESS) == 4
    later = LATE, FRESH, NEWEST, LATEST, MECHANICAL, PROCESS
    assert all(case.aside for cases in later for case in cases.values())


def test_an_absent_set_is_skipped_with_its_source(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("EOI_SETS", str(tmp_path))
    monkeypatch.setattr("sys.argv", ["campaign.py", "--found"])
    campaign.main()
    printed = capsys.readouterr().out
    assert all(
        (f"{name} is skipped" in printed) is not case.aside and "https://" in case.source
        for name, case in FOUND.items()
    )
    assert str(tmp_path) not in printed


@pytest.mark.parametrize("name", FOUND)
def test_a_found_set_has_its_three_parts(name):
    if not (sets_directory() / name.split(",")[0]).is_dir():
        pytest.skip("the set is absent; set EOI_SETS to the folder of the sets")
    rig = FOUND[name].rig(sets_directory())
    assert all(rig.parts)
    assert set(rig.declared) == set(rig.expert) == set(rig.plant.outputs)
    assert all(np.prod(rig.expert[key]) <= np.prod(rig.declared[key]) for key in rig.declared)
