import gzip
import re
import warnings

import h5py
import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from eoi_jax._checks import RecordWarning
from eoi_jax.data.readers.read_record import read_record
from eoi_jax.estimation.identify import Identification, identify
from eoi_jax.models.check_records import check_records, unit_notes
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.refine import refine
from eoi_jax.simulation.validate import validate

N = 50
T = 0.01 * np.arange(N)
U = np.arange(N) % 7
Y = np.c_[np.sin(T), np.cos(T)]


def write_csv(path, separator=",", decimal="."):
    frame = pd.DataFrame({"t": T, "u": U, "y": Y[:, 0]})
    frame.to_csv(path, sep=separator, decimal=decimal, index=False)
    return path


def read(path, **options):
    return read_record(path, "t", "u", ["y"], **options)


# -- kinds of files -----------------------------------------------------------------------


def write_mat(path):
    savemat(path, {"t": T[None], "u": U.astype("uint8")[:, None], "y": Y[:, :1]})


def write_npz(path):
    np.savez(path, t=T, u=U.astype("int16"), y=Y[None, :, 0])


def write_hdf5(path):
    with h5py.File(path, "w") as file:
        file["t"], file["u"], file["y"] = T, U, Y[:, 0]


def write_parquet(path):
    pd.DataFrame({"t": T, "u": U, "y": Y[:, 0]}).to_parquet(path)


def write_spaces(path):
    np.savetxt(path, np.c_[T, U, Y[:, 0]], header="t u y", comments="% ")


def write_gzip(path):
    with gzip.open(path, "wt") as stream:
        pd.DataFrame({"t": T, "u": U, "y": Y[:, 0]}).to_csv(stream, index=False)


@pytest.mark.parametrize(
    ("file", "write"),
    [
        ("run.csv", write_csv),
        ("run.tsv", lambda path: write_csv(path, "\t")),
        ("run.mpt", lambda path: write_csv(path, "\t")),
        ("run.dat", lambda path: write_csv(path, ";", ",")),
        ("run.csv.gz", write_gzip),
        ("run.txt", write_spaces),
        ("run.parquet", write_parquet),
        ("run.mat", write_mat),
        ("run.h5", write_hdf5),
        ("run.HDF5", write_hdf5),
        ("run.npz", write_npz),
    ],
)
def test_every_kind_of_file_gives_the_same_record(tmp_path, file, write):
    write(tmp_path / file)
    record = read(tmp_path / file)
    assert record.name == "run"
    assert (record.input_names, record.output_names) == (("u",), ("y",))
    np.testing.assert_allclose(record.time, T, atol=1e-12)
    np.testing.assert_array_equal(record.inputs[:, 0], U)
    np.testing.assert_allclose(record.outputs[:, 0], Y[:, 0], rtol=1e-12)


def test_the_mat_format_7_3_is_read_through_hdf5(tmp_path):
    path = tmp_path / "new.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["t"], file["y"], file["group/u"] = T[None], Y.T, U
    with path.open("r+b") as stream:  # the header that such a file starts with
        stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    record = read_record(path, "t", "group/u", ["y[0]", "y[1]"])
    np.testing.assert_allclose(record.outputs, Y)


def test_structures_and_columns_of_matrices_are_reached_by_name(tmp_path):
    path = tmp_path / "run.mat"
    savemat(path, {"data": {"t": T, "both": Y, "wide": Y.T, "note": "a rig"}})
    record = read_record(path, "data.t", "data.both[1]", "data.wide[0]")
    np.testing.assert_allclose(record.inputs[:, 0], Y[:, 1])
    np.testing.assert_allclose(record.outputs[:, 0], Y[:, 0])


def test_headers_with_spaces_quotes_marks_and_trailing_commas_are_read(tmp_path):
    path = tmp_path / "run.csv"
    rows = "\n".join(f"{t:.2f}, {u}, {y:.6f}," for t, u, y in zip(T, U, Y[:, 0], strict=True))
    path.write_text('\ufeff"t" , "u", y,\n' + rows + "\n", encoding="utf-8")
    np.testing.assert_allclose(read(path).outputs[:, 0], Y[:, 0], atol=1e-6)
    path.write_text("t,u,y\n" + rows + "\n")
    np.testing.assert_allclose(read(path).outputs[:, 0], Y[:, 0], atol=1e-6)


