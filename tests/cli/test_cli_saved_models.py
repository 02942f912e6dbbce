"""`eoi validate` and `eoi compare`: models of finished runs on other data."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import eoi_jax as eoi
from eoi_jax.cli.commands import app
from eoi_jax.cli.run_files import files_beside_run
from eoi_jax.compiler import jax_setup
from eoi_jax.models.storage import save

CONFIG = """
name = "good"
[model]
outputs = ["level"]
inputs = ["flow"]
parameters = { a = 0.4, b = 1.5 }
units = { level = "m" }
derivatives = { level = "-a*level + b*flow" }
[identify]
passes = 5
[data]
files = ["run.csv"]
time = "t"
inputs = ["valve"]
outputs = ["height"]
scale = { height = 0.01 }
slice = [0, 1500]
[validation]
files = ["test.csv"]
slice = [0, 800]
"""
CONTROLLER = """[controller]
kind = "law"
law = "law.py:law"
"""
NOISE = 1e-2  # [m]


def called(*arguments):
    return CliRunner().invoke(app, [str(one) for one in arguments])


def answer(*arguments):
    done = called(*arguments, "--json")
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


def write(path: Path, seed: int) -> None:
    """A measured file in centimetres: dy/dt = -0.5 y + 2 u."""
    plant = eoi.plant_from_text(
        {"level": "-a*level + b*flow"}, {"a": 0.5, "b": 2.0}, inputs=["flow"], outputs=["level"]
    )
    time = np.arange(0.0, 40.0, 0.02)
    flow = eoi.excitation.prbs(time, 1.0, 0.5, seed=seed)
    y = eoi.simulate(plant, time, flow, hold="zero").outputs[:, 0]
    y = y + NOISE * np.random.default_rng(seed).standard_normal(len(time))
    rows = np.column_stack([time, flow, 100 * y])
    np.savetxt(path, rows, delimiter=",", header="t,valve,height", comments="")


def stored(place: Path, name: str, plant: eoi.Plant) -> Path:
    """The folder of a run of the same config with another model."""
    run = place / "runs" / name
    run.mkdir()
    (run / "config.toml").write_text((place / "good.toml").read_text())
    save(plant, run / "result.npz")
    return run


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jax_setup, "configure", lambda: None)
        place: Path = tmp_path_factory.mktemp("saved")
        for seed, name in enumerate(("run", "test", "new", "other")):
            write(place / f"{name}.csv", seed)
        (place / "good.toml").write_text(CONFIG)
        done = called("identify", place / "good.toml", "--output", place / "runs", "--quiet")
        assert done.exit_code == 0, done.output
        plant = eoi.load(place / "runs" / "good" / "result.npz").plant
        stored(place, "wrong", plant.with_parameters({"b": 1.5}))
        stored(place, "other", eoi.plants.pendulum())
        config = stored(place, "law", plant) / "config.toml"
        config.write_text(config.read_text() + CONTROLLER)
        (place / "bad.csv").write_text("t,valve\n" + "".join(f"{i},0\n" for i in range(100)))
        yield place


@pytest.fixture(autouse=True)
def here(monkeypatch, folder, tmp_path):
    """JAX runs already in this process, set up by conftest."""
    monkeypatch.setattr(jax_setup, "configure", lambda: None)
    monkeypatch.chdir(folder)
    return tmp_path


def test_a_saved_model_is_judged_as_by_the_function(folder):
    """The columns, scale, hold and skew are those of the run; a slice is that of its own files."""
    found = answer("validate", "runs/good", "new.csv")
    record = eoi.read_record(
        "new.csv", time="t", inputs="valve", outputs="height", scale={"height": 0.01}
    )
    result = eoi.load("runs/good/result.npz")
    expected = eoi.validate(result, record)
    assert expected.predictions[0].holds == result.records[0].holds
    errors = found["validation"]
    assert errors["fit"]["level"] == expected.fit[0] > 98
    assert errors["rmse"]["level"] == pytest.approx(NOISE, rel=0.1)
    assert errors["scored"] == expected.scored > 1900  # of 2000, not of the first 1500
    y = record.outputs[-expected.scored :, 0]
    error = y - expected.predictions[0].outputs[-expected.scored :, 0]
    fit = 100 * (1 - np.linalg.norm(error) / np.linalg.norm(y - np.mean(y)))
    assert errors["fit"]["level"] == pytest.approx(fit, rel=1e-9)
    assert found["windows"]["window"] == pytest.approx(4.0)
    assert found["windows"]["rmse"]["level"] == pytest.approx(NOISE, rel=0.3)
    files = {path.name for path in (folder / "runs" / "good.validate").iterdir()}
    assert files_beside_run(folder / "runs" / "good.validate") == []
    assert files == {
        "validate.json",
        "validate.txt",
        "validate.png",
        "correlation.png",
        "prediction.csv",
    }


def test_a_file_that_is_measured_at_its_beginning_is_predicted_to_its_end(folder, tmp_path):
    """The inputs of tomorrow, with the outputs of the first samples."""
    header, *lines = (folder / "new.csv").read_text().splitlines()
    lines[200:] = [line.rsplit(",", 1)[0] + "," for line in lines[200:]]
    (tmp_path / "tomorrow.csv").write_text("\n".join([header, *lines]))
    found = answer("validate", "runs/good", tmp_path / "tomorrow.csv", "--output", tmp_path)
    (note,) = [note for note in found["notes"] if "predicted only" in note]
    assert note.startswith("1800 of 2000 samples of tomorrow are predicted only")
    rows = (tmp_path / "good.validate" / "prediction.csv").read_text().splitlines()
    assert rows[0] == "time [s],level [m]"
    table = np.array([row.split(",") for row in rows[1:]], float)
    measured = np.loadtxt(folder / "new.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table[:, 0], measured[:, 0], atol=1e-9)
    np.testing.assert_allclose(table[:, 1], 0.01 * measured[:, 2], atol=0.1)


def planned(folder: Path, path: Path, columns: tuple[int, ...] = (0, 1)) -> np.ndarray:
    """Some columns of the new file, by default those without the output; the whole table."""
    lines = [line.split(",") for line in (folder / "new.csv").read_text().splitlines()]
    path.write_text("\n".join(",".join(line[i] for i in columns) for line in lines))
    return np.array(lines[1:], float)


def test_a_plan_of_few_rows_is_refused_with_what_to_add(folder, tmp_path):
    planned(folder, path := tmp_path / "plan.csv")
    path.write_text("\n".join(path.read_text().splitlines()[:6]))
    refused = called("predict", "runs/good", path, "--initial", "level=0.3", "--output", tmp_path)
    assert refused.exit_code == 2
    assert "`FILE` must have at least 8 rows, got 5 in" in refused.output
    assert "Add rows between these, with the inputs that act there" in refused.output


def test_planned_inputs_without_outputs_are_predicted_from_a_given_start(folder, tmp_path):
    table = planned(folder, tmp_path / "plan.csv")
    said = called("predict", "runs/good", tmp_path / "plan.csv", "--initial", "level=0.3",
                  "--output", tmp_path)  # fmt: skip
    assert said.exit_code == 0, said.output
    sentence = "2000 samples of plan predicted by runs/good, every 0.02 s; "
    assert f"{sentence}the outputs start from level 0.3 m (--initial)." in said.stdout
    rows = (tmp_path / "good.predict" / "prediction.csv").read_text().splitlines()
    assert rows[0] == "time [s],flow,level [m]"
    written = np.array([row.split(",") for row in rows[1:]], float)
    result = eoi.load("runs/good/result.npz")
    time, hold = table[:, 0], result.records[0].holds
    expected = eoi.simulate(result.plant, time, table[:, 1], {"level": 0.3}, hold=hold)
    np.testing.assert_allclose(written[:, 2], expected.outputs[:, 0], atol=1e-8)
    files = {path.name for path in (tmp_path / "good.predict").iterdir()}
    assert files_beside_run(tmp_path / "good.predict") == []
    assert files == {"predict.json", "predict.txt", "prediction.csv", "prediction.png"}


@pytest.mark.parametrize(("offset", "order"), [("", 1), ("+01:00", 1), ("", -1)])
def test_a_prediction_has_the_dates_of_its_file(folder, tmp_path, offset, order):
    """In UTC where the file has offsets."""
    path = tmp_path / "plan.csv"
    table = planned(folder, path, (0, 1, 2))
    dates = np.datetime64("2026-01-05T06:00", "ms") + np.rint(1e3 * table[:, 0]).astype(int)
    rows = zip(dates.tolist(), table.tolist(), strict=True)
    lines = [f"{date.isoformat()}{offset},{row[1]},{row[2]}" for date, row in rows]
    path.write_text("\n".join(["t,valve,height", *lines[::order]]))
    for command, name in (("predict", "good.predict"), ("validate", "good.validate")):
        done = called(command, "runs/good", path, "--output", tmp_path)
        assert done.exit_code == 0, done.output
        head, *rows = (tmp_path / name / "prediction.csv").read_text().splitlines()
        assert head.startswith("time [s],")
        assert head.endswith(",t")
        written = np.array([row.rpartition(",")[2] for row in rows], "datetime64[ms]")
        np.testing.assert_array_equal(written, dates - np.timedelta64(1 if offset else 0, "h"))


def test_a_prediction_reads_offsets_and_codes_as_the_config_says(folder, tmp_path):
    path = tmp_path / "plan.csv"
    table = planned(folder, path, (0, 1, 2))
    changed = CONFIG.replace(
        "{ height = 0.01 }", "{ height = [0.01, 0.2] }\nmissing = { valve = -999 }"
    )
    run = stored(folder, "offset", eoi.load("runs/good/result.npz").plant)
    (run / "config.toml").write_text(changed)
    found = answer("predict", run, path, "--output", tmp_path)
    assert found["initial"]["level"] == [pytest.approx(0.01 * table[0, 2] + 0.2)]
    (run / "config.toml").write_text(
        changed.replace("valve = -999", f"height = {table[0, 2]:.17g}")
    )
    refused = called("predict", run, path, "--output", tmp_path)
    assert "nothing for level" in " ".join(refused.output.split())


@pytest.mark.parametrize("newest_first", [False, True])
def test_a_prediction_starts_from_the_first_measured_outputs(folder, tmp_path, newest_first):
    """In the unit of the model: the config's scale is that of centimetres."""
    path = tmp_path / "plan.csv"
    table = planned(folder, path, (0, 1, 2))
    header, *lines = path.read_text().splitlines()
    path.write_text("\n".join([header, *(lines[::-1] if newest_first else lines)]))
    found = answer("predict", "runs/good", path, "--output", tmp_path)
    assert found["initial"]["level"] == [pytest.approx(0.01 * table[0, 2])]
    assert found["notes"] == []


