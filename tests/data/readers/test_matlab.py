"""MAT files as MATLAB's users have them: iddata, logs of Simulink, objects, version 7.3."""

import shutil
import struct
import subprocess

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from eoi_jax.data.readers.read_record import read_record, read_table

N = 30
U = np.c_[np.arange(N) % 3, np.arange(N) % 5] * 1.0
Y = np.sin(0.3 * np.arange(N))
IDDATA = {
    "Domain": "Time", "Name": "rig", "OutputData": Y[:, None], "OutputName": "angle",
    "OutputUnit": "rad", "InputData": U, "InputName": np.array(["volt", "load"], dtype=object),
    "InputUnit": np.array(["V", "N m"], dtype=object), "Ts": 0.02, "Tstart": 1.0,
    "SamplingInstants": np.zeros((0, 0)), "TimeUnit": "seconds", "Notes": "none",
}  # fmt: skip


def check_rig(table, prefix=""):
    assert table.time == f"{prefix}time"
    assert table.inputs == (f"{prefix}volt", f"{prefix}load")
    assert table.outputs == (f"{prefix}angle",)
    np.testing.assert_allclose(table.columns[f"{prefix}time"], 1.0 + 0.02 * np.arange(N))
    np.testing.assert_allclose(table.columns[f"{prefix}load"], U[:, 1])
    np.testing.assert_allclose(table.columns[f"{prefix}angle"], Y)
    assert table.units[f"{prefix}load"] == "N m"
    assert table.units[f"{prefix}time"] == "s"


def test_the_fields_of_an_iddata_object_are_its_channels(tmp_path):
    savemat(tmp_path / "top.mat", IDDATA)
    check_rig(read_table(tmp_path / "top.mat"))
    savemat(tmp_path / "nested.mat", {"z": IDDATA})
    check_rig(read_table(tmp_path / "nested.mat"), "z.")
    record = read_record(tmp_path / "nested.mat", "z.time", ["z.volt", "z.load"], "z.angle")
    assert record.sample_period == pytest.approx(0.02)


@pytest.mark.parametrize(("unit", "seconds"), [("seconds", 1.0), ("minutes", 60.0)])
def test_an_iddata_object_needs_no_names_of_columns(tmp_path, unit, seconds):
    savemat(tmp_path / "run.mat", {**IDDATA, "TimeUnit": unit})
    record = read_record(tmp_path / "run.mat")
    assert record.sample_period == pytest.approx(0.02 * seconds)
    assert (record.input_names, record.output_names) == (("volt", "load"), ("angle",))
    assert record.units["load"] == "N m"
    np.testing.assert_allclose(record.outputs[:, 0], Y)
    savemat(tmp_path / "run.mat", {**IDDATA, "TimeUnit": "fortnights"})
    with pytest.raises(ValueError, match=r"`time` must be in a known unit, got fortnights\. Name"):
        read_record(tmp_path / "run.mat")


@pytest.mark.parametrize(
    ("intersample", "hold", "text"),
    [
        ("zoh", "zero", "zero"),
        ("foh", "linear", "linear"),
        (np.array(["bl", "bl"], dtype=object), "smooth", "smooth"),
        (
            np.array(["zoh", "foh"], dtype=object)[:, None],
            ("zero", "linear"),
            "zero for volt, linear for load",
        ),
    ],
    ids=["zoh", "foh", "bl", "of each input"],
)
def test_the_behaviour_between_samples_of_an_iddata_object_is_the_hold(
    tmp_path, intersample, hold, text
):
    savemat(tmp_path / "run.mat", {**IDDATA, "InterSample": intersample})
    record = read_record(tmp_path / "run.mat")
    assert (record.hold, record.hold_declared) == (hold, True)
    note = f"Hold {text}, as the file says. If it is another one, give `hold`."
    assert note in " ".join(record.notes)
    given = read_record(tmp_path / "run.mat", hold="linear")
    assert given.hold == "linear"
    assert "as the file says" not in " ".join(given.notes)
    named = read_record(tmp_path / "run.mat", "time", ["volt", "load"], "angle")
    assert not named.hold_declared


@pytest.mark.parametrize(
    "intersample",
    [None, "later", np.zeros((0, 0)), np.array(["zoh", "later"], dtype=object)],
    ids=["missing", "unknown", "empty", "partly unknown"],
)
def test_an_iddata_object_that_does_not_tell_the_hold_leaves_it_open(tmp_path, intersample):
    said = {} if intersample is None else {"InterSample": intersample}
    savemat(tmp_path / "run.mat", {**IDDATA, **said})
    assert not read_record(tmp_path / "run.mat").hold_declared


