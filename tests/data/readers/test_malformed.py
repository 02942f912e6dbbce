"""Files that are not what they say: one sentence, in bounds, and nothing from other files."""

import gzip
import io
import struct
import warnings
import zipfile

import h5py
import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

import eoi_jax as eoi
from eoi_jax.data.readers.limits import Allowance
from eoi_jax.data.readers.read_record import read_record, read_table

N = 50
T = 0.01 * np.arange(N)
Y = np.cos(T)


def tabled(path):
    """Names of the columns, and notes."""
    found = read_table(path)
    return list(found.columns), " ".join(found.notes)


def refused(path, *said, max_gigabytes=4.0):
    with pytest.raises(ValueError, match="`path` must be a readable") as caught:
        read_table(path, max_gigabytes)
    for part in said:
        assert part in str(caught.value)
    assert "\n" not in str(caught.value)


# -- how much a file may unpack to ------------------------------------------------------------


def write_gzip(path):
    path.write_bytes(gzip.compress(b"1,2,3\n" * 40_000))


def write_npz(path):
    np.savez_compressed(path, a=np.zeros(30_000))


def write_mat(path):
    savemat(path, {"a": np.zeros(30_000)}, do_compression=True)


def write_plain_mat(path):
    savemat(path, {"a": np.zeros(30_000)})


def write_hdf5(path):
    with h5py.File(path, "w") as file:
        file.create_dataset("a", (30_000,), "f8", chunks=(100,))


def write_texts(path):
    with h5py.File(path, "w") as file:
        file["a"] = ["x" * 5000] * 50


def write_parquet(path):
    pd.DataFrame({"a": np.zeros(30_000)}).to_parquet(path)


def write_excel(path):
    pd.DataFrame({"a": np.zeros(2000), "b": np.zeros(2000)}).to_excel(path)


@pytest.mark.parametrize(
    ("file", "write"),
    [
        ("run.csv.gz", write_gzip),
        ("run.npz", write_npz),
        ("run.mat", write_mat),
        ("plain.mat", write_plain_mat),
        ("run.h5", write_hdf5),
        ("texts.h5", write_texts),
        ("run.parquet", write_parquet),
        ("run.xlsx", write_excel),
    ],
)
def test_a_file_that_unpacks_to_more_than_is_allowed_is_refused(file, write, tmp_path):
    """Each unpacks to 0.24 MB or a little more."""
    path = tmp_path / file
    write(path)
    refused(path, "it unpacks to more than 0.0002 GB", "`max_gigabytes`", max_gigabytes=2e-4)
    assert read_table(path, 1e-2).columns
    assert read_table(path, np.inf).columns


def test_the_limit_is_a_positive_number_and_read_record_and_inspect_have_it(tmp_path):
    for wrong in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="`max_gigabytes` must be positive"):
            Allowance(wrong)
    np.savez(tmp_path / "run.npz", t=T, y=Y)
    for call in (
        lambda: read_record(tmp_path / "run.npz", "t", (), "y", max_gigabytes=1e-9),
        lambda: eoi.inspect(tmp_path / "run.npz", max_gigabytes=1e-9),
    ):
        with pytest.raises(ValueError, match="it unpacks to more than 1e-09 GB"):
            call()


# -- sizes that are lies ----------------------------------------------------------------------


def zipped(header: bytes, size: int = 400) -> bytes:
    array = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + bytes(size)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("y.npy", array)
    return stream.getvalue()


@pytest.mark.parametrize("shape", ["(10000000000000,)", "(-5,)", "(4611686018427387904, 4)"])
def test_an_array_that_says_it_is_larger_than_it_is_is_refused(shape, tmp_path):
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    (tmp_path / "run.npz").write_bytes(zipped(header))
    refused(tmp_path / "run.npz", "`y.npy` declares a larger size than it has")


def element(kind, data):
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def matrix(group, axes, name, *parts):
    head = element(6, struct.pack("<II", group, 0))
    head += element(5, struct.pack(f"<{len(axes)}i", *axes)) + element(1, name)
    return element(14, head + b"".join(parts))


def write_mat5(path, *elements):
    path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"".join(elements))