def test_a_free_start_of_an_internal_state_must_be_given(folder, tmp_path):
    planned(folder, tmp_path / "plan.csv")
    plant = eoi.plant_from_text(
        {"level": "store - level + flow", "store": "-c*store"}, {"c": 0.1}, inputs=["flow"],
        outputs=["level"], initial={"level": 0.2, "store": "free"},
    )  # fmt: skip
    stored(folder, "free", plant)
    where = "predict", "runs/free", tmp_path / "plan.csv", "--output", tmp_path, "--initial"
    for word, message in (
        ("level=0.1", "must give store"), ("level=0.1", "put rows with measured outputs before"),
        ("store=1,2", "must be NAME=VALUE"),
    ):  # fmt: skip
        refused = called(*where, word)
        assert refused.exit_code != 0
        assert message in " ".join(refused.output.split())
    assert answer(*where, "store=0.5")["notes"] == ["--initial gives the start of store 0.5"]
    written = np.loadtxt(tmp_path / "free.predict" / "prediction.csv", delimiter=",", skiprows=1)
    time = written[:, 0]
    hold = eoi.load("runs/good/result.npz").records[0].holds
    expected = eoi.simulate(plant, time, written[:, 1], internal=[0.5], hold=hold)
    assert abs(written[10, 2] - expected.outputs[10, 0]) < 0.05