def test_a_table_without_a_header_has_numbered_columns(tmp_path):
    path = tmp_path / "run.txt"
    np.savetxt(path, np.c_[T, U, Y])
    record = read_record(path, "0", "1", ["2", "3"])
    np.testing.assert_allclose(record.outputs, Y)
    same = read_record(path, 0, 1, [2, 3], scale={1: 2.0}, renames={2: "left"})
    np.testing.assert_allclose(same.outputs, Y)
    np.testing.assert_allclose(same.inputs[:, 0], 2.0 * U)
    assert (same.input_names, same.output_names) == (("1",), ("left", "3"))
    np.savetxt(path, np.c_[T, U, Y], header="y1 y2", comments="# ")  # names two of four
    np.testing.assert_allclose(read_record(path, "0", "1", ["2", "3"]).outputs, Y)


# -- options ------------------------------------------------------------------------------


def test_without_stamps_the_sample_period_is_taken(tmp_path):
    path = write_csv(tmp_path / "run.csv")
    record = read_record(path, inputs="u", outputs="y", sample_period=4)
    assert record.sample_period == 4.0
    assert len(record) == N


def test_scales_units_renames_and_slices_apply(tmp_path):
    path = write_csv(tmp_path / "run.csv")
    record = read(
        path,
        name="again",
        scale={"t": 1e-3, "u": 35.15},
        units={"t": "s", "u": "N", "y": "m"},
        renames={"u": "force"},
        slice=(10, 40),
        hold="zero",
        burn_in=0.01,
    )
    assert (record.name, record.hold, record.burn_in) == ("again", "zero", 0.01)
    assert record.units == {"time": "s", "force": "N", "y": "m"}
    assert record.sample_period == pytest.approx(1e-5)
    np.testing.assert_allclose(record.inputs[:, 0], 35.15 * U[10:40])
    np.testing.assert_allclose(record.time[0], 1e-4)
    assert len(read(path, slice=(10, None))) == N - 10


def test_a_file_without_inputs_is_a_free_system(tmp_path):
    record = read_record(write_csv(tmp_path / "run.csv"), "t", outputs=["y"])
    assert record.inputs.shape == (N, 0)


def test_empty_cells_are_masked_and_said(tmp_path):
    path = tmp_path / "run.csv"
    frame = pd.DataFrame({"t": T, "u": U.astype(object), "y": Y[:, 0]})
    frame.loc[7, "u"] = None
    frame.to_csv(path, index=False)
    with pytest.warns(RecordWarning, match="1 of 50 samples is not finite"):
        assert not read(path).valid[7]


def test_stamps_of_a_parquet_file_may_be_datetimes(tmp_path):
    stamps = pd.date_range("2024-05-01", periods=N, freq="10ms")
    pd.DataFrame({"t": stamps, "u": U, "y": Y[:, 0]}).to_parquet(tmp_path / "run.parquet")
    np.testing.assert_allclose(read(tmp_path / "run.parquet").time, T, atol=1e-9)


