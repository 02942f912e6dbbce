"""Configs: what they may hold, what a mistake in them says, what they build."""

import re
from pathlib import Path

import msgspec
import numpy as np
import pytest

from eoi_jax import observers
from eoi_jax.cli import build, config
from eoi_jax.data.record import Record

CONFIGS = Path(__file__).resolve().parents[2] / "configs"

SIMULATED = """
name = "run"
plant = "level_tank"

[parameters]
nominal = { alpha = 1.5 }

[observer]
kind = "first_order"
delta = 5.0

[lowpass]
cutoff = 90

[simulate]
sample_period = 0.01
duration = 2.0
increments = { alpha = 0.1, beta = 0.5 }
initial = { level = 0.2 }

[simulate.input.voltage]
kind = "square"
amplitude = 1.0
frequency = 1.0
offset = 4.0
"""

MEASURED = """
name = "run"
plant = "level_tank"

[data]
files = ["one.csv"]
time = "t"
inputs = ["u"]
outputs = ["y"]
scale = { u = 2.0 }

[validation]
files = ["two.csv"]
slice = [0, 20]
"""


def written(folder: Path, text: str, *changes: tuple[str, str]) -> Path:
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "config.toml"
    path.write_text(text)
    return path


def built(path: Path, data: Path | None = None) -> tuple[config.Config, list[Record]]:
    settings = config.load(path)
    model = build.plant(settings, path.parent)
    return settings, build.records(settings, model, path.parent, data)


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_shipped_config_loads_and_builds_its_plant(path: Path):
    settings = config.load(path)
    model = build.plant(settings, path.parent)
    assert settings.name == path.stem
    observer = build.observer(settings)
    if observer is not None:
        assert {observer.relative_degree} == set(model.degrees)
    if settings.simulate is not None:
        assert set(build._truth(settings.simulate, model)) == set(model.names)


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_shipped_config_makes_records_that_move_its_outputs(
    path: Path, request: pytest.FixtureRequest
):
    settings = config.load(path)
    model = build.plant(settings, path.parent)
    if settings.simulate is None:
        data = request.getfixturevalue("data_directory")
        held_out = build.validation_records(settings, model, path.parent, data)
        made = build.records(settings, model, path.parent, data) + held_out
        assert len(made) == 2
    else:
        # Coarse on purpose: all of the experiment, in a fraction of its samples.
        coarse = msgspec.structs.replace(settings.simulate, sample_period=0.005)
        settings = msgspec.structs.replace(settings, simulate=coarse)
        made = build.records(settings, model, path.parent)
    for record in made:
        assert record.outputs.shape[1] == len(model.outputs)
        assert np.all(np.ptp(record.outputs, axis=0) > 30 * record.noise)
        assert record.valid.all()


def test_nominal_bounds_and_fixed_of_the_config_reach_the_plant(tmp_path: Path):
    path = written(
        tmp_path,
        SIMULATED,
        ("nominal = {", 'fixed = ["beta"]\nbounds = { alpha = [0.5, inf] }\nnominal = {'),
    )
    model = build.plant(config.load(path), tmp_path)
    assert model.parameters == {"alpha": 1.5, "beta": 3.0075e-3}
    assert model.fixed == ("beta",)
    assert (model.lower[0], model.upper[0]) == (0.5, np.inf)
    assert model.units["level"] == "m"


@pytest.mark.parametrize(
    ("table", "kind"),
    [
        ('kind = "first_order"\ndelta = 5', observers.FirstOrder),
        ('kind = "second_order"\nc1 = 1\nc2 = 2\nc3 = [3, 4]', observers.SecondOrder),
        ('kind = "super_twisting"\nalpha = 3\nscheme = "explicit"', observers.SuperTwisting),
        ('kind = "high_order"\nbound = 3\ndegree = 2', observers.HighOrder),
    ],
)
def test_each_kind_of_observer_is_built(tmp_path: Path, table: str, kind: type):
    path = written(tmp_path, SIMULATED, ('kind = "first_order"\ndelta = 5.0', table))
    made = build.observer(config.load(path))
    assert type(made) is kind
    assert made.scheme == ("explicit" if "explicit" in table else "implicit")