def test_a_matrix_of_version_5_is_as_large_as_its_dimensions_say(tmp_path):
    path = tmp_path / "run.mat"
    good = matrix(6, (N, 1), b"t", element(9, T.tobytes()))
    write_mat5(path, good)
    assert tabled(path)[0] == ["t"]
    write_mat5(path, good, matrix(4, (2**15, 2**16), b"y", element(4, b"")))  # spaces throughout
    refused(path, "it unpacks to more than 4 GB")
    short = struct.pack("<I", 5 | 4 << 16) + struct.pack("<i", 2**30)  # dimensions in their tag
    flags = element(6, struct.pack("<II", 6, 0))
    write_mat5(path, good, element(14, flags + short + element(1, b"y")))
    refused(path, "it unpacks to more than 4 GB")


def test_cells_in_cells_are_read_and_a_tower_of_them_is_refused(tmp_path):
    def nested(depth):
        inner = matrix(6, (1, 1), b"", element(9, struct.pack("<d", 1.0)))
        for _ in range(depth):
            inner = matrix(1, (1, 1), b"", inner)
        return matrix(1, (1, 1), b"deep", inner)

    write_mat5(tmp_path / "run.mat", nested(20))
    assert read_table(tmp_path / "run.mat").columns
    write_mat5(tmp_path / "run.mat", nested(200))
    refused(tmp_path / "run.mat", "its structures or cells are nested too deeply")


@pytest.mark.parametrize("quote", ['"', "'"])
def test_a_cell_far_away_makes_a_sheet_as_large_as_that(quote, tmp_path):
    pd.DataFrame({"a": T}).to_excel(tmp_path / "good.xlsx", index=False)
    far = '<row r="1048576"><c r="XFD1048576"><v>1</v></c></row></sheetData>'.replace('"', quote)
    with (
        zipfile.ZipFile(tmp_path / "good.xlsx") as old,
        zipfile.ZipFile(tmp_path / "run.xlsx", "w") as new,
    ):
        for name in old.namelist():
            text = old.read(name)
            if name.endswith("sheet1.xml"):
                text = text.replace(b"</sheetData>", far.encode())
            new.writestr(name, text)
    refused(tmp_path / "run.xlsx", "it unpacks to more than 4 GB")


# -- HDF5: what is in the file itself, each object once ---------------------------------------


def in_hdf5(path, add, matlab=False):
    with h5py.File(path, "w", userblock_size=512 if matlab else 0) as file:
        file["y"] = Y
        add(file)
    return path


def test_loops_and_many_ways_to_one_object_are_walked_once(tmp_path):
    def tangle(file):
        file.create_group("a")["up"] = file["/"]
        group = file.create_group("g")
        for i in range(60):
            below = file.create_group(f"all/g{i}")
            group["left"], group["right"] = below, below
            group = below
        group["x"] = T

    for name in ("run.h5", "run.mat"):
        names, notes = tabled(in_hdf5(tmp_path / name, tangle, name == "run.mat"))
        assert len(names) == 2
        assert "is in the file under another name: left out" in notes


def test_what_lies_in_other_files_stays_there(tmp_path):
    secret = tmp_path / "secret.h5"
    with h5py.File(secret, "w") as file:
        file["x"] = T

    def outside(file):
        file["link"] = h5py.ExternalLink(str(secret), "/x")
        file["dangling"] = h5py.SoftLink("/nowhere")
        file.create_dataset("raw", (N,), "u1", external=[(str(secret), 0, N)])
        layout = h5py.VirtualLayout((N,), "f8")
        layout[:] = h5py.VirtualSource(str(secret), "x", (N,))
        file.create_virtual_dataset("virtual", layout)

    for name in ("run.h5", "run.mat"):
        found = read_table(in_hdf5(tmp_path / name, outside, name == "run.mat"))
        good = [key for key, values in found.columns.items() if len(values)]
        assert good == ["y"]
        for key in ("link", "raw", "virtual"):
            assert f"`{key}` lies in another file: left out." in found.notes


def test_a_cell_of_vectors_is_a_matrix_and_one_within_itself_ends(tmp_path):
    def cells(file):
        parts = [file.create_dataset(f"#refs#/{i}", data=(i + 1) * Y[None]) for i in range(3)]
        file["c"] = np.asarray([[one.ref for one in parts]], h5py.ref_dtype)
        ring = file.create_dataset("ring", (1,), h5py.ref_dtype)
        ring[0] = ring.ref

    found = read_table(in_hdf5(tmp_path / "run.mat", cells, matlab=True))
    for i in range(3):
        np.testing.assert_array_equal(found.columns[f"c[{i}]"], (i + 1) * Y)
    assert eoi.inspect(tmp_path / "run.mat").samples == N


