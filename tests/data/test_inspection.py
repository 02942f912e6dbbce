"""What is seen in a file before anything is configured, and the config that is drafted for it."""

import json
import re
import warnings

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

import eoi_jax as eoi
from eoi_jax._checks import RecordWarning
from eoi_jax.cli import actions, build, config
from eoi_jax.cli.template import checked, draft
from eoi_jax.data.column_names import role_of_name, short_names, stem, unit_of_name
from eoi_jax.data.inspection import Inspection, _band, inspect
from eoi_jax.data.time_axis import daylight_saving

N = 600
H = 0.01
DRAW = np.random.default_rng(0)
T = H * np.arange(N)
U = DRAW.uniform(-3, 3, N // 30)[np.arange(N) // 30]
NOISE = 1e-3


def response():
    state, rows = np.zeros(2), []
    step = np.linalg.inv(np.eye(2) - H * np.array([[0.0, 1.0], [-30.0, -2.0]]))
    for drive in U:
        rows.append(state[0])
        state = step @ (state + H * np.array([0.0, 15.0 * drive]))
    return np.array(rows)


CLEAN = response()
Y = CLEAN + NOISE * DRAW.standard_normal(N)


def written(path, **columns):
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def roles(found):
    return {one.name: one.role for one in found.channels}


def channel(found, name):
    return next(one for one in found.channels if one.name == name)


# -- time ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "stamps", "factor"),
    [
        ("t", T, 1.0),
        ("time [ms]", 1e3 * T, 1e-3),
        ("tempo_ms", np.rint(1e3 * T).astype(int), 1e-3),
        ("t_us", np.rint(1e6 * T).astype(int), 1e-6),
        ("stamp", np.rint(1e6 * T).astype(int), 1e-6),
        ("timestamp", 1.7e9 + T, 1.0),
        ("timestamp", np.rint(1.7e12 + 1e3 * T).astype(int), 1e-3),
        ("timestamp", np.rint(1.7e15 + 1e6 * T).astype(int), 1e-6),
        ("date", 45413.25 + T / 86400.0, 86400.0),
        ("abscissa", T, 1.0),
    ],
)
def test_time_and_its_unit_are_found(tmp_path, name, stamps, factor):
    found = inspect(written(tmp_path / "run.csv", u=U, **{name: stamps}, y=Y))
    assert found.clock.column == name
    assert found.clock.factor == factor
    # A spreadsheet's days have a resolution of a microsecond, and epochs of a fifth of one.
    assert found.clock.sample_period == pytest.approx(H, rel=1e-3)


@pytest.mark.parametrize("minutes", [1, 15, 60])
def test_whole_minutes_are_minutes_and_neither_ms_nor_µs(tmp_path, minutes):
    stamps = 60 * minutes * np.arange(N)
    found = inspect(written(tmp_path / "run.csv", t=stamps, u=U, y=Y))
    assert found.clock.factor == 1.0
    assert f"{minutes} minutes apart are taken as seconds" in found.clock.why


def test_dates_are_time_before_a_number_that_grows(tmp_path):
    stamps = pd.Timestamp("2024-05-01") + pd.to_timedelta(T, unit="s")
    found = inspect(written(tmp_path / "run.csv", count=np.arange(N), when=stamps, y=Y))
    assert found.clock.column == "when"
    assert found.clock.sample_period == pytest.approx(H)


def test_a_row_number_is_time_only_where_nothing_else_is(tmp_path):
    both = inspect(written(tmp_path / "run.csv", index=np.arange(N), t=T, y=Y))
    assert both.clock.column == "t"
    assert both.clock.others == ("index",)
    assert roles(both)["index"] == "other"
    alone = inspect(written(tmp_path / "run.csv", index=np.arange(N), y=Y))
    assert alone.clock.column == "index"
    assert "counts by ones" in alone.clock.why


def test_jitter_gaps_repeats_and_steps_back_are_counted(tmp_path):
    stamps = T + 1e-3 * DRAW.uniform(-1, 1, N)
    stamps[300:] += 0.5
    found = inspect(written(tmp_path / "run.csv", t=stamps, u=U, y=Y))
    assert found.clock.gaps[0] == 1
    assert found.clock.gaps[1] == pytest.approx(0.51, abs=3e-3)
    # The difference of two uniform deviations of ±0.1 periods: sqrt(2/3)·0.1.
    assert found.clock.jitter == pytest.approx(np.sqrt(2 / 3) * 0.1, rel=0.2)
    assert any("resampled" in line for line in found.advice)
    stamps = T.copy()
    stamps[400:] -= 2.0
    stamps[100] = stamps[99]
    found = inspect(written(tmp_path / "run.csv", time=stamps, u=U, y=Y))
    assert found.clock.backwards == (1, 400)
    assert found.clock.repeated == 1
    assert any("goes back 1 time, first at row 400" in line for line in found.advice)
    assert channel(found, "y").noise is not None  # all else is told all the same


def test_a_file_without_time_may_say_its_sample_period(tmp_path):
    savemat(tmp_path / "run.mat", {"u": U, "y": Y, "Ts": 0.01})
    found = inspect(tmp_path / "run.mat")
    assert (found.clock.column, found.clock.sample_period) == (None, 0.01)
    savemat(tmp_path / "run.mat", {"u": U, "y": Y, "fs": 200.0})
    assert inspect(tmp_path / "run.mat").clock.sample_period == pytest.approx(0.005)
    assert "\nsample_period = 0.005" in draft(
        [inspect(tmp_path / "run.mat")], tmp_path / "run.toml"
    )
    found = inspect(written(tmp_path / "run.csv", u=U, y=Y))
    assert found.clock.sample_period is None
    assert "give sample_period" in found.advice[0]


# -- channels -----------------------------------------------------------------------------


def test_noise_steps_saturation_and_band_are_those_of_the_signal(tmp_path):
    t = H * np.arange(4000)
    sine = np.sin(2 * np.pi * 2.0 * t)
    rounded = 0.05 * np.round(sine / 0.05)
    clipped = np.clip(sine + 0.01 * DRAW.standard_normal(4000), -2.0, 0.8)
    noisy = sine + NOISE * DRAW.standard_normal(4000)
    found = inspect(written(tmp_path / "a.csv", t=t, noisy=noisy, rounded=rounded, clipped=clipped))
    assert channel(found, "noisy").noise == pytest.approx(NOISE, rel=0.1)
    assert channel(found, "rounded").quantum == pytest.approx(0.05)
    assert channel(found, "noisy").band == pytest.approx(2.0, rel=0.05)
    ((level, share),) = channel(found, "clipped").saturated
    assert level == pytest.approx(0.8)
    assert share == pytest.approx(np.arccos(0.8) / np.pi, abs=0.02)  # of a sine above 0.8
    assert any("saturated at 0.8" in line for line in found.advice)