def test_absent_observer_and_filter_are_left_to_be_chosen(tmp_path: Path):
    settings = config.load(written(tmp_path, MEASURED))
    assert build.observer(settings) is None
    assert build.lowpass(settings) is None


def test_increments_are_added_to_the_nominal_values_and_truth_replaces_them(tmp_path: Path):
    by_increment = config.load(written(tmp_path, SIMULATED))
    old = "increments = { alpha = 0.1, beta = 0.5 }"
    new = "truth = { alpha = 1.6, beta = 0.5030075 }"
    by_truth = config.load(written(tmp_path, SIMULATED, (old, new)))
    model = build.plant(by_truth, tmp_path)
    one, other = (
        build.records(each, model, tmp_path)[0].outputs for each in (by_increment, by_truth)
    )
    np.testing.assert_allclose(one, other, rtol=1e-12)  # 1.5 + 0.1 and 1.6 differ by rounding


def test_simulated_record_starts_where_told_and_follows_its_input(tmp_path: Path):
    _, (record,) = built(written(tmp_path, SIMULATED))
    assert record.outputs[0, 0] == 0.2
    assert record.sample_period == pytest.approx(0.01)
    assert len(record) == 201
    assert set(record.inputs[:, 0]) == {3.0, 5.0}


@pytest.mark.parametrize(
    ("table", "check"),
    [
        ('kind = "prbs"\namplitude = 1\nswitching_period = 0.1\noffset = 4', {3.0, 5.0}),
        ('kind = "steps"\nlevels = [3, 4]\nholding_time = 1', {3.0, 4.0}),
        ('kind = "random_steps"\nlow = 3\nhigh = 5\nholding_time = 0.5', (3.0, 5.0)),
        ('kind = "chirp"\namplitude = 1\nstart = 0.5\nstop = 2\noffset = 4', (3.0, 5.0)),
        (
            'kind = "multisine"\namplitude = 0.1\nfrequencies = [1, 5]\ncomponents = 3\noffset = 4',
            (3.7, 4.3),
        ),
    ],
)
def test_every_kind_of_signal_drives_the_simulation(tmp_path: Path, table: str, check):
    square = 'kind = "square"\namplitude = 1.0\nfrequency = 1.0\noffset = 4.0'
    _, (record,) = built(written(tmp_path, SIMULATED, (square, table)))
    u = record.inputs[:, 0]
    if isinstance(check, set):
        assert set(u) == check
    else:
        assert check[0] <= u.min() < u.max() <= check[1]
        assert len(set(u)) > 3


def test_noise_has_the_stated_deviation_and_follows_its_seed(tmp_path: Path):
    noise = ("initial =", "seed = {}\nnoise = { level = 1e-3 }\ninitial =")

    def outputs(*changes: tuple[str, str]) -> np.ndarray:
        return built(written(tmp_path, SIMULATED, *changes))[1][0].outputs

    clean = outputs()
    one, again, other = (outputs((noise[0], noise[1].replace("{}", seed, 1))) for seed in "112")
    np.testing.assert_array_equal(one, again)
    assert np.all(one != other)
    # 201 draws: their standard deviation is within 5 sigma = 5/sqrt(402) = 25 % of 1e-3.
    assert np.std(one - clean) == pytest.approx(1e-3, rel=0.25)


def test_quantised_outputs_are_multiples_of_the_step_within_half_of_it(tmp_path: Path):
    clean = built(written(tmp_path, SIMULATED))[1][0].outputs
    step = ("initial =", "quantisation = { level = 1e-2 }\ninitial =")
    coarse = built(written(tmp_path, SIMULATED, step))[1][0].outputs
    np.testing.assert_allclose(coarse / 1e-2, np.rint(coarse / 1e-2), atol=1e-9)
    assert np.max(np.abs(coarse - clean)) <= 0.5e-2 * (1 + 1e-9)
    assert len(np.unique(coarse)) < len(np.unique(clean))


