"""`eoi discover`: what it prints, writes and returns; configs that hide an effect."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from found import discovery
from typer.testing import CliRunner

import eoi_jax as eoi
from eoi_jax.cli import actions, build, html_report, run_folder
from eoi_jax.cli import config as configs
from eoi_jax.cli.commands import app
from eoi_jax.cli.run_files import files_beside_run
from eoi_jax.compiler import jax_setup
from eoi_jax.discovery import requested
from eoi_jax.models import effects
from eoi_jax.models.equations.display import equation_lines
from eoi_jax.report.provenance import json_values

CONFIGS = Path(__file__).resolve().parents[2] / "configs"

HIDDEN = """
name = "hidden"
plant = "mass_spring_damper"

[discover]
effects = ["coulomb_friction", "cubic_stiffness", "input_dead_zone"]

[simulate]
sample_period = 0.002
duration = 11.998
increments = { alpha = -20.0, beta = -2.0, rho = -0.2 }
effects = { coulomb_friction = 0.3 }
noise = { position = 1e-5 }

[simulate.input.voltage]
kind = "random_steps"
low = -3.0
high = 3.0
holding_time = 0.5

[simulate.held_out.voltage]
kind = "multisine"
amplitude = 1.5
frequencies = [0.2, 3.0]
seed = 1
"""
FILES = {
    "discovery.json", "report.txt", "equation.tex", "residual.png", "effect.png", "free_run.png",
    "result.npz", "report.npz", "report.html", "config.toml",
}  # fmt: skip


@pytest.fixture(autouse=True)
def configured(monkeypatch: pytest.MonkeyPatch):
    """JAX runs already in this process, set up by conftest."""
    monkeypatch.setattr(jax_setup, "configure", lambda: None)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "hidden.toml"
    path.write_text(HIDDEN)
    return path


@pytest.fixture(scope="module")
def found():
    return discovery()


@pytest.fixture
def known(found, monkeypatch: pytest.MonkeyPatch):
    """The command with an answer that is known; what it was asked is kept.

    The records of `HIDDEN` are as long as those of the answer, since both meet in a figure.
    """
    asked = {}

    def answer(plant, records, **options):
        asked.update(options, plant=plant, records=records)
        return asked.get("answer", found)

    monkeypatch.setattr(actions, "run_discovery", answer)
    return asked


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch):
    """Without the page, which another test of the same run has."""
    monkeypatch.setattr(html_report, "write_report", lambda folder: folder)


def run_command(*arguments: object):
    return CliRunner().invoke(app, [str(one) for one in arguments])


# -- what comes out ---------------------------------------------------------------------------


OBSERVER = '[observer]\nkind = "second_order"\nc1 = 20.0\nc2 = 100.0\nc3 = 500.0\n\n'


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tables", "said"),
    [
        (OBSERVER, "[observer] is not used"),
        ("[identify]\npasses = 3\n\n", "[identify] is not used"),
        (OBSERVER + "[identify]\nsmoothing = false\n\n", "[observer] and [identify] are not used"),
        ("[lowpass]\ncutoff = 20.0\n\n", None),
        ("", None),
    ],
)
def test_tables_that_a_discovery_does_not_take_are_named(
    known, config, tmp_path, tables, said, undrawn
):
    config.write_text(HIDDEN.replace("[discover]", f"{tables}[discover]"))
    done = run_command("discover", config, "--output", tmp_path / "runs")
    assert done.exit_code == 0, done.output
    notes = json.loads((tmp_path / "runs" / "hidden" / "discovery.json").read_text())["notes"]
    assert ("not used" in done.stdout) == any("not used" in note for note in notes)
    assert any(note.startswith(said or "[") for note in notes) == (said is not None)


@pytest.mark.slow
def test_a_discovery_prints_its_report_and_writes_all_of_it(known, found, config, tmp_path):
    done = run_command("discover", config, "--output", tmp_path / "runs")
    assert done.exit_code == 0, done.output
    folder = tmp_path / "runs" / "hidden"
    assert {path.name for path in folder.iterdir()} == FILES
    assert files_beside_run(folder) == []
    assert done.stdout.startswith(str(found))
    assert (folder / "report.txt").read_text() == f"{found}\n"
    for name in ("residual", "effect", "free_run"):
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    tex = (folder / "equation.tex").read_text()
    assert tex.count(r"\begin{aligned}") == 2
    assert r"\mathrm{coulomb\_friction}" in tex
    head, _, copied = (folder / "config.toml").read_text().partition("\n")
    assert head == f"# eoi discover {config}"
    assert copied == HIDDEN
    assert eoi.load(folder / "result.npz").effects == found.effects


def test_json_is_one_object_with_everything(known, found, config, tmp_path):
    done = run_command("discover", config, "--output", tmp_path / "runs", "--json")
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert result == json.loads((tmp_path / "runs" / "hidden" / "discovery.json").read_text())
    assert result["effects"] == ["coulomb_friction", "constant_offset"]
    first = result["added"][0]
    assert first["effect"] == "coulomb_friction"
    assert first["parameters"] == found.added[0].parameters
    assert first["standard_errors"] == found.added[0].standard_errors
    assert [one["remark"] for one in result["ranking"]] == [one.remark for one in found.ranking]
    assert result["before"]["rmse"]["position"] == found.before.rmse[0]
    assert result["after"]["rmse"]["position"] == found.after.rmse[0]
    assert result["windows_after"]["rmse"]["position"] == found.windows_after.rmse[0]
    assert result["declared"]["parameters"] == found.declared.parameters
    assert result["parameters"] == found.plant.parameters
    assert "coulomb_friction·sign(position')" in result["equation"]["text"]
    for key, numeric in (("names", False), ("values", True)):
        parts = equation_lines(found.declared_part, found.added, numeric=numeric)
        lines, changes = json.loads(json.dumps(parts))
        assert result["equation"]["lines"][key] == lines
        assert result["equation"]["changes"][key] == changes
    assert len(result["records"][0]["hash"]) == 16
    assert [one["name"] for one in result["held_out_records"]] == ["hidden, held out"]
    assert set(result["versions"]) == {"eoi_jax", "jax", "numpy", "python"}
    assert result["config"]["simulate"]["effects"] == {"coulomb_friction": 0.3}


def test_the_form_of_every_effect_has_values_of_json():
    plant = eoi.plant_from_text(
        {"x": "u - a*x", "y": "w - a*y"}, {"a": 1.0}, ["x", "y"], ["u", "w"], name="pair"
    )
    library = [*effects.standard(), *effects.rare(), *effects.wider(), *effects.on_request()]
    library += [*effects.couplings(plant), *effects.input_products(plant)]
    forms = [json.loads(json.dumps(json_values(vars(effect)))) for effect in library]
    named = [[signal["name"] for signal in form.get("signals", ())] for form in forms]
    assert ["x", "y"] in named
    assert ["w", "x"] in named


@pytest.mark.slow
def test_quiet_prints_only_the_folder(known, config, tmp_path, undrawn):
    done = run_command("discover", config, "--output", tmp_path / "runs", "--quiet")
    assert done.stdout == f"{tmp_path / 'runs' / 'hidden'}\n"


@pytest.mark.slow
def test_a_config_may_begin_with_the_mark_of_its_encoding(known, config, tmp_path, undrawn):
    config.write_text(HIDDEN, encoding="utf-8-sig")
    done = run_command("discover", config, "--output", tmp_path / "runs")
    assert done.exit_code == 0, done.output
    copy = tmp_path / "runs" / "hidden" / "config.toml"
    assert copy.read_text(encoding="utf-8").endswith(f"\n{HIDDEN}")
    assert configs.load(copy) == configs.load(config)


@pytest.mark.slow
def test_unexplained_ends_with_1_says_so_and_writes_the_maps(known, found, config, tmp_path):
    status = eoi.Status("unexplained", "No effect tried is justified.")
    known["answer"] = dataclasses.replace(
        found, effects=(), added=(), found=found.declared, plant=found.declared.plant,
        after=found.before, windows_after=found.windows_before, status=status,
    )  # fmt: skip
    done = run_command("discover", config, "--output", tmp_path / "runs", "--json")
    assert done.exit_code == 1
    assert "something that none of the tested effects explains" in done.stderr
    result = json.loads(done.stdout)
    assert result["status"]["code"] == "unexplained"
    assert result["effects"] == []
    assert {path.name for path in (tmp_path / "runs" / "hidden").iterdir()} == FILES


@pytest.mark.slow
def test_nothing_missing_is_an_answer(known, found, config, tmp_path):
    status = eoi.Status("nothing_missing", "The residual is noise.")
    known["answer"] = dataclasses.replace(found, effects=(), added=(), status=status)
    assert run_command("discover", config, "--output", tmp_path / "runs").exit_code == 0


def test_a_fit_that_fails_ends_with_1_and_writes_nothing(known, found, config, tmp_path):
    known["answer"] = dataclasses.replace(
        found, before=None, after=None, windows_before=None, windows_after=None,
        status=eoi.Status("no_data", "Nothing is left to score."),
    )  # fmt: skip
    done = run_command("discover", config, "--output", tmp_path / "runs", "--json")
    assert done.exit_code == 1
    assert "no answer (no_data: Nothing is left to score.)" in done.stderr
    assert json.loads(done.stdout)["before"] is None
    assert not (tmp_path / "runs").exists()


def test_the_discover_table_reaches_discover(known, config, tmp_path, undrawn):
    text = HIDDEN.replace(
        "[discover]", "[discover]\nalpha = 0.05\nmost = 2\nwindow = 1.5\nrefine = true"
    )
    config.write_text(text + "\n[lowpass]\ncutoff = 30.0\n")
    assert run_command("discover", config, "--output", tmp_path / "runs").exit_code == 0
    assert (known["alpha"], known["most"], known["window"]) == (0.05, 2, 1.5)
    assert known["refine"] is True
    names = [one.name for one in known["effects"]]
    assert names == ["coulomb_friction", "cubic_stiffness", "input_dead_zone"]
    assert known["lowpass"].cutoff == 30.0
    assert [record.name for record in known["validation"]] == ["hidden, held out"]


TEST = """
[test]
files = ["later.csv"]
time = "time"
inputs = ["voltage"]
outputs = ["position"]
"""


def test_test_records_reach_discover(known, config, tmp_path):
    time = 0.002 * np.arange(500)
    columns = np.column_stack([time, np.sin(9.0 * time), np.cos(time)])
    header = "time,voltage,position"
    np.savetxt(tmp_path / "later.csv", columns, delimiter=",", header=header, comments="")
    config.write_text(HIDDEN + TEST)
    done = run_command("discover", config, "--output", tmp_path / "runs", "--json")
    assert done.exit_code == 0, done.stderr
    (record,) = known["test"]
    assert len(record) == 500
    assert [one["name"] for one in json.loads(done.stdout)["test_records"]] == [record.name]
    assert actions._unseen_notes(run_folder.job(configs.load(config), tmp_path, None))


def test_without_a_discover_table_everything_is_tried_and_without_held_out_data_none_is_given(
    known, config, tmp_path
):
    start, _, rest = HIDDEN.partition("[discover]")
    config.write_text(start + rest[rest.index("[simulate]") : rest.index("[simulate.held_out")])
    assert run_command("discover", config, "--output", tmp_path / "runs").exit_code == 0
    assert known["effects"] is None
    assert known["validation"] is None


# -- wrong configs ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"cubic_stiffness"', '"cubic_stifness"', "Did you mean `cubic_stiffness`?"),
        ('"cubic_stiffness"', '"radiaton"', "Did you mean `radiation`?"),
        ('"cubic_stiffness"', '"coupling"', "`discover.effects` coupling needs a plant of several"),
        ('effects = ["coulomb_friction", "cubic_stiffness", "input_dead_zone"]',
         'effects = ["input_action"]', "`discover.effects` must hold one that fits mass"),
        ("[discover]", "[discover]\nalpha = 1.5", "`discover.alpha` must be a number < 1"),
        ("[discover]", "[discover]\nmost = 0", "`discover.most` must be a whole number >= 1"),
        ("[discover]", "[discover]\nlevel = 0.1", "a key of [discover]"),
        ('effects = ["coulomb_friction", "cubic_stiffness", "input_dead_zone"]', "effects = []",
         "`discover.effects` must be"),
        ("coulomb_friction = 0.3", "coulomb = 0.3", "`simulate.effects` must be one of"),
        ("coulomb_friction = 0.3", "leak = 0.3",
         "`simulate.effects.leak` must be an effect that fits the plant, got mass"),
        ("coulomb_friction = 0.3", "coulomb_friction = { level = 0.3 }",
         "`simulate.effects.coulomb_friction` must be a number"),
        ("coulomb_friction = 0.3", "end_stop = 0.3",
         "`simulate.effects.end_stop` must be a table of stiffness, position"),
        ("coulomb_friction = 0.3", 'coulomb_friction = "much"',
         "`simulate.effects.coulomb_friction` must be a number or a table of numbers"),
        ("[simulate.held_out.voltage]", "[simulate.held_out.force]",
         "`simulate.held_out` must have one table for each of the inputs voltage"),
    ],
)  # fmt: skip
def test_a_mistake_in_the_config_is_named(known, config, tmp_path, old, new, message):
    assert old in HIDDEN
    config.write_text(HIDDEN.replace(old, new))
    done = run_command("discover", config, "--output", tmp_path / "runs")
    assert done.exit_code == 2
    assert message in done.stderr
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("name", ["second_node", "power_loss", "product", "input_modulation"])
def test_a_config_takes_every_effect_that_a_call_takes(config, name):
    config.write_text(HIDDEN.replace('"coulomb_friction", "cubic', f'"{name}", "cubic'))
    job = run_folder.job(configs.load(config), config.parent, None)
    asked = build.effects(job.settings, job.model, job.records)
    names = [name, "cubic_stiffness", "input_dead_zone"]
    assert asked == requested.requested(job.model, names, job.records)


# -- hidden effects ---------------------------------------------------------------------------


def test_a_hidden_effect_is_in_the_records_and_not_in_the_model(config):
    job = run_folder.job(configs.load(config), config.parent, None)
    config.write_text(HIDDEN.replace("effects = { coulomb_friction = 0.3 }", ""))
    plain = run_folder.job(configs.load(config), config.parent, None)
    assert job.model.names == plain.model.names
    for with_it, without in ((job.records, plain.records), (job.held_out, plain.held_out)):
        difference = with_it[0].outputs - without[0].outputs
        assert np.max(np.abs(difference)) > 100 * 1e-5  # the noise
        np.testing.assert_array_equal(with_it[0].inputs, without[0].inputs)
    noise = [one.data_hash for one in (*job.records, *job.held_out)]
    assert noise[0] != noise[1]


def test_an_effect_with_several_parameters_is_a_table(config):
    stop = "end_stop = { stiffness = 500.0, position = 0.01 }"
    config.write_text(HIDDEN.replace("coulomb_friction = 0.3", stop))
    (free,) = run_folder.job(configs.load(config), config.parent, None).records
    config.write_text(HIDDEN.replace("effects = { coulomb_friction = 0.3 }", ""))
    (plain,) = run_folder.job(configs.load(config), config.parent, None).records
    below = np.cumsum(plain.outputs[:, 0] > 0.01 - 1e-4) == 0
    np.testing.assert_allclose(free.outputs[below], plain.outputs[below], atol=1e-9)
    assert np.max(free.outputs) < 0.9 * np.max(plain.outputs)


def test_with_an_effect_the_declared_parameters_may_be_right(config):
    config.write_text(HIDDEN.replace("increments = { alpha = -20.0, beta = -2.0, rho = -0.2 }", ""))
    settings = configs.load(config)
    assert len(build.records(settings, build.plant(settings, CONFIGS), CONFIGS)) == 1


def test_the_command_names_what_a_config_hides(config, tmp_path):
    done = run_command("discover", config, "--output", tmp_path / "runs", "--json")
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert result["effects"] == ["coulomb_friction"]
    friction = result["added"][0]
    error = friction["standard_errors"]["coulomb_friction"]
    # 2 ms is short against the motion: what the step leaves is below a percent.
    allowed = 5.0 * error + 0.003
    assert friction["parameters"]["coulomb_friction"] == pytest.approx(0.3, abs=allowed)
    assert result["after"]["rmse"]["position"] < 0.1 * result["before"]["rmse"]["position"]