@pytest.mark.parametrize(
    ("columns", "inputs", "outputs"),
    [
        ({"u": U, "y": Y}, ("u",), ("y",)),
        ({"motorVoltage": U, "shaft_angle": Y}, ("motorVoltage",), ("shaft_angle",)),
        ({"a": U, "b": Y}, ("a",), ("b",)),  # by how they move: one jumps, one does not
        ({"b": Y, "a": U}, ("a",), ("b",)),
        ({"reference": U, "pwm": U + 0.1 * Y, "angle": Y}, ("pwm",), ("angle",)),
        ({"V1": U, "V2": Y}, ("V1",), ("V2",)),
        ({"V2": U, "V1": Y}, ("V2",), ("V1",)),  # an input that is not held is the output
        ({"Pump (l/min)": U, "Level %": Y}, ("Pump (l/min)",), ("Level %",)),
    ],
)
def test_inputs_and_outputs_are_guessed_and_the_guess_has_a_reason(
    tmp_path, columns, inputs, outputs
):
    found = inspect(written(tmp_path / "run.csv", t=T, **columns))
    assert (found.inputs, found.outputs) == (inputs, outputs)
    assert all(channel(found, name).why for name in (*inputs, *outputs))


def test_numbers_with_thousands_separators_are_told_to_be_text(tmp_path):
    rows = "\n".join(
        f"{t:.2f};{u:.2f};{1e5 + 1e3 * y:,.2f}" for t, u, y in zip(T, U, Y, strict=True)
    )
    (tmp_path / "run.csv").write_text(f"t;u;y\n{rows}\n")
    found = inspect(tmp_path / "run.csv")
    why = rf"such as '{1e5 + 1e3 * Y[0]:,.2f}': write numbers without thousands separators"
    assert channel(found, "y").why == why
    assert (
        f"No column looks like an output, numbers that change. Text, no numbers: `y`, {why}."
        in (found.advice)
    )


def test_a_name_has_no_path_and_no_unit():
    names = ("log.motorVoltage_2 [V]", "group/angle", "Pump (l/min)", "Pump l/min", "Temp. 1")
    assert [stem(name) for name in names] == [
        *("motorVoltage_2", "angle", "Pump", "Pump l/min", "Temp. 1"),
    ]


@pytest.mark.parametrize(
    ("names", "short"),
    [
        (["log.y [rad]", "log.u"], ["y", "u"]),
        (["TIC101.PV", "YC101.OUT", "FI101.PV"], ["TIC101.PV", "YC101.OUT", "FI101.PV"]),
        (["unit1/TIC101.PV", "unit1/Q [kW]"], ["TIC101.PV", "Q"]),
        (["left.angle", "right.angle"], ["left.angle", "right.angle"]),
        (["pv"], ["pv"]),
    ],
)
def test_short_names_tell_columns_apart(names, short):
    assert short_names(names) == short


@pytest.mark.parametrize(
    ("columns", "references"),
    [
        ({"reference": U, "pwm": U + 0.1 * Y, "angle": Y}, ("reference",)),
        ({"pwm": U + 0.1 * Y, "Tsoll": U, "angle": Y}, ("Tsoll",)),
        ({"setpoint": U, "angle": Y}, ()),  # the only input
        ({"u": U, "y": Y}, ()),
    ],
)
def test_a_reference_stands_beside_an_input(tmp_path, columns, references):
    assert inspect(written(tmp_path / "run.csv", t=T, **columns)).references == references


def test_what_is_no_signal_is_told_apart(tmp_path):
    words = np.where(np.arange(N) % 2, "left", "right")
    gappy = np.where(np.arange(N) % 10 == 3, np.nan, Y)
    columns = {"t": T, "u": U, "y": gappy, "still": 4.0, "word": words, "empty": np.nan}
    found = inspect(written(tmp_path / "run.csv", **columns))
    assert roles(found)["still"] == roles(found)["empty"] == "constant"
    assert roles(found)["word"] == "text"
    assert "'right'" in channel(found, "word").why
    assert channel(found, "y").missing == N // 10
    assert found.advice[-1] == "Empty or not finite: `y` 60; such samples are masked."


def test_what_an_iddata_structure_says_is_believed(tmp_path):
    given = {"OutputData": U[:, None], "InputData": Y[:, None], "Ts": H, "OutputName": "strange",
             "InputName": "smooth"}  # fmt: skip
    savemat(tmp_path / "run.mat", {"z": given, "frames": np.zeros((3, 4, 5)), "scalar": 3.0})
    found = inspect(tmp_path / "run.mat")
    assert (found.inputs, found.outputs) == (("z.smooth",), ("z.strange",))
    assert found.clock.column == "z.time"
    assert any("scalar" in line for line in found.left_out)


@pytest.mark.parametrize("size", [1e-6, 0.1, 1e4])
def test_a_signal_that_jumps_is_an_input_in_whatever_unit(tmp_path, size):
    found = inspect(written(tmp_path / "run.csv", t=T, p=size * U, q=size * CLEAN))
    assert roles(found) == {"t": "time", "p": "input", "q": "output"}


def test_an_inspection_prints_plots_and_is_json(tmp_path):
    found = inspect(written(tmp_path / "run.csv", t=T, u=U, y=Y, more=np.cos(T)))
    assert isinstance(found, Inspection)
    text = str(found)
    for part in ("600 rows, 4 columns", "every 0.01 s", "u input", "y output", "noise"):
        assert part in text
    told = json.loads(json.dumps(found.summary(), allow_nan=False))
    assert told["clock"]["column"] == "t"
    figure = found.plot()
    assert len(figure.axes) == 2 * 4  # three signals and the stamps, each with a second panel
    left = [axes.get_ylabel() for axes in figure.axes[::2]]
    assert left == ["y", "more", "u", "step / median"]
    assert all(len(axes.lines) >= 1 for axes in figure.axes[::2])
    assert figure.axes[-1].get_ylabel() == "count"
    assert figure.axes[4].get_xlabel() == "time [s]"
    assert figure.axes[5].get_xlabel().startswith("frequency [Hz]")
    untimed = inspect(written(tmp_path / "untimed.csv", u=U, y=Y)).plot()
    assert [axes.get_xlabel().split("\n")[0] for axes in untimed.axes[2:]] == [
        "sample",
        "frequency [1/sample]",
    ]
    assert eoi.inspect is inspect