def test_smoothing_may_be_a_cutoff_or_switched_off(tmp_path: Path):
    for text, value in (("40", 40.0), ("false", False)):
        path = written(tmp_path, SIMULATED + f"[identify]\nsmoothing = {text}\n")
        assert config.load(path).identify.smoothing == value


def test_instruments_may_be_asked_for_or_left_to_the_noise(tmp_path: Path):
    for text, value in (("instruments = true", True), ("instruments = false", False), ("", None)):
        path = written(tmp_path, SIMULATED + f"[identify]\n{text}\n")
        assert config.load(path).identify.instruments is value


# -- measured files ---------------------------------------------------------------------------


def table_file(path: Path, samples: int = 30) -> None:
    rows = [f"{0.1 * k:.1f},{k % 3},{0.1 + 0.01 * k}" for k in range(samples)]
    path.write_text("\n".join(["t,u,y", *rows]))


def test_validation_takes_what_it_leaves_out_from_data(tmp_path: Path):
    table_file(tmp_path / "one.csv")
    table_file(tmp_path / "two.csv")
    settings, (record,) = built(written(tmp_path, MEASURED))
    model = build.plant(settings, tmp_path)
    (held_out,) = build.validation_records(settings, model, tmp_path)
    assert len(record) == 30
    assert len(held_out) == 20
    np.testing.assert_allclose(held_out.inputs, record.inputs[:20])
    assert record.inputs.max() == 4.0  # scaled by two


def test_data_lie_in_the_given_folder_else_beside_the_config_else_in_that_of_the_variable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    folders = {name: tmp_path / name for name in ("given", "variable", "beside")}
    for length, folder in enumerate(folders.values(), start=10):
        folder.mkdir()
        table_file(folder / "one.csv", length)
    path = written(folders["beside"], MEASURED)
    monkeypatch.setenv("EOI_DATA", str(folders["variable"]))
    assert len(built(path, folders["given"])[1][0]) == 10
    assert len(built(path)[1][0]) == 12
    (folders["beside"] / "one.csv").unlink()
    assert len(built(path)[1][0]) == 11
    with pytest.raises(ValueError, match=r"must be files that exist.*given.*one\.csv\. Give"):
        built(path, tmp_path / "given" / "nowhere")
    (folders["variable"] / "one.csv").unlink()
    with pytest.raises(ValueError, match=r"neither .*beside.*one\.csv nor .*variable.*one\.csv"):
        built(path)
    (folders["variable"] / "ones.csv").write_text("")
    with pytest.raises(ValueError, match=r"Did you mean ones\.csv\? Give their folder by --data"):
        built(path)


PLANT_FILE = """
import eoi_jax.plants as plants

ready = plants.level_tank()
made = plants.level_tank
number = 3

def fails():
    raise RuntimeError("no luck")
"""


@pytest.mark.parametrize("name", ["ready", "made"])
def test_a_plant_may_come_from_a_file_beside_the_config(tmp_path: Path, name: str):
    (tmp_path / "mine.py").write_text(PLANT_FILE)
    path = written(tmp_path, SIMULATED, ('"level_tank"', f'"mine.py:{name}"'))
    assert build.plant(config.load(path), tmp_path).parameters["alpha"] == 1.5


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("absent.py:made", "a file that exists"),
        ("mine.py:number", "a function that returns one"),
        ("mine.py:absent", "a function that returns one"),
        ("mine.py:fails", "RuntimeError: no luck"),
        ("mine.txt:made", "a Python file"),
    ],
)
def test_a_plant_file_that_fails_is_named(tmp_path: Path, reference: str, message: str):
    (tmp_path / "mine.py").write_text(PLANT_FILE)
    (tmp_path / "mine.txt").write_text(PLANT_FILE)
    path = written(tmp_path, SIMULATED, ('"level_tank"', f'"{reference}"'))
    with pytest.raises(ValueError, match=message) as failure:
        build.plant(config.load(path), tmp_path)
    assert "`plant`" in str(failure.value)
    assert not str(failure.value).endswith("..")