def test_a_prediction_starts_as_the_model_declares_and_notes_say_what_is_assumed(folder, tmp_path):
    planned(folder, tmp_path / "plan.csv")
    plant = eoi.plant_from_text(
        {"level": "rate", "rate": "-rate - level + store + b*flow", "store": "-store"},
        {"b": 2.0, "late": 0.1}, inputs=["flow"], outputs=["level"],
        initial={"level": 0.2, "store": 0.1}, input_delay={"flow": "late"},
    )  # fmt: skip
    stored(folder, "declared", plant)
    found = answer("predict", "runs/declared", tmp_path / "plan.csv", "--output", tmp_path)
    assert found["initial"] == {"level": [0.2, None]}
    assert found["notes"] == [
        "derivatives of level that are not known start at 0",
        "internal states start as the model declares them",
        "before the file, the inputs of delays and lags are taken as at its start",
    ]


def test_a_run_that_diverges_has_no_prediction(folder, tmp_path):
    planned(folder, tmp_path / "plan.csv")
    plant = eoi.load("runs/good/result.npz").plant.with_parameters({"a": -50.0})
    stored(folder, "unstable", plant)
    done = called("predict", "runs/unstable", tmp_path / "plan.csv", "--initial", "level=1",
                  "--output", tmp_path)  # fmt: skip
    assert done.exit_code == 2
    assert "`simulation` must stay finite, got NaN or infinity from t =" in done.stderr
    assert not (tmp_path / "unstable.predict").exists()