@pytest.mark.parametrize("between", ["empty", "repeated"])
def test_the_spectrum_of_a_slow_column_has_no_comb(tmp_path, between):
    """Means or old values in the rows between would be lines at the multiples of 10 Hz."""
    count = 4000
    time, y = H * np.arange(count), 5.0 + np.sin(0.5 * H * np.arange(count))
    y += 1e-2 * DRAW.standard_normal(count)
    slow = np.where(np.arange(count) % 10 == 0, y, np.nan)
    slow = slow if between == "empty" else np.repeat(y[::10], 10)
    figure = inspect(written(tmp_path / "run.csv", t=time, speed=slow)).plot()
    frequency, amplitude = figure.axes[1].lines[0].get_data()
    lines = amplitude[(frequency > 9.0) & (frequency < 11.0)]
    assert np.max(lines) < 1e-3 * np.max(amplitude)


@pytest.mark.parametrize(
    "name", ["time", "time [ms]", "log.time_ms", "rig/run.time (s)", "t_s", "rig.log.t", "a/b/Time"]
)
def test_a_clock_is_known_by_its_name_without_unit_and_path(tmp_path, name):
    """It restarts once, which only a column that is called so may do."""
    stamps = np.concatenate([T[: N // 2], T[: N // 2]])
    found = inspect(written(tmp_path / "run.csv", **{"u.time.of_flight": U, name: stamps, "y": Y}))
    assert found.clock.column == name
    assert "its name says so" in found.clock.why
    assert found.clock.backwards == (1, N // 2)


@pytest.mark.parametrize(
    ("step", "name", "seconds"),
    [(3, "temp", 1.0), (10, "T_degC", 1.0), (1000, "temp", 1e-3), (3, "speed", 1e-3),
     (1000, "speed", 1e-6)],
)  # fmt: skip
def test_whole_numbers_beside_a_temperature_are_no_fast_clock(tmp_path, step, name, seconds):
    """Nobody logs an oven every 3 ms. A motor that gets warm is one with a speed."""
    columns = {"time": step * np.arange(N), "u": U, name: Y}
    assert inspect(written(tmp_path / "run.csv", **columns)).clock.factor == seconds
    columns |= {"speed": Y, "motor_temp": Y}
    also = inspect(written(tmp_path / "more.csv", **columns))
    assert also.clock.factor == (1e-3 if step < 1000 else 1e-6)


def test_what_stops_at_a_limit_beside_an_output_drives_it(tmp_path):
    """A pump cannot suck. What moves as smoothly without a limit may answer as well."""
    command = 5.0 + 10.0 * np.sin(0.05 * np.arange(N))
    flow = np.maximum(command, 0.0)
    level = np.cumsum(flow)
    limited = inspect(written(tmp_path / "run.csv", t=T, flow=flow, level=level))
    assert (limited.inputs, limited.outputs) == (("flow",), ("level",))
    assert "stops at 0" in next(at.why for at in limited.channels if at.name == "flow")
    assert not any("looks like an input" in line for line in limited.advice)
    free = inspect(written(tmp_path / "free.csv", t=T, flow=command, level=level))
    assert (free.inputs, free.outputs) == ((), ("flow", "level"))
    unnamed = inspect(written(tmp_path / "unnamed.csv", t=T, flow=flow, gas=level))
    assert unnamed.inputs == ()


def test_a_file_without_a_clock_has_none_in_json_either(tmp_path):
    found = inspect(written(tmp_path / "run.csv", u=U, y=Y))
    clock = found.summary()["clock"]
    assert clock.pop("why") == "no column increases from row to row"
    none = {"column": None, "factor": 1.0, "gaps": [0, 0.0], "repeated": 0, "backwards": [0, None]}
    absent = dict.fromkeys(("sample_period", "duration", "spacing", "jitter"))
    assert json.loads(json.dumps(clock)) == {**none, **absent, "others": [], "scattered": False}


def test_a_wide_file_is_told_in_short(tmp_path):
    wide = {f"c{i:04}": np.cos(0.01 * (i + 1) * np.arange(50)) for i in range(100)}
    found = inspect(written(tmp_path / "run.csv", t=T[:50], **wide))
    assert len(found.channels) == 101
    assert "and 61 more columns: --json lists all" in str(found)
    assert len(found.plot().axes) == 2 * 7


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,u,y\n0,1,2\n", "must hold at least 8 rows of numbers, got 1"),
        ("word\n" + "left\n" * 20, "must hold a column of numbers"),
        ("", "it holds no data"),
    ],
)
def test_a_file_without_a_record_is_named(tmp_path, text, message):
    (tmp_path / "run.csv").write_text(text)
    with pytest.raises(ValueError, match=f"`path` .*{message}"):
        inspect(tmp_path / "run.csv")


# -- the draft ----------------------------------------------------------------------------


def drafted(path, target):
    text = checked(draft([inspect(path)], target), target)
    target.write_text(text, encoding="utf-8")
    settings = config.load(target)
    model = build.plant(settings, target.parent)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordWarning)
        (record,) = build.records(settings, model, target.parent)
        (held,) = build.validation_records(settings, model, target.parent)
    return text, record, held


def table(separator=",", comma=False, names=("t", "u", "y"), stamps=T, extra=""):
    rows = [
        f"{t}{separator}{u:.4f}{separator}{y:.6f}{extra}"
        for t, u, y in zip(stamps, U, Y, strict=True)
    ]
    body = "\n".join(rows)
    head = separator.join(names) + "\n" if names else ""
    return head + (body.replace(".", ",") if comma else body) + "\n"


DATES = pd.date_range("2024-05-30 23:59:58", periods=N, freq="10ms")
FILES = {
    "decimal commas": (table(";", comma=True), "utf-8"),
    "byte-order mark": (table(), "utf-8-sig"),
    "tabs": (table("\t"), "utf-8"),
    "units row": ("t,u,y\ns,V,rad\n" + table(names=()), "utf-8"),
    "no header": (table(names=()), "utf-8"),
    "dates": (table(";", stamps=np.asarray(DATES.strftime("%d.%m.%Y %H:%M:%S.%f"))), "utf-8"),
    "microseconds": (table(stamps=np.rint(1e6 * T).astype(int), names=("t_us", "u", "y")), "utf-8"),
    "words": (table(names=("t", "u", "y", "state"), extra=",on"), "utf-8"),
    "quotes in names": (table(names=('"t"', '"u ""fine"""', "y\u2028x")), "utf-8"),
    "hostile names": (table(names=("t", "u]\\", "y = 1 # '''")), "utf-8"),
}


@pytest.mark.parametrize("case", FILES)
def test_the_draft_reads_every_sample_of_the_file(tmp_path, case, monkeypatch):
    monkeypatch.delenv(build.DATA_VARIABLE, raising=False)
    text, encoding = FILES[case]
    (tmp_path / "run.csv").write_bytes(text.encode(encoding))
    _, record, held = drafted(tmp_path / "run.csv", tmp_path / "run.toml")
    assert len(record) + len(held) == N
    assert record.sample_period == pytest.approx(H, rel=1e-6)
    np.testing.assert_allclose(record.outputs[:, 0], np.round(Y, 6)[: len(record)], atol=1e-12)
    np.testing.assert_allclose(held.inputs[:, 0], np.round(U, 4)[len(record) :], atol=1e-12)


def test_the_draft_starts_near_the_truth(tmp_path, monkeypatch):
    monkeypatch.delenv(build.DATA_VARIABLE, raising=False)
    written(tmp_path / "run.csv", t=T, u=U, y=Y)
    drafted(tmp_path / "run.csv", tmp_path / "run.toml")
    settings = config.load(tmp_path / "run.toml")
    values = sorted(abs(one) for one in build.plant(settings, tmp_path).parameters.values())
    # y'' = -30 y - 2 y' + 15 u, but for the half-step of the discrete twin.
    assert values[-1] == pytest.approx(30.0, rel=0.3)
    assert values[-2] == pytest.approx(15.0, rel=0.3)


def test_the_drafted_model_has_the_units_of_its_columns(tmp_path):
    file = tmp_path / "run.csv"
    file.write_text(FILES["units row"][0], encoding="utf-8")
    target = tmp_path / "run.toml"
    target.write_text(checked(draft([inspect(file)], target), target), encoding="utf-8")
    plant = build.plant(config.load(target), tmp_path)
    assert plant.units["y"] == "rad"
    assert plant.units["u"] == "V"


def test_the_draft_says_every_guess_and_the_alternatives(tmp_path, monkeypatch):
    monkeypatch.delenv(build.DATA_VARIABLE, raising=False)
    written(tmp_path / "run.csv", t=T, u=U, y=Y, angle=CLEAN, count=np.arange(N))
    text, _, _ = drafted(tmp_path / "run.csv", tmp_path / "run.toml")
    for part in (
        "# other columns: angle",
        "# other candidates: count",
        "u: input, its name says so",
    ):
        assert part in text
    assert re.search(r"Everything in it is a guess", text)


def test_what_a_name_says_to_be_an_output_goes_before_what_only_moves(tmp_path):
    """A tilt that was measured, and drives the ball: no name says what it is."""
    written(tmp_path / "run.csv", t=T, tilt=np.cumsum(U) / N, position=Y)
    text, _, _ = drafted(tmp_path / "run.csv", tmp_path / "run.toml")
    assert 'outputs = ["position"]' in text
    assert "# other columns: tilt; one that drives the output is an input" in text


def test_a_file_elsewhere_is_named_by_its_whole_path_and_one_in_the_data_folder_is_not(
    tmp_path, monkeypatch
):
    data, here = tmp_path / "data", tmp_path / "here"
    data.mkdir()
    here.mkdir()
    file = written(data / "run.csv", t=T, u=U, y=Y)
    monkeypatch.delenv(build.DATA_VARIABLE, raising=False)
    text, _, _ = drafted(file, here / "run.toml")
    assert json.dumps(file.resolve().as_posix()) in text
    monkeypatch.setenv(build.DATA_VARIABLE, str(data))
    text, _, _ = drafted(file, here / "run.toml")
    assert 'files = ["run.csv"]' in text


@pytest.mark.parametrize("constant", [-2.0, 2.0])
def test_a_first_order_record_is_drafted_as_one(tmp_path, constant):
    """y' = -4 y + 3 u + c between the samples, u held."""
    y, decay = np.zeros(N), np.exp(-4.0 * H)
    for i in range(N - 1):
        y[i + 1] = decay * y[i] + (1.0 - decay) / 4.0 * (3.0 * U[i] + constant)
    file = written(tmp_path / "run.csv", t=T, u=U, y=y)
    text = draft([inspect(file)], tmp_path / "run.toml")
    assert 'y = "-decay*y + gain*u + offset"' in text
    found = re.search(r"^decay = ([0-9.]+)", text, re.MULTILINE)
    assert found
    assert float(found[1]) == pytest.approx(4.0, rel=0.1)


def test_a_file_without_an_output_gets_no_draft(tmp_path):
    file = written(tmp_path / "run.csv", t=T, still=np.ones(N))
    with pytest.raises(ValueError, match="`path` must have a column that can be an output"):
        draft([inspect(file)], tmp_path / "run.toml")
    assert [path.name for path in tmp_path.iterdir()] == ["run.csv"]


@pytest.mark.parametrize(
    "name", ["Y-101 Ventil [%]", "YV 203A Stellgrad", "Mischer Ventilstellung", "FV-12 valve"]
)
def test_a_valve_is_an_input_whatever_letter_its_tag_has(name):
    assert role_of_name(name) == "input"
    assert role_of_name("Y-101") == "output"


def test_symbols_of_the_drafted_model_are_the_last_part_of_column_names(tmp_path):
    """As tables of several devices name them: device, signal, unit."""
    written(tmp_path / "run.csv", **{"rig.time [s]": T, "drive.force [N]": U, "arm/angle (rad)": Y})
    drafted(tmp_path / "run.csv", tmp_path / "run.toml")
    plant = build.plant(config.load(tmp_path / "run.toml"), tmp_path)
    assert (plant.inputs, plant.outputs) == (("force",), ("angle",))


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_the_band_does_not_depend_on_the_unit(unit):
    time = 0.01 * np.arange(2000)
    band = _band(unit * (np.sin(2.0 * np.pi * time) + 5.0), 0.01)
    assert band == pytest.approx(1.0, abs=0.15)
    assert _band(np.full(100, unit), 0.01) is None


# -- what users name, and what names say --------------------------------------------------


@pytest.mark.parametrize(
    "name", ["T_soll", "speed_cmd", "angle ref", "posSetpoint", "level_target", "desired_speed",
             "consigne_temp", "Tsoll", "velocidad_consigna"],
)  # fmt: skip
def test_what_a_controller_sends_or_is_to_reach_is_an_input(tmp_path, name):
    file = written(tmp_path / "run.csv", t=T, **{"speed": Y, name: U})
    assert roles(inspect(file)) == {"t": "time", name: "input", "speed": "output"}


@pytest.mark.parametrize(
    "name",
    [
        "outdoor temp [°C]",
        "T_amb",
        "wind speed",
        "feed_flow",
        "sun",
        "Außentemperatur",
        "Globalstrahlung [W/m²]",
        "T_außen",
    ],
)
def test_what_surrounds_a_plant_is_an_input(tmp_path, name):
    """It moves as smoothly as what it moves."""
    columns = {"t": T, name: np.sin(2.0 * T), "temp": np.cumsum(np.sin(2.0 * T)), "u": U}
    found = inspect(written(tmp_path / "run.csv", **columns))
    assert (found.inputs, found.outputs) == ((name, "u"), ("temp",))


def test_of_signals_that_all_jump_the_output_is_one_that_is_called_no_input(tmp_path):
    jumping = np.where(np.arange(N) % 40 < 20, T, 5.0 - T)
    columns = {"t": T, "room": jumping, "outdoor": np.sin(2.0 * T), "sun": np.cos(T), "heater": U}
    found = inspect(written(tmp_path / "run.csv", **columns))
    assert found.outputs == ("room",)
    assert "alone is not called an input" in channel(found, "room").why


@pytest.mark.parametrize(
    ("name", "seconds"), [("minute", 60.0), ("hour", 3600.0), ("week", 604800.0)]
)
def test_a_clock_in_the_singular_counts_in_its_unit(tmp_path, name, seconds):
    columns = {name: 3 * np.arange(N), "u": U, "y": Y}
    clock = inspect(written(tmp_path / "run.csv", **columns)).clock
    assert (clock.column, clock.factor) == (name, seconds)


def test_levels_that_somebody_set_are_no_coarse_sensor(tmp_path):
    """Neither name tells; small set points differ by many steps of their values."""
    levels = np.cumsum(np.where(np.arange(20) % 2, 1.3, -0.7))
    held = 20.0 + np.round(0.1 * levels, 2)[np.arange(N) // 30]
    coarse = np.round(Y / np.ptp(Y) * 12.0)  # thirteen levels, one after another
    found = inspect(written(tmp_path / "run.csv", t=T, a=held, b=coarse))
    assert channel(found, "a").role == "input"
    assert channel(found, "b").role != "input"


@pytest.mark.parametrize(("name", "order"), [("room temperature", 1), ("angle", 2)])
def test_a_temperature_has_no_inertia(tmp_path, name, order):
    file = written(tmp_path / "run.csv", t=T, u=U, **{name: Y})
    text = draft([inspect(file)], tmp_path / "run.toml")
    assert ("stiffness = " in text) == (order == 2)
    assert ("decay = " in text) == (order == 1)


def test_roles_that_the_caller_knows_are_taken(tmp_path):
    file = written(tmp_path / "run.csv", t=T, n=np.arange(N), u=U, y=Y, z=Y**2)
    found = inspect(file, time="n", inputs=["y"], outputs=["z"])
    assert roles(found) == {"t": "other", "n": "time", "u": "other", "y": "input", "z": "output"}
    assert inspect(file, inputs=[]).inputs == ()
    with pytest.raises(ValueError, match="`outputs` must be one of t, n, u, y, z, got 'w'"):
        inspect(file, outputs=["w"])
    with pytest.raises(ValueError, match="without another role, got y, also input"):
        inspect(file, inputs=["y"], outputs=["y"])


def test_of_several_files_the_last_is_held_out(tmp_path):
    files = [written(tmp_path / name, t=T, u=U, y=Y) for name in ("a.csv", "b.csv", "c.csv")]
    target = tmp_path / "run.toml"
    target.write_text(checked(draft([inspect(file) for file in files], target), target))
    read = config.load(target)
    assert read.data is not None
    assert read.validation is not None
    assert (read.data.files, read.validation.files) == (("a.csv", "b.csv"), ("c.csv",))
    assert read.data.slice is None
    other = written(tmp_path / "d.csv", t=T, v=U, y=Y)
    with pytest.raises(ValueError, match=r"`file` must have the column `u`, as a\.csv has"):
        draft([inspect(files[0]), inspect(other)], target)


def test_a_note_on_resampling_is_given_once_whatever_cells_are_empty(tmp_path):
    t = T + 0.2 * T[1] * np.random.default_rng(0).random(N)
    file = written(
        tmp_path / "run.csv", t=t, u=U, y=Y, z=np.where(np.arange(N) < N // 9, np.nan, Y)
    )
    advice = [line for line in inspect(file).advice if "resampled from" in line]
    assert len(advice) == 1
    assert "masked" not in advice[0]


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("voltage_V", "V"), ("temp_degC", "°C"), ("speed rad/s", "rad/s"), ("I_A", "A"),
        ("T_K", "K"), ("omega_rad_s", "rad/s"), ("T_innen_K", "K"), ("motorCurrent_mA", "mA"),
        ("pwm_percent", "%"), ("speed_rpm", "rpm"), ("angle_deg", "deg"), ("accel_m_s2", "m/s²"),
        ("rate_rad_per_s", "rad/s"), ("level_m", "m"), ("supply_volts", "V"), ("druck_bar", "bar"),
        ("imu_ax_mps2", "m/s²"), ("gps_speed_mps", "m/s"), ("gyro_x_dps", "deg/s"),
        ("Heizleistung_kW", "kW"), ("sog_knots", "kn"), ("wind_speed_kt", "kn"),
        # ambiguous, or no unit: a motor A, a measured x, radiation, a gain, a phase, a number
        ("motor_A", ""), ("x_m", ""), ("solar_rad", ""), ("gain_K", ""), ("phase_V", ""),
        ("samples_N", ""), ("temp_sensor_C", ""), ("V", ""), ("rpm", ""), ("time_s", ""),
        ("speed [m/s]", ""), ("u", ""), ("", ""), ("_V", ""), ("pump_in", ""), ("y_min", ""),
        ("motor_kt", ""),
    ],
)  # fmt: skip
def test_units_at_the_ends_of_names_are_read_where_they_mean_nothing_else(name, unit):
    assert unit_of_name(name) == unit


def test_an_inspection_says_which_units_are_the_ends_of_names(tmp_path):
    t = 0.01 * np.arange(200)
    path = tmp_path / "run.csv"
    table = np.column_stack([t, np.sign(np.sin(5 * t)), 20 + np.sin(3 * t), np.cos(t)])
    header = "t,heater_voltage_V,temp_degC,motor_A"
    np.savetxt(path, table, delimiter=",", header=header, comments="")
    inspection = inspect(path)
    assert [channel.unit for channel in inspection.channels] == ["", "V", "°C", ""]
    said = "Units from the ends of the names: V of `heater_voltage_V`, °C of `temp_degC`; nothing"
    assert said in str(inspection)


def test_a_column_of_text_beside_an_output_is_named(tmp_path):
    path = tmp_path / "run.csv"
    rows = [f"{0.01 * k:.2f},{k // 50 % 2},{np.sin(0.1 * k):.4f},#{k}" for k in range(200)]
    path.write_text("\n".join(["t,pwm,current,counts", *rows]))
    assert "`counts` is left out: text such as '#0'." in inspect(path).advice


@pytest.mark.parametrize(
    ("day", "minutes", "said"),
    [
        ("2024-10-26", 60, "The dates have an hour twice at row 27, counted from 0, as with day"),
        ("2024-10-26", 15, "The dates have an hour twice at row 108, counted from 0, as with day"),
        ("2024-03-30", 60, "The dates leave out an hour at row 26, counted from 0, as with day"),
        ("2024-06-01", 60, None),
    ],
)
def test_dates_that_are_put_forward_or_back_by_an_hour_are_told(tmp_path, day, minutes, said):
    days = pd.date_range(day, periods=3 * 24 * 60 // minutes, freq=f"{minutes}min", tz="UTC")
    first = days - pd.Timedelta(hours=1 if "03" in day else 2)  # from midnight, local time
    local = first.tz_convert("Europe/Berlin").strftime("%Y-%m-%d %H:%M")
    rows = [f"{stamp},{k // 12 % 2},{np.sin(0.1 * k):.4f}" for k, stamp in enumerate(local)]
    path = tmp_path / "run.csv"
    path.write_text("\n".join(["date,heating,room", *rows]))
    hints = [line for line in inspect(path).advice if "daylight" in line]
    assert [hint[: len(said or "")] for hint in hints] == ([said] if said else [])


@pytest.mark.parametrize(
    ("first", "minutes"),
    [
        ("2025-03-12 08:15", [0, 30, 180, 190, 280, 290, 350, 380, 390, 510, 610, 660]),
        ("2025-03-30 00:15", [0, 30, 60, 90, 180, 210, 300, 420]),  # by hand, in such a night
        ("2025-05-11 23:00", [*range(0, 300, 15), *range(345, 600, 15)]),  # in no such night
        ("2025-03-30 12:00", [*range(0, 300, 15), *range(345, 600, 15)]),  # by day
    ],
)
def test_an_hour_that_no_clock_leaves_out_is_not_told(first, minutes):
    dates = np.datetime64(first) + np.asarray(minutes).astype("timedelta64[m]")
    assert not daylight_saving(dates)


def test_an_hour_left_out_in_spring_is_told():
    night = np.datetime64("2025-03-30T00:00") + np.arange(0, 600, 15).astype("timedelta64[m]")
    local = np.where(
        night >= np.datetime64("2025-03-30T02:00"), night + np.timedelta64(1, "h"), night
    )
    (sentence,) = daylight_saving(local)
    assert "leave out an hour at row 8" in sentence
    assert not daylight_saving(night)


def test_samples_by_hand_have_no_period_and_no_gaps(tmp_path):
    time = np.array([0, 0.25, 0.5, 0.75, 1, 1.5, 2, 3, 4, 6, 8, 10, 12, 16, 24])
    columns = {"time [h]": time, "u": np.arange(15) % 3, "y": np.exp(-0.2 * time)}
    found = inspect(written(tmp_path / "run.csv", **columns))
    text = str(found)
    assert "  no usual spacing, for 86400 s" in text
    assert "on a grid of 900 s" in text
    assert not any(word in text for word in ("  every", "jitter", "gap", "sample faster"))
    assert (found.clock.scattered, found.clock.gaps) == (True, (0, 0.0))


@pytest.mark.parametrize("names", [("rate [mg/h]", "conc [mg/L]"), ("infusion rate", "drug")])
def test_a_rate_that_is_on_and_off_is_an_input_beside_what_decays(tmp_path, names):
    time = np.array([0, 1, 1.5, 2, 3, 4, 6, 8, 12, 12.5, 13, 14, 16, 20, 24, 24.5, 25, 26, 28, 36])
    on = np.isin(time, [0, 12, 24, 24.5])
    since = np.array([np.min((at - [0, 12, 24])[at >= np.array([0, 12, 24])]) for at in time])
    columns = {"time [h]": time, names[0]: 100.0 * on, names[1]: 7 * since * np.exp(-since)}
    found = inspect(written(tmp_path / "run.csv", **columns))
    assert (found.inputs, found.outputs) == (names[:1], names[1:])


def test_a_rate_that_is_measured_is_an_output(tmp_path):
    turned = np.sin(0.05 * np.arange(N)) * (np.arange(N) > 0.6 * N)
    found = inspect(written(tmp_path / "run.csv", t=np.arange(N), u=np.sign(turned), rate=turned))
    assert found.outputs == ("rate",)


@pytest.mark.parametrize("kind", ["events", "even entries", "even rows"])
def test_what_is_logged_when_it_changes_is_judged_by_its_entries(tmp_path, kind):
    """A laboratory has entries at even distances, or rows of its own between those of a clock."""
    random = np.random.default_rng(0)
    step = 1.0 if kind == "even rows" else random.integers(1, 5, N)
    time = np.cumsum(step * np.ones(N))
    gaps = np.full(N, 20) if kind == "even entries" else random.integers(5, 36, N)
    entries = np.cumsum(gaps)[np.cumsum(gaps) < N]
    valve = np.full(N, np.nan)
    valve[entries] = 50.0 + 20.0 * np.resize([-1, 1, 0.5], len(entries))
    path = written(tmp_path / "run.csv", t=time, a=valve, temperature=np.sin(0.003 * time))
    found = {channel.name: channel for channel in inspect(path).channels}["a"]
    assert (found.role == "input") == (kind == "events")
    if kind == "events":
        expected = "it has entries where it changes, and jumps by 100 % of its range from an entry"
        assert found.why.startswith(expected)
        assert found.noise is None
        (note,) = (note for note in found.notes if "values in" in note)
        assert "unknown in between. Where an input is logged only when it changes" in note
        assert not any("free runs" in note for note in found.notes)


def test_an_input_in_rows_of_its_own_is_no_output_with_a_rate(tmp_path):
    """Of an input that the caller names nothing is said of scores; the draft guesses its hold."""
    valve, answer = np.repeat(np.resize([1.0, 4.0, 2.0], N // 20 + 1), 20)[:N], np.sin(0.003 * T)
    own = np.arange(N) % 5 < 3
    signals = {"a": np.where(own, valve, np.nan), "b": np.where(own, np.nan, answer)}
    path = written(tmp_path / "run.csv", t=T, **signals)
    found = inspect(path, inputs=["a"], outputs=["b"])
    assert not any("`a`" in line and "free runs" in line for line in found.advice)
    assert any("`a` has" in line and "declare its `hold`" in line for line in found.advice)
    actions.init([path], tmp_path / "run.toml", False, inputs=["a"], outputs=["b"])
    assert '\nhold = { "a" = "zero" }\n' in (tmp_path / "run.toml").read_text()


def test_rows_of_an_hour_that_came_twice_are_not_to_be_sorted(tmp_path):
    days = pd.date_range("2024-10-26", periods=288, freq="15min", tz="UTC")
    local = days.tz_convert("Europe/Berlin").strftime("%Y-%m-%d %H:%M")
    rows = [f"{stamp},{k // 12 % 2},{np.sin(0.1 * k):.4f}" for k, stamp in enumerate(local)]
    path = tmp_path / "run.csv"
    path.write_text("\n".join(["date,heating,room", *rows]))
    (hint,) = [line for line in inspect(path).advice if line.startswith("Time goes back")]
    assert "sort" not in hint
    assert "counted from 0. `parts` of [data] in a config reads the parts as records" in hint
    again = [rows[0], *rows[1:100], *rows[30:60]]
    path.write_text("\n".join(["date,heating,room", *again]))
    assert any("else sort the rows" in line for line in inspect(path).advice)


@pytest.mark.parametrize("dates", [False, True])
def test_a_file_with_the_newest_row_first_has_a_clock(tmp_path, dates):
    stamps = pd.date_range("2024-05-01", periods=N, freq="10ms") if dates else T
    table = {"t": stamps[::-1], "u": U[::-1], "y": Y[::-1]}
    found = inspect(written(tmp_path / "run.csv", **table))
    assert (found.clock.column, found.clock.sample_period) == ("t", pytest.approx(H))
    assert roles(found) == {"t": "time", "u": "input", "y": "output"}
    assert any("newest sample first" in note for note in found.notes)


def test_a_number_of_the_run_is_no_input(tmp_path):
    number = np.arange(N) // 200 + 1
    columns = {"run": number, "t": H * (np.arange(N) % 200), "u": U, "y": Y}
    found = inspect(written(tmp_path / "run.csv", **columns))
    assert found.inputs == ("u",)
    assert roles(found)["run"] == "other"
    # Beside a clock that goes on it is a signal like others.
    found = inspect(written(tmp_path / "run.csv", **{**columns, "t": T}))
    assert "run" in found.inputs


def test_short_experiments_below_each_other_are_records_of_their_own(tmp_path):
    """As tables of subjects: 30 of twelve samples each, at hours of their own choice."""
    hours = np.array([0, 0.25, 0.5, 1, 1.5, 2, 3, 4, 6, 8, 12, 24])
    count = 30
    columns = {
        "ID": np.repeat(np.arange(count), 12),
        "TIME": np.tile(hours, count),
        "DV": np.exp(-np.tile(hours, count)) + 0.01 * DRAW.standard_normal(12 * count),
    }
    found = inspect(written(tmp_path / "run.csv", **columns))
    assert roles(found) == {"ID": "other", "TIME": "time", "DV": "output"}
    assert found.parts == tuple((12 * i, 12 * i + 12) for i in range(count))


@pytest.mark.parametrize(
    ("step", "total"),
    [
        ("Time", "Total Time"),  # Neware, h:mm:ss
        ("Step_Time(s)", "Test_Time(s)"),  # Arbin, in numbers
        ("Step (Sec)", "Test (Sec)"),  # Maccor
    ],
)
def test_a_total_time_is_the_clock_before_the_time_of_a_step(tmp_path, step, total):
    """A cycler counts the records from one on, and one of its times from each step on."""
    seconds = np.arange(N)
    columns = {"Record": seconds + 1, step: seconds % 60, total: seconds, "u": U, "y": Y}
    if step == "Time":
        for name in (step, total):
            columns[name] = [f"00:{k // 60:02d}:{k % 60:02d}" for k in columns[name]]
    found = inspect(written(tmp_path / "run.csv", **columns))
    assert found.clock.column == total
    assert found.clock.backwards == (0, None)
    assert found.parts == ((0, N),)
    assert (roles(found)[step], found.inputs, found.outputs) == ("other", ("u",), ("y",))
    assert (f"unlike `{step}`, it never goes back" in found.clock.why) == (step == "Time")


def test_rows_that_are_not_sorted_are_no_restarts(tmp_path):
    late = np.arange(N, dtype=float)
    late[10::15] -= 3.0  # forty of them, beside the one before
    found = inspect(written(tmp_path / "run.csv", t=late * H, u=U, y=Y))
    assert found.parts == ((0, N),)


def test_the_only_column_is_the_output(tmp_path):
    level = np.exp(-T)
    level[300:] += 1.0  # it jumps as an input does
    found = inspect(written(tmp_path / "run.csv", t=T, level=level))
    assert found.outputs == ("level",)


@pytest.mark.parametrize(
    ("name", "outputs"),
    [("voltage", ("voltage",)), ("Force [N]", ("Force [N]",)), ("i_current", ("i_current",)),
     ("pwm", ()), ("u", ()), ("voltage_cmd", ())],
)  # fmt: skip
def test_the_only_signal_is_the_output_unless_it_is_sent(tmp_path, name, outputs):
    """A capacitor that empties has a voltage and no input."""
    found = inspect(written(tmp_path / "run.csv", **{"t": T, name: np.exp(-T)}))
    assert found.outputs == outputs


@pytest.mark.parametrize(
    ("stamps", "factor"),
    [((2, 4, 6, 8, 10, 12, 16, 22, 32, 62, 92, 122), 1.0), (range(0, 240, 20), 1e-3)],
)
def test_whole_numbers_without_a_usual_spacing_are_no_milliseconds(tmp_path, stamps, factor):
    """A logger ticks; blood is taken more often at first."""
    time = np.array(stamps, dtype=float)
    found = inspect(written(tmp_path / "run.csv", time=time, y=np.exp(-0.02 * time)))
    assert found.clock.factor == factor


@pytest.mark.parametrize("name", ["speed", "voltage", "a"])
def test_a_signal_that_rises_throughout_is_no_second_clock(tmp_path, name):
    found = inspect(written(tmp_path / "run.csv", **{"t": T, name: 1.0 - np.exp(-T)}))
    assert found.outputs == (name,)
    assert found.clock.others == ()


@pytest.mark.parametrize("name", ["millis", "b"])
def test_a_second_clock_is_no_signal(tmp_path, name):
    rows = {"time": T, name: np.rint(1000.0 * T), "y": np.exp(-T)}
    found = inspect(written(tmp_path / "run.csv", **rows))
    assert found.clock.others == (name,)
    assert found.outputs == ("y",)


@pytest.mark.parametrize(
    ("name", "role"),
    [("vout_V", "output"), ("Vin", "input"), ("qout", "output"), ("uin", "input"),
     ("imu_ax_mps2", "output"), ("gyro_z", "output")],
)  # fmt: skip
def test_what_goes_in_and_comes_out_is_told_by_the_name(name, role):
    assert role_of_name(name) == role


def test_a_draft_of_a_short_record_holds_nothing_out(tmp_path):
    time = 0.5 * np.arange(20)
    path, target = tmp_path / "run.csv", tmp_path / "run.toml"
    written(path, t=time, y=np.exp(-time))
    target.write_text(checked(draft([inspect(path)], target), target))
    loaded = config.load(target)
    assert loaded.validation is None
    plant = build.plant(loaded, tmp_path)
    assert len(build.records(loaded, plant, tmp_path)[0]) == 20


def test_a_draft_offers_the_hold_of_inputs_that_keep_their_values(tmp_path):
    t = 0.1 * np.arange(400)
    heating, outdoor = np.sign(np.sin(t)), np.cos(0.3 * t) + 0.01 * np.sin(40.0 * t)
    room = np.cumsum(heating + outdoor) * 0.1
    path, target = tmp_path / "run.csv", tmp_path / "run.toml"
    table = np.column_stack([t, heating, outdoor, room])
    np.savetxt(path, table, delimiter=",", header="t,heating,outdoor,room", comments="")
    found = inspect(path, inputs=["heating", "outdoor"], outputs=["room"])
    text = draft([found], target)
    offered = '# hold = { "heating" = "zero" }'
    assert offered in text
    target.write_text(checked(text.replace(offered, offered[2:]), target))
    data = config.load(target).data
    assert data is not None
    assert data.hold == {"heating": "zero"}


@pytest.mark.parametrize("name", ["speed.quality", "speed Status", "quality", "speed_flag"])
def test_what_rates_the_samples_of_a_column_is_no_input(tmp_path, name):
    rating = np.where((T > 2.0) & (T < 2.5), 0.0, 1.0)
    found = inspect(written(tmp_path / "run.csv", t=T, u=U, **{"speed": Y, name: rating}))
    assert (found.inputs, found.outputs) == (("u",), ("speed",))
    assert f"`{name}` is no signal: it rates the samples" in " ".join(found.advice)


def test_codes_of_quality_are_known_by_their_value_and_a_status_may_be_an_input(tmp_path):
    for good, inputs in ((192.0, ("u",)), (1.0, ("u", "pump status"))):
        status = np.where((T > 2.0) & (T < 2.5), 0.0, good)
        columns = {"t": T, "u": U, "speed": Y, "pump status": status}
        assert inspect(written(tmp_path / "run.csv", **columns)).inputs == inputs


def lines_of_a_logger():
    return [f"{10 * k},{k % 7},{np.sin(0.05 * k):.4f}" for k in range(200)]


def test_a_word_in_a_line_of_numbers_is_told_with_its_line(tmp_path):
    lines = ["t_ms,u,y", *lines_of_a_logger()]
    lines[60] = "Encoder overflow!,,"
    (tmp_path / "run.csv").write_text("\n".join(lines))
    advice = " ".join(inspect(tmp_path / "run.csv").advice)
    said = "`t_ms` holds numbers but for 'Encoder overflow!' in line 61: where it stands for no"
    assert said in advice
    assert "sample_period" not in advice


def test_a_line_with_too_many_cells_is_told_with_its_number(tmp_path):
    lines = ["t_ms,u,y", *lines_of_a_logger()]
    lines[60] += lines[61]
    (tmp_path / "run.csv").write_text("\n".join(lines))
    with pytest.raises(ValueError, match="line 61 has 5 cells, the lines before it 3; where two"):
        inspect(tmp_path / "run.csv")


def test_an_input_of_text_is_told_with_an_example(tmp_path):
    lines = [f"{k} PWM=70 {np.sin(0.05 * k):.4f}" for k in range(200)]
    (tmp_path / "run.txt").write_text("\n".join(lines))
    message = "`inputs` must be columns of numbers, got `1` with 'PWM=70'. Choose from 0, 2, or"
    with pytest.raises(ValueError, match=message):
        inspect(tmp_path / "run.txt", inputs=["1"], outputs=["2"])


def test_the_period_of_coarse_stamps_is_that_of_their_record(tmp_path):
    t = np.round(np.arange(2000) / 25_600, 5)  # their median spacing is 40 µs
    found = inspect(written(tmp_path / "a.csv", t=t, y=np.sin(300.0 * t)))
    assert found.clock.sample_period == pytest.approx(1 / 25_600, rel=1e-5)
    assert "(25600 Hz)" in str(found)