# -- mistakes ---------------------------------------------------------------------------------

MISTAKES = [
    (("[observer]", "[obsrver]"), "a key of the config", "`observer`"),
    (("delta", "delte"), "a key of [observer]", "`delta`"),
    (("cutoff", "cut_off"), "a key of [lowpass]", "`cutoff`"),
    (("offset", "ofset"), "a key of [simulate.input.voltage]", "`offset`"),
    (('kind = "first_order"', 'kind = "first"'), "`observer.kind`", "second_order"),
    (('kind = "first_order"', ""), "`observer.kind`", "nothing"),
    (('kind = "first_order"', 'kind = ["first_order"]'), "`observer.kind`", "super_twisting"),
    (("delta = 5.0", "delta = -5.0"), "`observer.delta`", "-5.0"),
    (("delta = 5.0", "delta = 0"), "`observer.delta`", "> 0.0"),
    (("delta = 5.0", "delta = [1, -2]"), "`observer.delta[1]`", "-2"),
    (("delta = 5.0", 'delta = "large"'), "`observer.delta`", "a number or a list of numbers"),
    (("delta = 5.0", ""), "`observer.delta`", "must be given"),
    (("delta = 5.0", 'delta = 5.0\nscheme = "implict"'), "`observer.scheme`", "`implicit`"),
    (("cutoff = 90", "cutoff = nan"), "`lowpass.cutoff`", "nan"),
    (("cutoff = 90", "cutoff = 90\norder = 1.5"), "`lowpass.order`", "a whole number"),
    (("sample_period = 0.01", "sample_period = -0.01"), "`simulate.sample_period`", "-0.01"),
    (("duration = 2.0", "duration = 1e9"), "`simulate.duration`", "sample period"),
    (("duration = 2.0", "duration = inf"), "`simulate.duration`", "inf"),
    (('plant = "level_tank"', 'plant = "levl_tank"'), "`plant`", "`level_tank`"),
    (('plant = "level_tank"', "plant = 3"), "`plant`", "a text"),
    (('name = "run"', 'name = "../run"'), "`name`", "../run"),
    (('name = "run"', 'name = "my run"'), "`name` must be the name of a folder: letters", "my run"),
    (('name = "run"', "name = 3"), "`name` must be a text", "3"),
    (("nominal = { alpha", "nominal = { alfa"), "`parameters.nominal`", "`alpha`"),
    (("nominal = { alpha = 1.5 }", "bounds = { alfa = [0, 1] }"), "`parameters.bounds`", "alpha"),
    (("nominal = { alpha = 1.5 }", "bounds = { alpha = [0] }"), "`parameters.bounds.alpha`", "2"),
    (("nominal = { alpha = 1.5 }", "bounds = { alpha = [2, 3] }"), "`parameters[alpha]`", "[2, 3]"),
    (("nominal = { alpha = 1.5 }", 'fixed = ["alfa"]'), "`fixed`", "`alpha`"),
    (("increments = { alpha", "increments = { alfa"), "`simulate.increments`", "`alpha`"),
    (("increments = { alpha = 0.1, beta = 0.5 }", ""), "`simulate`", "neither"),
    (("increments =", "truth = { alpha = 1 }\nincrements ="), "`simulate`", "both"),
    (("{ level = 0.2 }", "{ levl = 0.2 }"), "`simulate.initial`", "`level`"),
    (("{ level = 0.2 }", "{ level = [0.2, 1] }"), "`simulate.initial.level`", "at most 1"),
    (("initial = {", "noise = { levl = 1 }\ninitial = {"), "`simulate.noise`", "`level`"),
    (("initial = {", "noise = { level = -1 }\ninitial = {"), "`simulate.noise.level`", "-1"),
    (("simulate.input.voltage", "simulate.input.volt"), "`simulate.input`", "voltage"),
    (("frequency = 1.0", "frequency = 0"), "`simulate.input.voltage.frequency`", "0"),
    (("offset = 4.0", "duty = 1.5"), "[simulate.input.voltage]", "`duty`"),
    (("[parameters]\nnominal = { alpha = 1.5 }", "parameters = 3"), "`parameters`", "a table"),
    (("[lowpass]\ncutoff = 90", "[identify]\nsmoothing = true"), "`identify.smoothing`", "false"),
    (("[lowpass]\ncutoff = 90", "[identify]\npasses = 0"), "`identify.passes`", ">= 1"),
    (("[lowpass]\ncutoff = 90", "[identify]\ntransient = -1"), "`identify.transient`", ">= 0"),
]