# -- errors -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("column", "unit"), [("t [ms]", "ms"), ("time_ms", "ms"), ("us", "us"), ("clock (min)", "min")]
)
def test_stamps_in_another_unit_of_time_need_a_scale(tmp_path, column, unit):
    rows = "\n".join(f"{10 * k},{np.sin(k):.6f},{np.cos(k):.6f}" for k in range(50))
    (tmp_path / "run.csv").write_text(f"{column},u,y\n{rows}\n")
    names = {"time": column, "inputs": "u", "outputs": "y"}
    with pytest.raises(ValueError, match=rf"must be in seconds, got a column in {unit}\. Give `sc"):
        read_record(tmp_path / "run.csv", **names)
    assert read_record(tmp_path / "run.csv", **names, scale={column: 1}).sample_period == 10.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"time": "T"}, "`time` must be a column of .*run.csv .present: t, u, y.*, got `T`"),
        ({"inputs": "volts"}, "`inputs` must be a column of .*, got `volts`"),
        ({"outputs": ["yy"]}, r"`outputs` must be .*, got `yy`. Did you mean `y`\?"),
        ({"outputs": ["y[1]"]}, r"`outputs` must be below y\[1\], the number of columns of `y`"),
        ({"outputs": ()}, "`outputs` must name at least one column, got none. .* t, u, y"),
        ({"time": None}, "`time, sample_period` must not be both given .*, got time=None"),
        ({"sample_period": 1}, "`time, sample_period` must not be both given or both omitted"),
        ({"time": None, "sample_period": -1}, "`sample_period` must be positive .*, got -1"),
        ({"scale": {"x": 2}}, "`scale` must be one of t, u, y, got 'x'"),
        ({"scale": {"u": np.nan}}, r"`scale\[u\]` must be finite and not zero, got nan"),
        ({"scale": {"y": [1.0, np.inf]}}, r"`scale\[y\]` must have a finite offset, got inf"),
        ({"scale": {"y": [1.0, 2.0, 3.0]}}, r"`scale\[y\]` must be a factor, or \[factor, offset"),
        ({"scale": {"y": 0.0}}, r"`scale\[y\]` must be finite and not zero, got 0.0"),
        ({"inputs": 1}, "`inputs` must be a column of .*present: t, u, y.*, got `1`"),
        ({"units": {"x": "m"}}, "`units` must be one of t, u, y, got 'x'"),
        ({"renames": {"x": "m"}}, "`renames` must be one of t, u, y, got 'x'"),
        ({"slice": (40, 20)}, r"`slice` must be \(start, stop\) .* ≤ 50, .*, got \(40, 20\)"),
        ({"slice": (0, 51)}, r"`slice` must be"),
        ({"slice": (50, None)}, r"`slice` must be"),
        ({"slice": (-3, None)}, r"`slice` must be"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_call_is_named(tmp_path, options, message):
    path = write_csv(tmp_path / "run.csv")
    with pytest.raises(ValueError, match=message):
        read_record(path, **{"time": "t", "inputs": "u", "outputs": ["y"]} | options)


def test_a_missing_file_and_an_unknown_kind_are_named(tmp_path):
    with pytest.raises(ValueError, match=r"`path` must be an existing file, got .*none.csv"):
        read(tmp_path / "none.csv")
    with pytest.raises(ValueError, match="`path` must be an existing file"):
        read(tmp_path)
    write_csv(tmp_path / "run.xls")
    with pytest.raises(ValueError, match=r"must end in .csv, .tsv, .*, got run.xls"):
        read(tmp_path / "run.xls")


@pytest.mark.parametrize("file", ["a.parquet", "a.mat", "a.h5", "a.npz", "a.csv.gz", "a.csv"])
def test_a_file_that_is_not_what_its_name_says_is_named(tmp_path, file):
    (tmp_path / file).write_bytes(b"\x01\x00not it" * 100)
    suffix = file.removesuffix(".gz")[1:]
    with pytest.raises(ValueError, match=rf"must be a readable {suffix} file, got .*{file}"):
        read(tmp_path / file)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "it holds no data"),
        ("% only remarks\n", "it holds no data"),
        ("t,u,u\n1,2,3\n", "its header repeats a name: u; give each column"),
        ("t,u,y\n1,2,3\n1,2,3,4,5\n", "readable .csv file"),
    ],
)
def test_a_damaged_table_is_named(tmp_path, text, message):
    (tmp_path / "run.csv").write_text(text)
    with pytest.raises(ValueError, match=message):
        read(tmp_path / "run.csv")