@pytest.mark.parametrize(
    ("change", "initial", "message"),
    [
        (("", ""), (), "nothing for level. Add --initial level=VALUE."),
        (("", ""), ("height=1",), "`--initial` must be one of level, got 'height'"),
        (("", ""), ("level=full",), "`--initial` must be NAME=VALUE, or NAME=VALUE,RATE"),
        (("", ""), ("level",), "with numbers, got level. Write level=1.5."),
        (("", ""), ("level=1,2",), "`initial[level]` must be at most 1 value"),
        (("valve", "pump"), ("level=1",), "`inputs` must be a column of"),
        (("t,", "clock,"), ("level=1",), "`time` must be a column of"),
    ],
)
def test_a_plan_that_cannot_be_simulated_says_why(folder, tmp_path, change, initial, message):
    path = tmp_path / "plan.csv"
    planned(folder, path)
    path.write_text(path.read_text().replace(*change, 1))
    options = [word for one in initial for word in ("--initial", one)]
    done = called("predict", "runs/good", path, *options, "--output", tmp_path)
    assert done.exit_code == 2, done.output
    assert message in done.stderr
    assert "Traceback" not in done.output


def test_a_prediction_needs_a_column_of_time_and_leaves_a_controller_out(folder, tmp_path):
    planned(folder, tmp_path / "plan.csv")
    plant = eoi.load("runs/good/result.npz").plant
    config = (stored(folder, "driven", plant) / "config.toml").read_text()
    path = folder / "runs" / "driven" / "config.toml"
    path.write_text(config + CONTROLLER)
    call = ("predict", "runs/driven", tmp_path / "plan.csv", "--initial", "level=1",
            "--output", tmp_path)  # fmt: skip
    assert answer(*call)["notes"][-1].startswith("[controller] is not in the loop")
    path.write_text(config.replace('time = "t"', "sample_period = 0.02"))
    done = called(*call)
    assert done.exit_code == 2, done.output
    assert "`data.time` must be given where a file has no outputs" in done.stderr