@pytest.mark.parametrize(("change", "field", "rule"), MISTAKES, ids=[m[0][1] for m in MISTAKES])
def test_a_mistake_is_named_with_its_rule(
    tmp_path: Path, change: tuple[str, str], field: str, rule: str
):
    path = written(tmp_path, SIMULATED, change)
    with pytest.raises(ValueError, match="must") as failure:
        built(path)
    assert field in str(failure.value)
    assert rule in str(failure.value)


@pytest.mark.parametrize(
    ("change", "field", "rule"),
    [
        (("files", "file"), "a key of [data]", "`files`"),
        (('inputs = ["u"]', 'inputs = ["u", "v"]'), "`data.inputs`", "1 column,"),
        (('outputs = ["y"]', "outputs = []"), "`data.outputs`", "none"),
        (("scale = { u = 2.0 }", "scale = { u = 'two' }"), "`data.scale.u`", "a number"),
        (("slice = [0, 20]", "slice = [0]"), "`validation.slice`", "length 2"),
        (("slice = [0, 20]", "hold = 'none'"), "`validation.hold`", "zero, linear"),
        (("slice = [0, 20]", "hold = { u = 'auto' }"), "`validation.hold.u`", "zero, linear"),
        (("scale = { u = 2.0 }", "hold = { v = 'zero' }"), "`hold`", "got 'v'"),
        (("scale = { u = 2.0 }", "hold = {}"), "`hold`", "nothing for u"),
    ],
)
def test_a_mistake_about_files_is_named_with_its_rule(
    tmp_path: Path, change: tuple[str, str], field: str, rule: str
):
    table_file(tmp_path / "one.csv")
    with pytest.raises(ValueError, match="must") as failure:
        built(written(tmp_path, MEASURED, change))
    assert field in str(failure.value)
    assert rule in str(failure.value)


@pytest.mark.parametrize(
    ("declared", "inputs", "derivative"), [('inputs = ["u"]', ("u",), "u - a*y"), ("", (), "-a*y")]
)
def test_columns_are_by_default_those_that_are_called_as_the_channels(
    tmp_path: Path, declared: str, inputs: tuple[str, ...], derivative: str
):
    table_file(tmp_path / "one.csv")
    model = f'[model]\noutputs = ["y"]\n{declared}\nparameters = {{ a = 1.0 }}\n'
    model += f'derivatives = {{ y = "{derivative}" }}\n'
    data = '[data]\nfiles = ["one.csv"]\ntime = "t"\n'
    _, (record,) = built(written(tmp_path, f'name = "run"\n{model}{data}'))
    assert (record.input_names, record.output_names) == (inputs, ("y",))