def test_an_archive_of_objects_is_named_and_nothing_in_it_is_run(tmp_path):
    path, objects = tmp_path / "run.npz", np.array([object()] * N, dtype=object)
    np.savez(path, t=T, u=objects, y=Y[:, 0])
    with pytest.raises(ValueError, match=r"`inputs` must be readable in .*`u` holds Python obj"):
        read(path)
    assert len(read_record(path, "t", (), "y")) == N
    np.savez(path, u=objects)
    with pytest.raises(
        ValueError, match=r"must be a readable \.npz file.*`u` holds Python objects"
    ):
        read(path)
    path.write_text("x")
    with pytest.raises(ValueError, match=r"it is no archive of arrays, as `numpy\.savez`"):
        read(path)


def test_a_file_without_arrays_is_named(tmp_path):
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file.create_group("empty")
    with pytest.raises(ValueError, match="`path` must hold columns, got"):
        read(tmp_path / "run.h5")


def test_a_column_of_words_is_named_with_its_first_word(tmp_path):
    frame = pd.DataFrame({"t": T, "u": ["1"] * 9 + ["off"] * (N - 9), "y": Y[:, 0]})
    frame.to_csv(tmp_path / "run.csv", index=False)
    with pytest.raises(ValueError, match=r"`u` must be a numeric .*, got 'off' in line 11"):
        read(tmp_path / "run.csv")
    frame.to_parquet(tmp_path / "run.parquet")
    with pytest.raises(ValueError, match="got 'off' in row 9, counted from 0"):
        read(tmp_path / "run.parquet")


@pytest.mark.parametrize("separator", [",", "\t", " "])
@pytest.mark.parametrize("name", ["run.csv", "run.csv.gz"])
def test_the_line_of_a_word_is_counted_over_titles_and_blank_lines(tmp_path, separator, name):
    lines = ["measured today", "", separator.join("tuy"), separator.join("sVm")]
    lines += [separator.join((f"{t:.2f}", "1", "2")) for t in T]
    lines[10:10] = ["", "  "]
    wrong = lines[40].split(separator)
    lines[40] = separator.join([wrong[0], "off", wrong[2]])
    with (gzip.open if name.endswith("gz") else open)(tmp_path / name, "wt") as stream:
        stream.write("\r\n".join(lines))
    with pytest.raises(ValueError, match="got 'off' in line 41"):
        read(tmp_path / name)


def test_variables_of_other_lengths_or_shapes_are_named(tmp_path):
    np.savez(tmp_path / "run.npz", t=T, u=U[:-1], y=Y)
    path = tmp_path / "run.npz"
    with pytest.raises(ValueError, match=r"must be equally long in .*, got t 50, u 49, y\[0\] 50"):
        read_record(path, "t", "u", "y[0]")
    with pytest.raises(
        ValueError, match=r"`outputs` must name one column .*\(50, 2\). Write y\[0\]"
    ):
        read_record(path, "t", (), "y")
    with pytest.raises(ValueError, match=r"`outputs` must be below y\[2\]"):
        read_record(path, "t", (), "y[2]")


# -- measured records ---------------------------------------------------------------------


def test_emps_is_regular_and_keeps_every_sample(data_directory):
    path = data_directory / "emps" / "DATA_EMPS.mat"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        record = read_record(path, "t", "vir", "qm", scale={"vir": 35.15065}, units={"vir": "N"})
    assert len(record) == 24841
    assert record.sample_period == 0.001
    assert record.valid.all()
    assert np.max(np.abs(record.inputs)) < 10 * 35.16  # the controller's limits


def test_integer_force_pulses_become_floats(data_directory):
    path = data_directory / "emps" / "DATA_EMPS_PULSES.mat"
    record = read_record(path, "t", ["vir", "pulses_N"], "qm")
    assert set(np.unique(record.inputs[:, 1])) == {0.0, 5.0}


def test_silverbox_rows_are_columns(data_directory):
    path = data_directory / "silverbox" / "SNLS80mV.mat"
    record = read_record(path, None, "V1", "V2", sample_period=2**14 / 1e7, slice=(100, 40575))
    assert len(record) == 40475
    assert np.sqrt(np.mean(record.outputs**2)) == pytest.approx(53.4e-3, rel=0.01)