def test_uneven_instants_and_nameless_channels_are_taken(tmp_path):
    instants = np.cumsum(np.r_[0.0, np.full(N - 1, 0.1)])
    given = {
        "OutputData": Y[:, None],
        "InputData": U,
        "Ts": np.zeros((0, 0)),
        "SamplingInstants": instants,
    }
    savemat(tmp_path / "a.mat", given)
    table = read_table(tmp_path / "a.mat")
    assert (table.inputs, table.outputs) == (("u1", "u2"), ("y",))
    np.testing.assert_allclose(table.columns["time"], instants)


def test_several_experiments_are_refused_with_the_line_that_parts_them(tmp_path):
    many = np.empty(2, dtype=object)
    many[:] = [Y[:, None], Y[:10, None]]
    savemat(tmp_path / "a.mat", {**IDDATA, "OutputData": many, "InputData": many})
    with pytest.raises(ValueError, match=r"several experiments.*getexp\(data, 1\)"):
        read_table(tmp_path / "a.mat")


def test_a_simulink_log_with_time_is_read_by_its_labels(tmp_path):
    time = 0.1 * np.arange(N)
    signals = [{"values": U[:, [0]], "dimensions": 1, "label": "volt", "blockName": "m/a"},
               {"values": U, "dimensions": 2, "label": "both", "blockName": "m/b"}]  # fmt: skip
    log = {"time": time, "signals": np.array(signals, dtype=object), "blockName": "m/log"}
    savemat(tmp_path / "a.mat", {"simout": log})
    table = read_table(tmp_path / "a.mat")
    assert table.time == "simout.time"
    np.testing.assert_allclose(table.columns["simout.volt"], U[:, 0])
    record = read_record(tmp_path / "a.mat", "simout.time", "simout.volt", "simout.both[1]")
    np.testing.assert_allclose(record.outputs[:, 0], U[:, 1])


def test_a_simulink_log_of_one_signal_without_label_or_time_is_read(tmp_path):
    log = {
        "time": np.zeros((0, 0)),
        "signals": {"values": Y[:, None], "dimensions": 1, "label": ""},
    }
    savemat(tmp_path / "a.mat", {"simout": log})
    table = read_table(tmp_path / "a.mat")
    np.testing.assert_allclose(table.columns["simout.signals.values"], Y)
    assert "has no time: choose the format Structure With Time" in " ".join(table.notes)


def test_a_timeseries_saved_by_its_parts_is_read(tmp_path):
    parts = {"Time": 0.1 * np.arange(N)[:, None], "Data": Y.reshape(1, 1, N), "Name": "angle"}
    savemat(tmp_path / "a.mat", {"ts": parts})
    record = read_record(tmp_path / "a.mat", "ts.Time", (), "ts.Data")
    np.testing.assert_allclose(record.outputs[:, 0], Y)


def test_arrays_of_three_axes_are_left_out_and_said(tmp_path):
    savemat(tmp_path / "a.mat", {"frames": np.zeros((4, 5, N)), "y": Y})
    table = read_table(tmp_path / "a.mat")
    assert list(table.columns) == ["y"]
    assert "`frames` of shape (4, 5, 30) has more than two axes: left out." in table.notes


# -- objects, as MATLAB writes them ------------------------------------------------------------


def element(kind, content):
    padding = -len(content) % 8
    return struct.pack("<II", kind, len(content)) + content + bytes(padding)


def opaque(name, class_name):
    """A MAT file's element of an object (class 17): names, and a reference into a hidden part."""
    flags = element(6, struct.pack("<II", 17, 0))
    texts = b"".join(element(1, text.encode()) for text in (name, "MCOS", class_name))
    numbers = element(5, struct.pack("<ii", 6, 1)) + element(1, b"")
    values = element(6, struct.pack("<6I", 0xDD000000, 2, 1, 1, 1, 1))
    inner = element(14, element(6, struct.pack("<II", 13, 0)) + numbers + values)
    return element(14, flags + texts + inner)


def with_objects(path, objects, **arrays):
    savemat(path, arrays)
    content = path.read_bytes()
    path.write_bytes(content + b"".join(opaque(*one) for one in objects))


@pytest.mark.parametrize(
    ("kind", "line"),
    [
        ("iddata", r"z = get\(data\); save\('run.mat', '-struct', 'z'\)"),
        ("timeseries", r"time = data.Time; data = squeeze\(data.Data\)"),
        ("Simulink.SimulationData.Dataset", r"data\{1\}.Values.Data"),
        ("mine", r"s = struct\(data\)"),
    ],
)
def test_an_object_is_refused_with_the_line_that_saves_what_is_in_it(tmp_path, kind, line):
    path = tmp_path / "a.mat"
    with_objects(path, [("data", kind)])
    with pytest.raises(ValueError, match=f"`data` is an object of MATLAB's class {kind}.*{line}"):
        read_table(path)