def test_a_config_gives_each_input_its_hold(tmp_path: Path):
    table_file(tmp_path / "one.csv")
    change = "scale = { u = 2.0 }", 'scale = { u = 2.0 }\nhold = { u = "smooth" }'
    settings, (record,) = built(written(tmp_path, MEASURED, change))
    assert (record.hold, record.hold_declared) == ("smooth", True)
    assert settings.validation is not None
    assert settings.validation.hold == {"u": "smooth"}  # as [data] says


def test_a_config_has_simulated_or_measured_records_but_not_both(tmp_path: Path):
    data = '[data]\nfiles = ["one.csv"]\ninputs = ["u"]\noutputs = ["y"]\n'
    both = written(tmp_path, SIMULATED + data)
    with pytest.raises(ValueError, match=r"exactly one of .* got both"):
        config.load(both)
    with pytest.raises(ValueError, match=r"exactly one of .* got none"):
        config.load(written(tmp_path, 'name = "run"\nplant = "level_tank"\n'))


def test_a_config_that_is_missing_or_no_toml_is_named(tmp_path: Path):
    with pytest.raises(ValueError, match=r"must be a file that exists, got .*absent\.toml"):
        config.load(tmp_path / "absent.toml")
    with pytest.raises(ValueError, match="must be a TOML file"):
        config.load(written(tmp_path, "name = run"))
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="must be a TOML file"):
        config.load(tmp_path / "binary.toml")


@pytest.mark.parametrize(
    ("line", "advice"),
    [
        ("parameters = { κ = 1.0 }", 'in quotes: "κ" = 1.0'),
        ('files = ["C:\\Users\\run.csv"]', "with /, or in single quotes"),
        ("parameters = { a: 1.0 }", "a = 1.0, not a: 1.0"),
        ("strict = True  # as in Python", "Write true"),
        ("time = seconds", 'Text stands in quotes: "seconds"'),
        ("parameters = { a = 1,5, b = 2 }", "decimal point"),
        ("parameters = {\n  a = 1.5,\n}", "A table of its own"),
    ],
)
def test_what_other_languages_allow_is_named_with_its_line(tmp_path: Path, line, advice):
    path = written(tmp_path, f'name = "run"\n{line}\n')
    with pytest.raises(ValueError, match=re.escape(advice)) as caught:
        config.load(path)
    assert f"The line: {line.splitlines()[0]}" in str(caught.value)


def test_what_is_given_in_the_place_of_a_config_is_answered_with_what_to_give(tmp_path: Path):
    (tmp_path / "my run.csv").write_text("t,u,y\n0,1,2\n")
    (tmp_path / "rig").mkdir()
    (tmp_path / "rig" / "config.toml").write_text("")
    (tmp_path / "motor.toml").write_text("")
    for name, advice in (
        ("my run.csv", r"Data need a config: `eoi init '.*my run\.csv'` drafts one"),
        ("rig", r"Its folder has one: .*rig.config\.toml"),
        ("motr.toml", r"Did you mean .*motor\.toml\?"),
    ):
        with pytest.raises(ValueError, match=rf"`config` must be a .* got .*{name}\. {advice}"):
            config.load(tmp_path / name)


@pytest.mark.parametrize(
    ("table", "place"),
    [
        ("[sweep]\ncutoffs = {low = 1.0, high = inf, count = 5}", "sweep.cutoffs.high"),
        ("[sweep]\ncutoffs = [1.0, inf]", r"sweep.cutoffs\[1\]"),
        (
            "[[sweep.observers]]\nkind = 'first_order'\n[sweep.observers.gains]\ndelta.high = inf",
            r"sweep.observers\[0\].gains.delta.high",
        ),
        ("[lowpass]\ncutoff = nan", "lowpass.cutoff"),
    ],
)
def test_only_bounds_may_be_infinite(tmp_path, table, place):
    path = tmp_path / "run.toml"
    path.write_text(f'name = "x"\nplant = "pendulum"\n{table}\n')
    with pytest.raises(ValueError, match=rf"`{place}` must be a finite number, got (inf|nan)"):
        config.load(path)