def test_cascaded_tanks_have_a_trailing_empty_column(data_directory):
    path = data_directory / "cascaded_tanks" / "dataBenchmark.csv"
    record = read_record(path, None, "uEst", "yEst", sample_period=4)
    assert len(record) == 1024
    assert record.outputs.max() == 10.0


def test_the_gappy_drone_file_is_resampled_and_masked(data_directory):
    path = data_directory / "quarter_drone" / "14_drone_seq_20260529_195254.csv.gz"
    with pytest.warns(RecordWarning, match="0.007 to 0.125 s apart: resampled .* 2 gaps"):
        record = read_record(path, "tempo_ms", "u_pct", "angulo_deg", scale={"tempo_ms": 1e-3})
    # 10 ms as a rule; the clock's mean is what 60 s need.
    assert record.sample_period == pytest.approx(0.0100145, rel=1e-5)
    assert len(record.segments()) == 3
    assert 15 <= np.sum(~record.valid) <= 30  # what two gaps of about 125 ms hold
    assert record.quantum[0] == pytest.approx(0.01)
    assert record.name == "14_drone_seq_20260529_195254"


def test_qube_encoders_have_2048_counts(data_directory):
    path = next((data_directory / "qube_rotary_pendulum").glob("*.npz"))
    record = read_record(path, "t", "plant_input", ["theta", "alpha"])
    assert record.sample_period == 0.002
    np.testing.assert_allclose(record.quantum, 2 * np.pi / 2048, rtol=1e-3)


def test_air_track_stamps_are_rounded_not_jittered(data_directory):
    path = data_directory / "schmidt_lipson" / "real_linear_h_1.txt"
    record = read_record(path, "1", (), "2")
    assert len(record) == 870
    assert record.valid.all()
    assert "rounding" in " ".join(record.notes)
    assert record.sample_period == pytest.approx(1 / 30, rel=2e-3)


def test_late_samples_of_a_2_ms_clock_are_no_gaps(data_directory):
    folder = data_directory / "dfki_double_pendulum"
    with pytest.warns(RecordWarning, match="resampled from 4997 samples"):
        record = read_record(folder / "A0_03.npz", "time", "tau_meas1", ["pos_meas1", "pos_meas2"])
    assert record.valid.all()  # late samples of 3.6 ms on a 2 ms clock are no gaps
    assert record.outputs.shape[1] == 2


HEADERS = {"in the name": "t,valve [%],level [mm]\n", "in a row": "t,valve,level\ns,%,mm\n"}


def test_a_column_of_the_same_name_in_another_unit_is_the_one_that_is_meant(tmp_path):
    rows = "".join(f"{i},{i % 7},{i}\n" for i in range(40))
    (tmp_path / "run.csv").write_text(f"t,Ta [degC],T [degF]\n{rows}")
    with pytest.raises(ValueError, match=r"got `T \[degC\]`. Did you mean `T \[degF\]`\?"):
        read_record(tmp_path / "run.csv", "t", "Ta [degC]", "T [degC]")
    (tmp_path / "run.csv").write_text(f"t,TI2.PV [degC],TIC1.PV [degF]\n{rows}")
    with pytest.raises(ValueError, match=r"Did you mean `TIC1.PV \[degF\]`\?"):
        read_record(tmp_path / "run.csv", "t", "TI2.PV [degC]", "TIC1.PV [degC]")


@pytest.mark.parametrize(
    ("head", "scale", "unit"),
    [("time [h]", 3600, "s"), ("time [h]", 1, "h"), ("time [h]", 60, "min"), ("time [s]", 1, "s"),
     ("time", 3600, None)],
)  # fmt: skip
def test_rates_per_hour_of_a_model_are_told_where_time_counts_in_seconds(
    tmp_path, head, scale, unit
):
    path = tmp_path / "run.csv"
    path.write_text(f"{head},u,y\n" + "".join(f"{k / 4},{k % 7},{k}\n" for k in range(40)))
    record = read_record(path, head, "u", "y", scale={head: scale})
    assert (record.file_units or {}).get("time") == unit
    for rate, is_told in (("1/h", unit == "s"), ("1/s", False)):
        units = {"k": rate, "tau": rate.removeprefix("1/"), "a": "m/h"}
        plant = Plant(lambda t, x, u, p: p.k * u[0], {"k": 1.0, "tau": 1.0, "a": 1.0}, 1, ("u",),
                      ("y",), units=units)  # fmt: skip
        notes = unit_notes(plant, [record])
        assert any("declared per h, and the records count time in s" in n for n in notes) is is_told


