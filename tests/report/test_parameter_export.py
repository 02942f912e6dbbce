"""Parameters as JSON and CSV: the numbers of the result, and what they came from."""

import csv
import json
from xml.etree import ElementTree

import numpy as np
import pytest
from found import DECLARED, HIDDEN, discovery
from typer.testing import CliRunner

import eoi_jax as eoi
from eoi_jax.cli.commands import app
from eoi_jax.compiler import jax_setup
from eoi_jax.report.discovery import strengths


def rows_of(path):
    with path.open(encoding="utf-8", newline="") as file:
        return {row["name"]: row for row in csv.DictReader(file)}


@pytest.fixture(scope="module")
def found():
    return discovery()


def test_json_has_every_number_of_a_discovery(found, tmp_path):
    path = eoi.export_parameters(found, tmp_path / "parameters.json")
    content = json.loads(path.read_text(encoding="utf-8"))
    intervals = eoi.uncertainty(found.found).intervals()
    assert list(content["parameters"]) == list(found.plant.parameters)
    for name, row in content["parameters"].items():
        assert row["value"] == found.plant.parameters[name]
        assert row["standard_error"] == found.found.standard_errors[name]
        assert (row["low"], row["high"]) == intervals[name]
        assert row["unit"] == found.plant.units[name]
        assert row["estimated"]
        assert row["effect"] == (name if name in HIDDEN else "")
    assert content["model"] == "mass on a spring"
    assert content["records"][0]["hash"] == found.records[0].data_hash
    assert content["versions"]["eoi_jax"]


def test_strengths_of_effects_at_the_input_are_those_that_are_printed(found, tmp_path):
    path = eoi.export_parameters(found, tmp_path / "parameters.json")
    parameters = json.loads(path.read_text(encoding="utf-8"))["parameters"]
    for name, (strength, value, error) in strengths(found).items():
        at_input = parameters[name]["at_input"]
        assert at_input["value"] == pytest.approx(value, rel=1e-9)
        assert at_input["standard_error"] == pytest.approx(error, rel=1e-9)
        assert (at_input["input"], at_input["unit"]) == (strength.input, "N")
    assert parameters["mass"]["at_input"] is None


def test_a_table_has_the_same_numbers(found, tmp_path):
    rows = rows_of(eoi.export_parameters(found, tmp_path / "parameters.csv"))
    wanted = found.found.to_pandas()
    assert list(rows) == list(wanted.index)
    for name, row in rows.items():
        assert float(row["value"]) == wanted.loc[name, "estimate"]
        for column in ("standard_error", "low", "high"):
            assert float(row[column]) == wanted.loc[name, column]
        assert row["effect"] == wanted.loc[name, "effect"]
    assert rows["coulomb_friction"]["unit_at_input"] == "N"
    assert rows["mass"]["value_at_input"] == ""


def test_an_effect_that_was_found_reaches_a_joint_by_the_name_that_is_printed(
    found, tmp_path, monkeypatch
):
    monkeypatch.setattr(jax_setup, "configure", lambda: None)
    joint = '<joint name="slider" type="prismatic"/>'
    (tmp_path / "rig.urdf").write_text(f"<robot>{joint}</robot>")
    found.save(tmp_path / "found.npz")
    command = ["export", "found.npz", "--robot", "rig.urdf", "--output", "new.urdf", "--joint"]
    monkeypatch.chdir(tmp_path)
    formulas = "slider:friction=coulomb_friction*mass,damping=viscous"
    done = CliRunner().invoke(app, [*command, formulas])
    assert done.exit_code == 0, done.output
    assert "coulomb_friction" in str(found)
    values = ElementTree.parse(tmp_path / "new.urdf").getroot()[0][0].attrib
    wanted = found.plant.parameters
    friction = wanted["coulomb_friction"] * wanted["mass"]
    assert float(values["friction"]) == friction == pytest.approx(0.4, rel=0.01)  # [N]
    assert float(values["damping"]) == wanted["viscous"]


def test_what_is_not_known_is_empty(tmp_path):
    """Of a plant nothing is known but its values."""
    path = eoi.export_parameters(DECLARED, tmp_path / "p.csv")
    row = rows_of(path)["mass"]
    assert (row["value"], row["standard_error"], row["low"]) == ("1.3", "", "")
    path = eoi.export_parameters(DECLARED, tmp_path / "p.json")
    content = json.loads(path.read_text(encoding="utf-8"))
    assert content["parameters"]["mass"]["standard_error"] is None
    assert content["records"] == []


def test_a_fixed_parameter_is_told_apart(tmp_path):
    plant = eoi.plant_from_text(
        {"level": "-a*level + b*flow"}, {"a": 0.5, "b": 2.0}, ["level"], ["flow"], fixed=["b"]
    )
    time = 0.05 * np.arange(400)
    drive = eoi.excitation.square(time, 1.0, 0.2)
    fit = eoi.identify(plant, eoi.simulate(plant, time, drive), passes=2)
    rows = rows_of(eoi.export_parameters(eoi.uncertainty(fit), tmp_path / "uncertainty.csv"))
    assert (rows["a"]["estimated"], rows["b"]["estimated"]) == ("true", "false")
    rows = rows_of(eoi.export_parameters(fit, tmp_path / "fit.csv"))
    assert (rows["a"]["estimated"], rows["b"]["estimated"]) == ("true", "false")
    assert float(rows["b"]["standard_error"]) == 0.0


def test_what_is_no_estimate_is_refused(found, tmp_path):
    with pytest.raises(ValueError, match=r"`path` must end in .json or .csv, got .*p.txt"):
        eoi.export_parameters(DECLARED, tmp_path / "p.txt")
    with pytest.raises(ValueError, match="`result` must be a Plant or a result with an estimate, "):
        eoi.export_parameters(found.before, tmp_path / "p.json")
    with pytest.raises(ValueError, match=r"`path` must be writable \(No such file"):
        eoi.export_parameters(DECLARED, tmp_path / "none" / "p.json")


@pytest.mark.parametrize("suffix", [".csv", ".json"])
def test_parameters_take_the_place_of_parameters_only(tmp_path, suffix):
    path = tmp_path / f"data{suffix}"
    for _ in range(2):
        eoi.export_parameters(DECLARED, path)
    path.write_text("time,u,y\n0,1,2\n")
    with pytest.raises(ValueError, match="`path` must not be a file that eoi_jax did not write"):
        eoi.export_parameters(DECLARED, path)
    assert path.read_text().startswith("time,u,y")