def test_an_object_beside_arrays_is_told_where_it_is_asked_for(tmp_path):
    path = tmp_path / "a.mat"
    with_objects(path, [("data", "timeseries")], y=Y)
    table = read_table(path)
    assert list(table.columns) == ["y"]
    assert set(table.objects) == {"data"}
    with pytest.raises(
        ValueError, match=r"`time` must be readable in .*data.Time.*class timeseries"
    ):
        read_record(path, "data.Time", (), "y")


# -- version 7.3 -------------------------------------------------------------------------------


def version_73(path, fill):
    with h5py.File(path, "w", userblock_size=512) as file:
        fill(file)
    with path.open("r+b") as stream:  # the header that such a file starts with
        stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


def text_73(group, key, value):
    data = group.create_dataset(key, data=np.array([[ord(one)] for one in value], dtype=np.uint16))
    data.attrs["MATLAB_class"] = np.bytes_("char")
    return data


def test_an_iddata_structure_of_version_7_3_is_read(tmp_path):
    def fill(file):
        z = file.create_group("z")
        z.attrs["MATLAB_class"] = np.bytes_("struct")
        z["OutputData"], z["InputData"] = Y[None], U.T
        z["Ts"], z["Tstart"] = np.array([[0.02]]), np.array([[1.0]])
        empty = z.create_dataset("SamplingInstants", data=np.zeros(2, dtype=np.uint64))
        empty.attrs["MATLAB_empty"] = np.uint8(1)
        text_73(z, "TimeUnit", "seconds")
        hidden = file.create_group("#refs#")
        for key, words in (("Output", ["angle"]), ("Input", ["volt", "load"])):
            refs = [text_73(hidden, f"{key}{i}", word).ref for i, word in enumerate(words)]
            z.create_dataset(f"{key}Name", data=np.array([refs], dtype=h5py.ref_dtype))
        refs = [text_73(hidden, f"unit{i}", word).ref for i, word in enumerate(["V", "N m"])]
        z.create_dataset("InputUnit", data=np.array([refs], dtype=h5py.ref_dtype))

    version_73(tmp_path / "a.mat", fill)
    check_rig(read_table(tmp_path / "a.mat"), "z.")


def test_an_object_of_version_7_3_is_refused_with_its_class(tmp_path):
    def fill(file):
        file["y"] = Y[None]
        data = file.create_dataset("ts", data=np.zeros((1, 6), dtype=np.uint32))
        data.attrs["MATLAB_class"] = np.bytes_("timeseries")
        data.attrs["MATLAB_object_decode"] = np.int32(3)

    version_73(tmp_path / "a.mat", fill)
    table = read_table(tmp_path / "a.mat")
    assert list(table.columns) == ["y"]
    assert "class timeseries" in table.objects["ts"]


@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
@pytest.mark.parametrize("kind", ["old", "new"])
def test_a_truncated_file_is_named(tmp_path, kind, share):
    path = tmp_path / "a.mat"
    if kind == "old":
        savemat(path, {"y": np.random.default_rng(0).standard_normal(3000)}, do_compression=True)
    else:
        version_73(path, lambda file: file.create_dataset("y", data=np.arange(3000.0)[None]))
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(ValueError, match=r"`path` must be a readable .mat file, got .*a.mat"):
        read_table(path)


def test_what_octave_writes_is_read(tmp_path):
    octave = shutil.which("octave-cli")
    if octave is None:
        pytest.skip("octave is not installed")
    script = (
        "z.OutputData = sin(0.3*(0:29))'; z.InputData = [mod(0:29, 3)' mod(0:29, 5)']; "
        "z.Ts = 0.02; z.Tstart = 1; z.SamplingInstants = []; z.OutputName = {'angle'}; "
        "z.TimeUnit = 'seconds'; "
        "z.InputName = {'volt', 'load'}; z.OutputUnit = {'rad'}; z.InputUnit = {'V', 'N m'}; "
        "save('-v7', 'seven.mat', 'z'); save('-v6', 'six.mat', '-struct', 'z');"
    )
    subprocess.run([octave, "--no-gui", "--quiet", "--eval", script], cwd=tmp_path, check=False,
                   capture_output=True, timeout=60)  # fmt: skip
    check_rig(read_table(tmp_path / "seven.mat"), "z.")
    check_rig(read_table(tmp_path / "six.mat"))