def test_a_start_in_another_unit_is_no_start(folder, tmp_path):
    path = tmp_path / "plan.csv"
    planned(folder, path, (0, 1, 2))
    path.write_text(path.read_text().replace("\n", "\ns,,K\n", 1))
    run = stored(folder, "unscaled", eoi.load("runs/good/result.npz").plant)
    (run / "config.toml").write_text(CONFIG.replace("scale = { height = 0.01 }", ""))
    done = called("predict", run, path, "--output", tmp_path)
    assert done.exit_code == 2, done.output
    assert "`FILE[height]` must be in the plant's unit for `level`, 'm', got 'K' in" in done.stderr


def test_a_plan_with_unknown_inputs_is_no_plan(folder, tmp_path):
    path = tmp_path / "plan.csv"
    planned(folder, path)
    lines = path.read_text().splitlines()
    lines[-300:] = [line.split(",")[0] + "," for line in lines[-300:]]
    path.write_text("\n".join(lines))
    done = called("predict", "runs/good", path, "--initial", "level=1", "--output", tmp_path)
    assert done.exit_code == 2, done.output
    assert "`FILE` must have valve at all samples" in done.stderr


def test_a_complete_model_leaves_white_errors_and_a_wrong_one_does_not():
    good, wrong = (
        answer("validate", f"runs/{name}", "new.csv")["correlations"] for name in ("good", "wrong")
    )
    assert [row["input"] for row in good] == [None, "valve"]
    for row in good:
        assert row["share_outside"] < 0.05
        assert abs(row["value"]) < 2 * row["bound"]
    for row in wrong:
        assert not row["inside"]
        assert row["share_outside"] > 0.05
        assert abs(row["value"]) > 1.5 * row["bound"]
    assert wrong[0]["value"] > 0.9
    assert wrong[0]["lag"] == pytest.approx(0.02)  # the first lag, of one sample


def test_several_files_are_records_of_one_validation(folder):
    done = called("validate", "runs/good", "new.csv", "other.csv")
    assert done.exit_code == 0, done.output
    assert "Free run, 2 records" in done.stdout
    assert "Free runs in windows of 4 s, 2 records" in done.stdout
    assert "1 % of the lags are outside by chance" in done.stdout
    rows = [line.split() for line in done.stdout.splitlines() if line.startswith(("new", "other"))]
    assert [row[:3] for row in rows] == [
        [record, "level", other] for record in ("new", "other") for other in
        ("itself", "valve")
    ]  # fmt: skip
    assert (folder / "runs" / "good.validate" / "correlation_2.png").is_file()


def test_models_are_compared_on_the_same_records(folder):
    done = called("compare", "runs/good", "runs/wrong", "new.csv")
    assert done.exit_code == 0, done.output
    rows = [line.split() for line in done.stdout.splitlines()]
    table = {row[0]: float(row[2]) for row in rows if len(row) == 5 and row[1] == "level"}
    found = answer("compare", "runs/good", "runs/wrong", "new.csv")
    fits = [model["validation"]["fit"]["level"] for model in found["models"]]
    assert list(table) == ["good", "wrong"]
    assert found["notes"] == []
    assert list(table.values()) == pytest.approx(fits, abs=0.006)
    assert fits[0] > 98 > 90 > fits[1]
    single = answer("validate", "runs/wrong", "new.csv")["validation"]["fit"]["level"]
    assert fits[1] == single
    files = {path.name for path in (folder / "runs" / "good.compare").iterdir()}
    assert files_beside_run(folder / "runs" / "good.compare") == []
    assert files == {"compare.json", "compare.txt", "compare.png", "correlation.png"}


def test_without_a_file_the_records_are_those_that_the_first_run_held_out():
    found = answer("compare", "runs/good", "runs/wrong")
    assert [record["name"] for record in found["records"]] == ["test"]
    assert found["records"][0]["samples"] == 800
    stored = json.loads(Path("runs/good/result.json").read_text())["validation"]
    assert found["models"][0]["validation"]["fit"] == stored["fit"]
    (note,) = found["notes"]
    assert "the records are those that runs/good held out, with the hold of that run, zero" in note
    assert note in Path("runs/good.compare/compare.txt").read_text()