@pytest.mark.parametrize(
    ("unit", "expected", "scale", "pair"),
    [
        ("°F", "°C", 5 / 9, (5 / 9, -160 / 9)),
        ("K", "degC", 1.0, (1.0, -273.15)),
        ("deg F", "K", 0.5556, (5 / 9, 459.67 * 5 / 9)),
    ],
)
def test_a_factor_alone_moves_no_zero_of_a_temperature(tmp_path, unit, expected, scale, pair):
    path, key = tmp_path / "room.csv", f"T [{unit}]"
    path.write_text(f"t,u,{key}\n" + "".join(f"{i},{i % 7},{i}\n" for i in range(40)))
    plant = Plant(lambda t, x, u, p: p.k * u[0], {"k": 1.0}, 1, ("u",), ("T",),
                  units={"T": expected})  # fmt: skip
    said = re.escape(f"differ: give the column the `scale` [{pair[0]:.10g}, {pair[1]:.10g}]")
    for factors, units in ((None, None), ({key: scale}, None), ({key: scale}, {key: expected})):
        record = read_record(path, "t", "u", key, scale=factors, units=units)
        with pytest.raises(ValueError, match=said):
            check_records(plant, record)
    record = read_record(path, "t", "u", key, scale={key: pair})
    assert check_records(plant, record) == (record,)
    np.testing.assert_allclose(record.outputs[:, 0], pair[0] * np.arange(40) + pair[1])
    tenths = Plant(lambda t, x, u, p: p.k * u[0], {"k": 1.0}, 1, ("u",), ("T",), units={"T": unit})
    record = read_record(path, "t", "u", key, scale={key: 0.1})
    assert check_records(tenths, record) == (record,)


@pytest.mark.parametrize("header", HEADERS.values(), ids=HEADERS)
def test_the_unit_in_a_file_is_checked_where_the_caller_gives_none(tmp_path, header):
    """1 mm as 1 cm would be a wrong answer without a word."""
    path = tmp_path / "tank.csv"
    path.write_text(header + "".join(f"{0.1 * i:.1f},{i % 7},{i}\n" for i in range(40)))
    names = header.splitlines()[0].split(",")
    units = {"h": "cm", "valve": "%"}
    plant = Plant(lambda t, x, u, p: p.k * u[0], {"k": 1.0}, 1, ("valve",), ("h",), units=units)
    wrong = r"outputs\[level.*\]` must be in the plant's unit for `h`, 'cm', got 'mm' in its file."
    record = read_record(path, *names)
    with pytest.raises(ValueError, match=wrong):
        check_records(plant, record[5:30])
    for options in ({"scale": {names[2]: 0.1}}, {"units": {names[2]: "cm"}}):
        record = read_record(path, *names, **options)
        assert check_records(plant, record) == (record,)
    assert unit_notes(plant, [record]) == []
    table = path.read_text()
    path.write_text(table.replace("mm", "bar"))
    with pytest.raises(
        ValueError, match=r"'cm', got 'bar' in its file.*`units`, if it is not that"
    ):
        check_records(plant, read_record(path, *(name.replace("mm", "bar") for name in names)))
    path.write_text(table.replace("mm", "raw"))
    names = [name.replace("mm", "raw") for name in names]
    record = read_record(path, *names)
    assert check_records(plant, record) == (record,)
    for result in (identify(plant, record), refine(plant, record), validate(plant, record)):
        notes = result.reasons if isinstance(result, Identification) else result.notes
        (note,) = [note for note in notes if "'raw' in its file and in 'cm' in the model" in note]
        assert note.endswith("is not known. If they are, give it by `units`")