def test_attributes_and_types_of_any_kind_are_read_or_left_out(tmp_path):
    def odd(file):
        for i, value in enumerate((7, np.arange(3), b"\xff", "char")):
            file[f"a{i}"] = Y
            file[f"a{i}"].attrs["MATLAB_class"] = value
        file["rows"] = np.zeros(N, [("a", "f8"), ("b", "S5")])
        file["opaque"] = np.zeros(N, "V7")
        file["empty"] = h5py.Empty("f8")
        file["square"] = h5py.Dataset(file.create_dataset("s", (3, 3), h5py.string_dtype()).id)

    names, notes = tabled(in_hdf5(tmp_path / "run.h5", odd))
    assert {"a0", "a3", "rows.a", "rows.b"} <= set(names)
    assert "`opaque` is of the type |V7: left out." in notes
    assert "holds texts in 2 axes: left out." in notes


# -- one naming of matrices -------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".npz", ".mat", ".h5"])
def test_columns_of_a_matrix_have_one_name_to_inspect_to_init_and_to_read(suffix, tmp_path):
    drive = np.sign(np.sin(8.0 * T))
    values = {"t": T, "m": np.stack([drive, Y, 0.0 * T], axis=1)}
    path = tmp_path / f"run{suffix}"
    if suffix == ".npz":
        np.savez(path, t=values["t"], m=values["m"])
    elif suffix == ".mat":
        savemat(path, values)
    else:
        with h5py.File(path, "w") as file:
            for key, value in values.items():
                file[key] = value
    found = eoi.inspect(path)
    assert {one.name for one in found.channels} == {"t", "m[0]", "m[1]", "m[2]"}
    assert (found.inputs, found.outputs) == (("m[0]",), ("m[1]",))
    record = read_record(path, "t", found.inputs, found.outputs)
    np.testing.assert_array_equal(record.inputs[:, 0], drive)


# -- complex numbers, odd names ---------------------------------------------------------------


def test_the_imaginary_part_is_never_dropped(tmp_path):
    np.savez(tmp_path / "run.npz", t=T, y=Y + 1j)
    savemat(tmp_path / "run.mat", {"t": T, "y": Y + 1j})
    with h5py.File(tmp_path / "new.mat", "w") as file:
        file["t"], file["y"] = T, (Y + 1j)
    for name in ("run.npz", "run.mat", "new.mat"):
        with pytest.raises(ValueError, match=r"`y` must be a real column of .*complex numbers"):
            read_record(tmp_path / name, "t", (), "y")
        (y,) = [one for one in eoi.inspect(tmp_path / name).channels if one.name == "y"]
        assert y.kind == "complex numbers"
    savemat(tmp_path / "ident.mat", {"OutputData": Y + 1j, "InputData": T, "Ts": 0.1})
    refused(tmp_path / "ident.mat", "its iddata object is complex")


def test_names_hold_nothing_that_a_terminal_obeys(tmp_path):
    name = "\x1b[31mred\n\u202e"
    with zipfile.ZipFile(tmp_path / "run.npz", "w") as archive:
        for key, values in (("t", T), (name, Y)):
            with archive.open(f"{key}.npy", "w") as stream:
                np.save(stream, values)
    found = read_table(tmp_path / "run.npz")
    shown = r"\x1b[31mred\n\u202e"
    assert list(found.columns) == ["t", shown]
    assert f"Unprintable characters in names are written as escape codes: {shown}." in found.notes
    for given in (name, shown):
        assert read_record(tmp_path / "run.npz", "t", (), given).output_names == (shown,)


def test_an_error_shows_what_it_got_and_no_control_character():
    with pytest.raises(ValueError, match=r"got \\x1b\[31m\\n\.") as caught:
        read_table("\x1b[31m\n")
    assert str(caught.value).isprintable()


def test_an_element_of_an_unknown_type_is_refused(tmp_path):
    """The reader would look its size up beyond the end of a table."""
    write_mat5(tmp_path / "run.mat", matrix(6, (1, 1), b"y", element(77, bytes(8))))
    refused(tmp_path / "run.mat", "it holds an element of an unknown type")


def test_numbers_whose_squares_are_none_are_refused_and_inspected_without_a_warning(tmp_path):
    values = Y.copy()
    values[7] = 1e200
    np.savez(tmp_path / "run.npz", t=T, y=values)
    with pytest.raises(ValueError, match=r"`outputs` must be below 1e\+150 in size, got 1e\+200"):
        read_record(tmp_path / "run.npz", "t", (), "y")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert eoi.inspect(tmp_path / "run.npz").samples == N