def test_records_that_the_model_was_fitted_to_are_named(folder, tmp_path):
    lines = (folder / "run.csv").read_text().splitlines()
    part = tmp_path / "part.csv"
    part.write_text("\n".join([lines[0], *lines[101:401]]))
    found = answer("validate", "runs/good", part, "new.csv")
    said = "runs/good was fitted to samples of part: errors there do not say how well it predicts; "
    assert found["notes"] == [said + "judge it on other data"]
    assert "Note: runs/good was fitted" in Path("runs/good.validate/validate.txt").read_text()


def test_runs_of_one_name_are_told_by_their_paths(folder, tmp_path):
    copy = tmp_path / "good"
    copy.mkdir()
    for path in (folder / "runs" / "good").iterdir():
        (copy / path.name).write_bytes(path.read_bytes())
    done = called("compare", "runs/good", copy, "new.csv", "--output", tmp_path)
    assert done.exit_code == 0, done.output
    assert f"\n{tmp_path.name}/good " in done.stdout
    assert "\nruns/good " in done.stdout


PENDULUM = """
name = "simulated"
plant = "pendulum"
[identify]
passes = 2
[simulate]
sample_period = 0.005
duration = 8.0
increments = { a = 5.0 }
[simulate.input.voltage]
kind = "square"
amplitude = 0.2
frequency = 0.25
"""


def test_columns_of_a_simulated_run_are_the_channels_of_its_plant(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("simulated.toml").write_text(PENDULUM)
    done = called("identify", "simulated.toml", "--quiet")
    assert done.exit_code == 0, done.output
    plant = eoi.plants.pendulum()
    plant = plant.with_parameters({"a": plant.parameters["a"] + 5.0})
    time = np.arange(0.0, 8.0, 0.005)
    drive = eoi.excitation.square(time, 0.2, 0.4)
    angle = eoi.simulate(plant, time, drive).outputs[:, 0]
    names = ",".join(("seconds", *plant.inputs, *plant.outputs))
    rows = np.column_stack([time, drive, angle])
    np.savetxt("new.csv", rows, delimiter=",", header=names, comments="")
    found = answer("validate", "runs/simulated", "new.csv")
    assert found["validation"]["fit"][plant.outputs[0]] > 95
    np.savetxt("plan.csv", rows[:, :2], delimiter=",", header="seconds,voltage", comments="")
    call = ("predict", "runs/simulated", "plan.csv", "--initial", f"{plant.outputs[0]}=0.1,-0.2")
    assert answer(*call)["initial"] == {plant.outputs[0]: [0.1, -0.2]}
    (tmp_path / "runs" / "second").mkdir()
    for name in ("result.npz", "config.toml"):
        content = Path(f"runs/simulated/{name}").read_bytes()
        Path(f"runs/second/{name}").write_bytes(content)
    done = called("compare", "runs/simulated", "runs/second")
    assert done.exit_code == 2
    assert "`RUN` must have held-out records where no data file is given" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("validate", "none", "new.csv"), "`run` must be a folder or a file that exists"),
        (("validate", "good", "new.csv"), "a file that exists, got good. Did you mean runs/good?"),
        (("validate", "new.csv", "new.csv"), "`RUN` must be the folder of a run, got new.csv"),
        (("validate", "runs/good", "none.csv"), "`FILE` must be a data file that exists"),
        (("validate", "runs/good", "bad.csv"), "height"),
        (("compare", "runs/good", "new.csv"), "`RUN` must be two folders of runs or more"),
        (("compare", "runs/good", "runs/good"), "`RUN` must be different runs, got runs/good"),
        (("compare", "runs/good", "runs/other"), "`RUN` must have inputs and outputs of runs/good"),
        (("validate", "runs/law", "new.csv"), "whose controller is a function in law.py:law"),
    ],
)
def test_a_wrong_call_says_what_to_do(arguments, message):
    done = called(*arguments)
    assert done.exit_code == 2, done.output
    assert message in done.stderr
    assert "Traceback" not in done.output
