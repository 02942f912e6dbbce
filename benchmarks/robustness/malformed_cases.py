"""Malformed and foreign files, seeded: what `malformed_files.py` gives to the readers."""

import gzip
import io
import json
import os
import random
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
from scipy.io import savemat

N = 60
T = 0.01 * np.arange(N)
U = np.sign(np.sin(3.0 * T))
Y = np.cos(2.0 * T)
GOOD = "t,u,y\n" + "\n".join(f"{a},{b},{c}" for a, b, c in zip(T, U, Y, strict=True)) + "\n"
ESCAPE = "\x1b[31mred\x1b]0;title\x07"


@dataclass(frozen=True)
class Case:
    """One file.

    Attributes:
        kind: of file, for the table.
        name: what is wrong with it.
        file: its name; it may be a path within a folder.
        make: writes it.
        use: who reads it: ``data``, ``result``, ``config`` or ``run``.
        max_gigabytes: for the reader.
    """

    kind: str
    name: str
    file: str
    make: Callable[[Path], None]
    use: str = "data"
    max_gigabytes: float = 4.0


def content(data: bytes | str) -> Callable[[Path], None]:
    """A file of these bytes."""
    raw = data.encode() if isinstance(data, str) else data
    return lambda path: _put(path, raw)


def _put(path: Path, raw: bytes) -> None:
    path.write_bytes(raw)


def written(make: Callable[[Path], None], suffix: str, folder: Path) -> bytes:
    """The bytes of a file that a library writes."""
    path = folder / f"base{suffix}"
    make(path)
    data = path.read_bytes()
    path.unlink()
    return data


# -- any format: the bytes themselves ---------------------------------------------------------


def spoilt(data: bytes, draw: random.Random) -> Iterator[tuple[str, bytes]]:
    """Truncations, flipped bits, lost and foreign pieces."""
    size = len(data)
    yield "empty", b""
    for at in (1, 7, size // 3, size // 2, size - 9, size - 1):
        yield f"cut at {at}", data[:at]
    for i in range(14):
        changed = bytearray(data)
        for _ in range(draw.choice((1, 1, 3, 20))):
            changed[draw.randrange(size)] ^= 1 << draw.randrange(8)
        yield f"flipped bits {i}", bytes(changed)
    for i in range(5):
        at = draw.randrange(size)
        length = draw.randrange(1, max(2, size // 4))
        filler = draw.choice((b"\0" * length, b"\xff" * length, draw.randbytes(length)))
        yield f"a piece replaced {i}", data[:at] + filler + data[at + length :]
    first, second = sorted(draw.sample(range(size), 2))
    yield "a piece lost", data[:first] + data[second:]
    yield "a piece repeated", data[:second] + data[first:]
    yield "twice", data + data
    yield "with more behind it", data + draw.randbytes(3000)
    yield "random bytes", draw.randbytes(500)
    yield "zeros", bytes(1000)
    yield "text", b"no such file, but a line of text\n" * 20
    yield "a picture", b"\x89PNG\r\n\x1a\n" + draw.randbytes(400)


# -- text -------------------------------------------------------------------------------------


def texts() -> Iterator[tuple[str, bytes]]:
    """Tables that are no tables, or hardly."""
    rows = GOOD.splitlines()
    body = "\n".join(rows[1:])
    yield "escape sequences in a name", GOOD.replace("t,u,y", f"t,{ESCAPE},y", 1).encode()
    yield "a line break in a name", GOOD.replace("t,u,y", 't,"u\nv",y', 1).encode()
    yield "a direction mark in a name", GOOD.replace("t,u,y", "t,\u202eu,y", 1).encode()
    yield "LaTeX in a name", GOOD.replace("t,u,y", r"t,$\frac{u,y", 1).encode()
    yield "NUL further down", GOOD.encode() + b"1,\0,2\n"
    yield "UTF-16", GOOD.encode("utf-16")
    yield "half of UTF-16", GOOD.encode("utf-16")[:-1]
    yield "Latin-1", GOOD.replace("u", "ü").encode("latin-1")
    yield "a wrong byte", GOOD.encode() + b"\xff\xfe\xfa,1,2\n"
    yield "a mark alone", b"\xef\xbb\xbf"
    yield "line breaks alone", b"\n" * 500
    yield "separators alone", b",,,,\n" * 100
    yield "a header alone", b"t,u,y\n"
    yield "comments alone", b"# nothing\n" * 50
    yield "one number", b"1"
    yield "one row", b"t,u,y\n1,2,3\n"
    yield "repeated names", GOOD.replace("t,u,y", "t,u,u", 1).encode()
    yield "empty names", GOOD.replace("t,u,y", ",,", 1).encode()
    yield "ragged rows", "\n".join(row + "," * (i % 4) for i, row in enumerate(rows)).encode()
    yield "short rows", "\n".join(row[: 3 + i % 9] for i, row in enumerate(rows)).encode()
    yield "a quote that never ends", (rows[0] + '\n"' + body).encode()
    yield "numbers beyond double", GOOD.replace("1.0", "1e999").encode()
    yield "NaN throughout", ("t,u,y\n" + "nan,nan,nan\n" * N).encode()
    yield "infinity throughout", ("t,u,y\n" + "inf,-inf,inf\n" * N).encode()
    yield "complex numbers", ("t,u,y\n" + "1+2j,3,4\n" * N).encode()
    yield "formulas", ("t,u,y\n" + "=cmd|'/c calc'!A1,1,2\n" * N).encode()
    yield "dates that break off", ("t,u,y\n2024-01-01,1,2\n" + "soon,1,2\n" * N).encode()
    yield "impossible dates", ("t,u,y\n" + "2024-13-45 99:99,1,2\n" * N).encode()
    yield "times that break off", ("t,u,y\n10:00,1,2\n" + "later,1,2\n" * N).encode()
    yield "carriage returns", GOOD.replace("\n", "\r").encode()
    yield "a long line", b"1," * 300_000
    yield "a long word", b"x" * 2_000_000
    yield "many columns", b"\n".join(b",".join(b"%d" % j for j in range(3000)) for _ in range(9))
    yield "the same stamp throughout", ("t,u,y\n" + "1,2,3\n" * N).encode()
    yield "time backwards", ("t,u,y\n" + "\n".join(reversed(rows[1:]))).encode()
    yield "whole numbers of 40 digits", ("t,u,y\n" + f"1,2,{10**40}\n" * N).encode()
    yield (
        "every second sample missing",
        ("t,u,y\n" + "\n".join(f"{k},{k % 5},{'' if k % 2 else k * k}" for k in range(N))).encode(),
    )


def many_members(piece: bytes, count: int) -> bytes:
    """A gzip file whose members unpack to `count` times the piece."""
    return gzip.compress(piece, 9) * count


# -- archives ---------------------------------------------------------------------------------


def zipped(members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return stream.getvalue()


def npy(values: np.ndarray, pickled: bool = False) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.asarray(values), allow_pickle=pickled)
    return stream.getvalue()


def npy_header(text: str, data: bytes = bytes(480)) -> bytes:
    raw = text.encode("latin-1") + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(raw)) + raw + data


class Runs:
    """Unpickled, it would make a file."""

    def __reduce__(self):
        return os.system, ("touch executed",)


def archives() -> Iterator[tuple[str, bytes]]:
    """Arrays that are none, or say more than they are."""
    good = {"t.npy": npy(T), "u.npy": npy(U)}

    def beside(name: str, data: bytes) -> bytes:
        return zipped({**good, name: data})

    yield "a pickle", beside("y.npy", npy(np.asarray([Runs()], dtype=object), pickled=True))
    yield "a pickle alone", zipped({"y.npy": npy(np.asarray([Runs()], dtype=object), True)})
    shape = "{{'descr': '<f8', 'fortran_order': False, 'shape': {}, }}"
    for text in ("(10**12,)", "(1000000000000,)", "(-60,)", "(60, 60, 60)", "60", "('a',)",
                 "(4611686018427387904, 4)", "()", "(True,)", "[60]"):  # fmt: skip
        yield f"shape {text}", beside("y.npy", npy_header(shape.format(text)))
    for descr in ("'|O'", "'<U1000000000'", "[('a', '<f8'), ('b', 'O')]", "'nonsense'", "None",
                  "'|V8'", "'<c16'", "'<M8[s]'", "'|b1'", "'>f4'"):  # fmt: skip
        text = f"{{'descr': {descr}, 'fortran_order': False, 'shape': (60,), }}"
        yield f"type {descr}", beside("y.npy", npy_header(text))
    yield "code for a header", beside("y.npy", npy_header("__import__('os').system('touch x')"))
    yield "a deep header", beside("y.npy", npy_header("(" * 9000 + ")" * 9000))
    yield "no array", beside("y.npy", b"not an array")
    yield "an empty array file", beside("y.npy", b"")
    yield "version 9", beside("y.npy", b"\x93NUMPY\x09\x00" + bytes(100))
    yield "a name that climbs", beside("../../y.npy", npy(Y))
    yield "a name with escapes", beside(f"{ESCAPE}.npy", npy(Y))
    yield "a name with a line break", beside("a\nb.npy", npy(Y))
    yield "no name", beside(".npy", npy(Y))
    yield "a folder", beside("folder/", b"")
    yield "texts", beside("y.npy", npy(np.asarray(["on", "off"] * 30)))
    yield "a matrix", beside("y.npy", npy(np.outer(Y, [1.0, 2.0, 3.0])))
    yield "three axes", beside("y.npy", npy(np.zeros((3, 4, 5))))
    yield "structures", beside("y.npy", npy(np.zeros(N, [("a", float), ("b", int, (2,))])))
    yield "complex", zipped({"t.npy": npy(T), "u.npy": npy(U + 1j), "y.npy": npy(Y)})
    yield "scalars alone", zipped({"a.npy": npy(np.asarray(3.0))})
    yield "empty arrays", zipped({"a.npy": npy(np.zeros(0)), "b.npy": npy(np.zeros((0, 5)))})
    yield "NaN throughout", zipped({"t.npy": npy(T), "y.npy": npy(np.full(N, np.nan))})
    yield "no members", zipped({})
    yield "text members", zipped({"readme.txt": b"hello"})
    large = bytearray(zipped({"t.npy": npy(T)}))
    at = large.rfind(b"PK\x01\x02")
    large[at + 24 : at + 28] = struct.pack("<I", 0xFFFFFFF0)
    yield "a size that is a lie", bytes(large)
    locked = bytearray(zipped({"t.npy": npy(T)}))
    locked[6] |= 1
    locked[locked.rfind(b"PK\x01\x02") + 8] |= 1
    yield "encrypted", bytes(locked)


def bomb(megabytes: int, count: int) -> bytes:
    """An archive of zeros."""
    zeros = npy(np.zeros(megabytes * 125_000))
    return zipped({f"a{i}.npy": zeros for i in range(count)})


# -- HDF5, and MAT 7.3 ------------------------------------------------------------------------


def trees() -> Iterator[tuple[str, Callable[[h5py.File], None]]]:
    """What may be in such a file, beside good columns."""

    def loop(file: h5py.File) -> None:
        file.create_group("a")["up"] = file["/"]

    def many_ways(file: h5py.File) -> None:
        group = file.create_group("g0")
        for i in range(1, 40):
            below = file.create_group(f"all/g{i}")
            group["left"], group["right"] = below, below
            group = below
        group["x"] = T

    def deep(file: h5py.File) -> None:
        group = file
        for _ in range(3000):
            group = group.create_group("g")
        group["x"] = T

    def outside(file: h5py.File) -> None:
        file["link"] = h5py.ExternalLink("/etc/passwd", "/x")
        file["dangling"] = h5py.SoftLink("/nowhere")
        file["ring"] = h5py.SoftLink("/ring")
        file.create_dataset("raw", (40,), "u1", external=[("/etc/passwd", 0, 40)])

    def virtual(file: h5py.File) -> None:
        layout = h5py.VirtualLayout((N,), "f8")
        layout[:] = h5py.VirtualSource("/etc/passwd", "x", (N,))
        file.create_virtual_dataset("virtual", layout)

    def huge(file: h5py.File) -> None:
        file.create_dataset("huge", (10**13,), "f8", chunks=(1000,))

    def huge_text(file: h5py.File) -> None:
        file.create_dataset("huge", (10**9,), h5py.string_dtype(), chunks=(1000,))

    def zeros(file: h5py.File) -> None:
        file.create_dataset("zeros", (10**9,), "f8", chunks=(10**6,), compression="gzip")

    def references(file: h5py.File) -> None:
        file["r"] = np.asarray([file["t"].ref, file["u"].ref], dtype=h5py.ref_dtype)
        ring = file.create_dataset("ring", (1,), h5py.ref_dtype)
        ring[0] = ring.ref
        ring.attrs["MATLAB_class"] = np.bytes_("cell")
        file.create_dataset("null", (3,), h5py.ref_dtype)

    def cell(file: h5py.File) -> None:
        parts = [file.create_dataset(f"#refs#/{i}", data=(i + 1) * Y[None]) for i in range(3)]
        cells = file.create_dataset(
            "c", data=np.asarray([[one.ref for one in parts]], h5py.ref_dtype)
        )
        cells.attrs["MATLAB_class"] = np.bytes_("cell")

    def attributes(file: h5py.File) -> None:
        for i, value in enumerate(
            (7, 2.5, np.arange(3), "ü", b"\xff\xfe", "char", "cell", "object")
        ):
            file[f"a{i}"] = Y[None]
            file[f"a{i}"].attrs["MATLAB_class"] = value
            file[f"a{i}"].attrs["MATLAB_empty"] = i % 2
        file["o"] = np.zeros(3, "u4")
        file["o"].attrs["MATLAB_class"] = np.bytes_("timeseries")
        file["o"].attrs["MATLAB_object_decode"] = 3

    def types(file: h5py.File) -> None:
        file["compound"] = np.zeros(N, [("a", "f8"), ("b", "S5"), ("c", "f4", (2,))])
        file["complex"] = Y + 1j
        file["enum"] = np.zeros(N, h5py.enum_dtype({"on": 1, "off": 0}, "i1"))
        file["half"] = Y.astype("f2")
        file["fixed"] = np.asarray([b"a", b"\xff"] * 30)
        file["texts"] = ["eins", "zwei"] * 30
        file["opaque"] = np.zeros(N, "V7")
        file["empty"] = h5py.Empty("f8")
        file["none"] = np.zeros((0, 4))
        file["four"] = np.zeros((2, 3, 4, 5))
        file["row"] = np.zeros((1, N))
        vectors = file.create_dataset("ragged", (N,), h5py.vlen_dtype("f8"))
        vectors[0] = Y
        file["bits"] = np.ones(N, bool)
        file.create_dataset("scalar", data=3.0)

    def names(file: h5py.File) -> None:
        for name in (ESCAPE, "a\nb", " ", "ü", "a.b", "#x", "x[0]", "$\\frac{"):
            file[name] = Y
        file["x"] = np.outer(Y, [1.0, 2.0])

    def again(file: h5py.File) -> None:
        for i in range(50):
            file[f"copy{i}"] = file["t"]

    def nothing(file: h5py.File) -> None:
        for key in list(file):
            del file[key]

    yield from (
        ("a loop of links", loop), ("a billion ways", many_ways), ("3000 groups deep", deep),
        ("links to other files", outside), ("a virtual dataset", virtual),
        ("a dataset of 80 TB", huge), ("a billion texts", huge_text), ("8 GB of zeros", zeros),
        ("references, also to itself", references), ("a cell of vectors", cell),
        ("attributes of other types", attributes), ("every type", types), ("odd names", names),
        ("fifty links to one", again), ("nothing in it", nothing),
    )  # fmt: skip


def hdf5(add: Callable[[h5py.File], None], matlab: bool) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        with h5py.File(path, "w", userblock_size=512 if matlab else 0) as file:
            for key, values in (("t", T), ("u", U), ("y", Y)):
                file[key] = values[None] if matlab else values
            add(file)
        if matlab:
            with path.open("r+b") as stream:
                stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")

    return make


# -- MAT 5 ------------------------------------------------------------------------------------


def element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def matrix(group: int, axes: tuple[int, ...], name: bytes, *parts: bytes) -> bytes:
    flags = element(6, struct.pack("<II", group, 0))
    sizes = element(5, struct.pack(f"<{len(axes)}i", *axes))
    return element(14, flags + sizes + element(1, name) + b"".join(parts))


def mat5(*elements: bytes) -> bytes:
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"".join(elements)


def nested_cells(depth: int) -> bytes:
    inner = matrix(6, (1, 1), b"", element(9, struct.pack("<d", 1.0)))
    for _ in range(depth):
        inner = matrix(1, (1, 1), b"", inner)
    return matrix(1, (1, 1), b"deep", inner)


def inflated(count: int) -> bytes:
    """A compressed element of `count` times 16 MB of zeros."""
    head = element(6, struct.pack("<II", 6, 0)) + element(5, struct.pack("<ii", 1, 9))
    size = 16_000_000 * count
    start = struct.pack("<II", 14, 0xFFFFFF0) + head + element(1, b"z")
    start += struct.pack("<II", 9, min(size, 0xFFFFFF0))
    pack = zlib.compressobj(9, zlib.DEFLATED, -15)
    first = pack.compress(start) + pack.flush(zlib.Z_FULL_FLUSH)
    piece = pack.compress(bytes(16_000_000)) + pack.flush(zlib.Z_FULL_FLUSH)
    raw = b"\x78\xda" + first + piece * count
    return struct.pack("<II", 15, len(raw)) + raw


def mats() -> Iterator[tuple[str, bytes]]:
    """Built by hand: what no library would write."""
    good = matrix(6, (N, 1), b"t", element(9, T.tobytes()))
    number = element(9, struct.pack("<d", 1.0))
    yield "dimensions beyond the data", mat5(good, matrix(6, (2**30, 2**30), b"y", number))
    yield "negative dimensions", mat5(good, matrix(6, (-5, 3), b"y", number))
    yield "no dimensions", mat5(good, matrix(6, (), b"y", number))
    yield "70 dimensions", mat5(good, matrix(6, (1,) * 70, b"y", number))
    yield "a text of 4 GB", mat5(good, matrix(4, (2**15, 2**16), b"y", element(4, b"")))
    yield "a structure of a billion", mat5(good, matrix(2, (2**30, 1), b"y",
          element(5, struct.pack("<i", 8)), element(1, b"field\0\0\0")))  # fmt: skip
    yield "a structure without fields", mat5(good, matrix(2, (2**30, 1), b"y",
          element(5, struct.pack("<i", 8)), element(1, b"")))  # fmt: skip
    yield "a cell of a billion", mat5(good, matrix(1, (2**30, 1), b"y"))
    yield "90 cells deep", mat5(good, nested_cells(90))
    yield "5000 cells deep", mat5(good, nested_cells(5000))
    yield "an element of 4 GB", mat5(good) + struct.pack("<II", 14, 0xFFFFFFFF) + bytes(50)
    yield "an unknown class", mat5(good, matrix(99, (1, 1), b"y", number))
    yield "an unknown type", mat5(good, matrix(6, (1, 1), b"y", element(77, bytes(8))))
    yield "an object", mat5(good, matrix(17, (1, 1), b"y", number))
    yield (
        "a name with escapes",
        mat5(good, matrix(6, (N, 1), ESCAPE.encode(), element(9, Y.tobytes()))),
    )
    yield "a sparse matrix of 10^18", mat5(good, matrix(5, (10**9, 10**9), b"y",
          element(5, b""), element(5, b""), element(9, b"")))  # fmt: skip
    yield "5 GB in 5 MB", mat5(good, inflated(320))


def saved(values: dict[str, object]) -> Callable[[Path], None]:
    return lambda path: savemat(path, values)


def savable() -> Iterator[tuple[str, dict[str, object]]]:
    """What users keep in MAT files."""
    import scipy.sparse

    yield "structures", {"s": {"a": {"t": T, "y": Y}, "note": "x"}, "e": {}}
    yield "cells", {"c": np.asarray([T, Y[:5], "text"], dtype=object), "t": T}
    yield "cells in cells", {"c": np.asarray([[np.asarray([T, Y], object)]], object), "t": T}
    yield "an array of structures", {"s": np.asarray([(1, 2), (3, 4)], [("a", "O"), ("b", "O")])}
    yield "complex", {"t": T, "y": Y + 1j}
    yield "a sparse matrix", {"t": T, "s": scipy.sparse.eye(9, format="csc")}
    yield "texts", {"t": T, "c": np.asarray(["one", "three"])}
    yield "nothing", {}
    yield "empty", {"a": np.zeros((0, 0)), "b": ""}
    yield "four axes", {"t": T, "f": np.zeros((2, 3, 4, 5))}
    yield "truth values and bytes", {"t": T, "b": Y > 0, "i": U.astype("i8"), "u": U.astype("u1")}
    yield "half an iddata", {"OutputData": Y, "Ts": "fast"}
    yield "an iddata of other sizes", {"OutputData": Y, "InputData": U[:7], "Ts": 0.1}
    yield "a complex iddata", {"OutputData": Y + 1j, "InputData": U, "Ts": 0.1}
    yield "an iddata of texts", {"OutputData": "y", "InputData": "u", "Ts": 0.1}
    yield "half a log", {"time": T, "signals": {"label": "x"}}
    yield "a log of texts", {"time": "now", "signals": {"values": "x", "label": 7}}
    yield "a log of numbers", {"time": T, "signals": 3.0}


# -- spreadsheets, Parquet --------------------------------------------------------------------


def sheet(cells: str, extra: dict[str, bytes] | None = None) -> bytes:
    """A workbook of one sheet, by hand."""
    space = "http://schemas.openxmlformats.org"
    main = f"{space}/spreadsheetml/2006/main"
    types = "application/vnd.openxmlformats-officedocument.spreadsheetml"
    office = f"{space}/officeDocument/2006/relationships"
    package = f"{space}/package/2006"
    return zipped({
        "[Content_Types].xml": f'<Types xmlns="{package}/content-types">'
        '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.'
        'relationships+xml"/><Default Extension="xml" ContentType="application/xml"/>'
        f'<Override PartName="/xl/workbook.xml" ContentType="{types}.sheet.main+xml"/>'
        f'<Override PartName="/xl/worksheets/sheet1.xml" ContentType="{types}.worksheet+xml"/>'
        "</Types>".encode(),
        "_rels/.rels": f'<Relationships xmlns="{package}/relationships"><Relationship Id="r1" '
        f'Type="{office}/officeDocument" Target="xl/workbook.xml"/></Relationships>'.encode(),
        "xl/workbook.xml": f'<workbook xmlns="{main}" xmlns:r="{office}"><sheets>'
        '<sheet name="one" sheetId="1" r:id="r1"/></sheets></workbook>'.encode(),
        "xl/_rels/workbook.xml.rels": f'<Relationships xmlns="{package}/relationships">'
        f'<Relationship Id="r1" Type="{office}/worksheet" Target="worksheets/sheet1.xml"/>'
        "</Relationships>".encode(),
        "xl/worksheets/sheet1.xml": cells.encode() if cells.startswith("<?") else
        f'<worksheet xmlns="{main}"><sheetData>{cells}</sheetData></worksheet>'.encode(),
        **(extra or {}),
    })  # fmt: skip


def sheets() -> Iterator[tuple[str, bytes]]:
    """Workbooks that say more than they hold."""
    row = '<row r="{0}"><c r="A{0}"><v>{0}</v></c><c r="B{0}"><v>2</v></c></row>'
    rows = "".join(row.format(i) for i in range(1, 40))
    yield "good, by hand", sheet(rows)
    far = '<row r="1048576"><c r="XFD1048576"><v>1</v></c></row>'
    yield "a cell far away", sheet(rows + far)
    yield "the same, written otherwise", sheet(rows + far.replace('"', "'").replace("r=", "r = "))
    yield "a cell nowhere", sheet(rows + '<row r="0"><c r="ZZZZZ0"><v>1</v></c></row>')
    yield "a row of letters", sheet(rows + '<row r="x"><c r="?"><v>1</v></c></row>')
    yield "a row of many digits", sheet(rows + f'<row r="{"9" * 5000}"><c><v>1</v></c></row>')
    laughs = '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "' + "ha" * 50 + '">'
    laughs += "".join(f'<!ENTITY {chr(98 + i)} "{f"&{chr(97 + i)};" * 20}">' for i in range(12))
    yield "a billion laughs", sheet(laughs + "]><worksheet>&m;</worksheet>")
    entity = '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]>'
    yield "an external entity", sheet(entity + "<worksheet>&a;</worksheet>")
    yield "no sheet data", sheet("")
    yield "a broken sheet", sheet(rows[: len(rows) // 2])
    yield "texts and errors", sheet('<row r="1"><c r="A1" t="e"><v>#DIV/0!</v></c></row>' * 20)
    yield "a missing shared text", sheet('<row r="1"><c r="A1" t="s"><v>99</v></c></row>')
    yield "a date out of range", sheet(rows.replace("<v>2</v>", "<v>1e300</v>"))
    yield "no workbook", zipped({"xl/other.xml": b"<x/>"})


def frames() -> Iterator[tuple[str, pd.DataFrame]]:
    """Tables of every type."""
    good = pd.DataFrame({"t": T, "u": U, "y": Y})
    yield "lists", good.assign(y=[[1, 2]] * N)
    yield "structures", good.assign(y=[{"a": 1}] * N)
    yield "bytes", good.assign(y=[b"\xff"] * N)
    yield "texts with escapes", good.assign(y=[ESCAPE] * N)
    yield "nothing but missing", good.assign(y=[None] * N)
    yield "categories", good.assign(y=pd.Categorical(["a", "b"] * 30))
    yield "dates in a zone", good.assign(y=pd.date_range("2024", periods=N, tz="Europe/Berlin"))
    yield "durations", good.assign(y=pd.timedelta_range("1s", periods=N))
    yield "whole numbers with missing", good.assign(y=pd.array([1, None] * 30, "Int64"))
    yield "truth values with missing", good.assign(y=pd.array([True, None] * 30, "boolean"))
    yield "no rows", good.iloc[:0]
    yield "no columns", pd.DataFrame(index=good.index)
    yield "names with escapes", good.rename(columns={"u": ESCAPE})
    yield "numbers for names", good.rename(columns={"u": 3})
    yield "an index of dates", good.set_index(pd.date_range("2024", periods=N))
    yield "intervals", good.assign(y=pd.interval_range(0, N, N))
    yield "three rows", good.iloc[:3]


# -- configs and models as JSON ---------------------------------------------------------------

CONFIG = """
name = "rig"
[model]
outputs = ["angle"]
inputs = ["voltage"]
parameters = { a = 76.0, b = 2.5 }
derivatives = { angle = "rate", rate = "-a*angle - b*rate + voltage" }
[simulate]
sample_period = 0.01
duration = 1.0
increments = { a = 5.0 }
[simulate.input.voltage]
kind = "square"
amplitude = 0.2
frequency = 2.0
"""


def configs() -> Iterator[tuple[str, bytes]]:
    """TOML that is none, or asks for what there is not."""

    def changed(old: str, new: str) -> bytes:
        assert old in CONFIG
        return CONFIG.replace(old, new, 1).encode("utf-8", "surrogateescape")

    for name in (
        r"a\n",
        "",
        "..",
        "../x",
        "a/b",
        r"a\u001b[31m",
        r"\u0000",
        ".hidden",
        "ü",
        "x" * 999,
    ):
        yield f"name {name[:12]!r}", changed('"rig"', f'"{name}"')
    for value in ("1", "[]", "nan", "1979-05-27", "true", "{}"):
        yield f"name = {value}", changed('name = "rig"', f"name = {value}")
        yield f"outputs = {value}", changed('outputs = ["angle"]', f"outputs = {value}")
        yield (
            f"sample_period = {value}",
            changed("sample_period = 0.01", f"sample_period = {value}"),
        )
        yield f"simulate.input = {value}", changed('kind = "square"', f"kind = {value}")
    for value in ("inf", "nan", "-1.0", "0", "1e300", "1e-300"):
        yield f"duration {value}", changed("duration = 1.0", f"duration = {value}")
        yield f"frequency {value}", changed("frequency = 2.0", f"frequency = {value}")
        yield f"parameter {value}", changed("a = 76.0", f"a = {value}")
    yield "brackets 5000 deep", f"x = {'[' * 5000}{']' * 5000}".encode()
    yield "tables 3000 deep", ("[" + ".".join("a" * 3000) + "]\n").encode()
    yield "a number of 5000 digits", changed("1.0", "9" * 5000)
    yield "no UTF-8", CONFIG.encode() + b"# \xff\n"
    yield "a key twice", changed('name = "rig"', 'name = "rig"\nname = "rig"')
    yield "an unknown key", changed('name = "rig"', f'name = "rig"\n"{"k" * 300}" = 1')
    yield "a key with escapes", changed('name = "rig"', 'name = "rig"\n"\\u001b[31m" = 1')
    yield "an output with escapes", changed('["angle"]', '["\\u001b[31m"]')
    yield "an equation that calls", changed("-a*angle", "__import__('os').system('touch x')")
    yield "a deep equation", changed("-a*angle", "(" * 3000 + "a" + ")" * 3000)
    yield "an equation of itself", changed('angle = "rate"', 'angle = "angle + rate"')
    yield "plant and model", changed("[model]", 'plant = "pendulum"\n[model]')
    model = CONFIG[CONFIG.index("[model]") : CONFIG.index("[simulate]")]
    for plant in (
        "none.py:x",
        "/etc/passwd:x",
        "rig.toml:x",
        ":",
        "a:b:c",
        "os:system",
        "../x.py:y",
    ):
        yield f"plant {plant}", CONFIG.replace(model, f'plant = "{plant}"\n', 1).encode()
    sweep = '[sweep]\nobservers = [{{ kind = "second_order", gains = {{ c1 = {} }} }}]\n'
    for gains in ("{ low = 1.0, high = inf, count = 3 }", "{ low = nan, high = 2.0, count = 3 }",
                  "[]", "{ low = 1.0, high = 2.0, count = 1000000000000 }", '"x"'):  # fmt: skip
        yield f"gains {gains}", CONFIG.encode() + sweep.format(gains).encode()
    data = CONFIG[: CONFIG.index("[simulate]")]
    for file in ("none.csv", "/dev/zero", ".", "rig.toml", "a\\u0000b.csv", "x" * 5000):
        more = f'[data]\nfiles = ["{file}"]\ninputs = ["u"]\noutputs = ["y"]\ntime = "t"\n'
        yield f"data {file[:12]}", (data + more).encode()
    yield "no data, no simulation", data.encode()


def jsons(good: bytes, draw: random.Random) -> Iterator[tuple[str, bytes]]:
    """Models as JSON."""
    tree = json.loads(good)
    for i in range(20):
        yield f"changed {i}", json.dumps(mutated(tree, draw)).encode()
    for key in tree:
        yield f"without {key}", json.dumps({k: v for k, v in tree.items() if k != key}).encode()
    for form in (99, -1, "1", 1.5, None, True, [1], float("nan"), 10**30):
        yield f"format {form}", json.dumps({**tree, "format": form}).encode()
    yield "deep", b'{"kind":' * 9000 + b"1" + b"}" * 9000
    yield "a list", b"[1, 2]"
    yield "a long number", b'{"kind": ' + b"9" * 9000 + b"}"
    yield "surrogates", b'{"kind": "\\ud800", "format": 1}'


ODD = (None, True, 3, -1.5, 1e999, float("nan"), "", "x", ESCAPE, [], {}, [[]], {"a": {}}, 10**30,
       {"array": "a0"}, {"array": "none"}, {"class": "os:system", "fields": {}},
       {"class": "eoi_jax.cli.commands:main", "fields": {}}, {"function": "os:system"},
       {"path": "/etc/passwd"},
       {"effect": "x:y", "name": "x", "fields": {}}, {"tuple": [1, 2]}, {"list": 3}, {"dict": []},
       {"class": "eoi_jax._status:Status", "fields": {}},
       {"class": "eoi_jax._status:Status", "fields": {"code": 1, "message": []}})  # fmt: skip


def mutated(tree: object, draw: random.Random) -> object:
    """A tree with one to three parts replaced, left out, renamed or added."""
    tree = json.loads(json.dumps(tree))
    for _ in range(draw.randrange(1, 4)):
        parts = [one for one in _parts(tree) if one]
        if not parts:
            break
        part = draw.choice(parts)
        key = draw.choice(list(part) if isinstance(part, dict) else list(range(len(part))))
        change = draw.randrange(4)
        if change == 0:
            del part[key]
        elif change == 1 and isinstance(part, dict):
            part[draw.choice(("x", "class", "array", "fields", f"{key}s"))] = part.pop(key)
        elif change == 2 and isinstance(part, dict):
            part[draw.choice(("more", "dict", "fields"))] = draw.choice(ODD)
        else:
            part[key] = draw.choice(ODD)
    return tree


def _parts(tree: object) -> Iterator[dict | list]:
    waiting = [tree]
    while waiting:
        one = waiting.pop()
        if isinstance(one, dict | list):
            yield one
            waiting += one.values() if isinstance(one, dict) else one


# -- results ----------------------------------------------------------------------------------


def results(good: bytes, draw: random.Random, count: int) -> Iterator[tuple[str, bytes]]:
    """Stored results whose text or arrays are changed."""
    with np.load(io.BytesIO(good)) as file:
        arrays = dict(file)
    tree = json.loads(str(arrays.pop("eoi_jax")))

    def packed(text: object, kept: dict[str, np.ndarray]) -> bytes:
        stream = io.BytesIO()
        shown = text if isinstance(text, str) else json.dumps(text)
        np.savez(stream, allow_pickle=False, **{"eoi_jax": np.asarray(shown), **kept})
        return stream.getvalue()

    for i in range(count):
        yield f"tree changed {i}", packed(mutated(tree, draw), arrays)
    for i in range(count):
        key = draw.choice(list(arrays))
        old = arrays[key]
        new = draw.choice((
            old.astype(complex) if old.dtype.kind in "fiu" else np.zeros(3), old[..., None],
            np.full(old.shape, np.nan), np.asarray("text"), np.zeros(0), np.zeros((2, 3, 4)),
            old.ravel()[:-1], np.concatenate([old.ravel(), old.ravel()]),
            np.full(old.shape, 1e300), -np.ones(old.shape), old.astype("U") , old > 0,
        ))  # fmt: skip
        yield f"array changed {i}", packed(tree, {**arrays, key: new})
    for form in (99, 2, "3", 3.0, None, True, float("nan"), 10**30, []):
        yield f"format {form}", packed({**tree, "format": form}, arrays)
    yield "version 7", packed({**tree, "version": 7}, arrays)
    yield "no arrays", packed(tree, {})
    deep: str = '{"list": [' * 3000 + "1" + "]}" * 3000
    yield "3000 lists deep", packed('{"format": 3, "version": "0", "result": ' + deep + "}", arrays)
    yield "text that is no JSON", packed("{", arrays)
    yield (
        "an escape sequence for a class",
        packed({**tree, "result": {"class": ESCAPE, "fields": {}}}, {}),
    )
    yield "a list for a result", packed({**tree, "result": [1]}, arrays)


# -- the file system --------------------------------------------------------------------------


def places() -> Iterator[tuple[str, str, Callable[[Path], None]]]:
    """Names and places of files that are good in themselves."""
    good = content(GOOD)
    yield "a folder", "run.csv", lambda path: path.mkdir()
    yield "a link to itself", "run.csv", lambda path: path.symlink_to(path)
    yield "a link to nothing", "run.csv", lambda path: path.symlink_to("none")
    yield "a pipe", "run.csv", lambda path: os.mkfifo(path)
    yield "a device", "run.csv", lambda path: path.symlink_to("/dev/zero")
    yield "nothing there", "run.csv", lambda _: None
    yield "an escape sequence in its name", f"{ESCAPE.replace('/', '')}.csv", good
    yield "a line break in its name", "a\nb.csv", good
    yield "no UTF-8 in its name", os.fsdecode(b"r\xff\xfen.csv"), good
    yield "a quote in its name", "a\"b'c.csv", good
    yield "dots for a name", "....csv", good
    yield "an ending alone", ".csv", good
    yield "no ending", "run", good
    yield "an unknown ending", "run.doc", good
    yield "two endings", "run.csv.gz.csv", good
    yield "a long name", "x" * 240 + ".csv", good
    yield "capitals", "RUN.CSV", good


def bases(folder: Path) -> dict[str, bytes]:
    """A good file of every kind."""
    frame = pd.DataFrame({"t": T, "u": U, "y": Y})
    plain = {"t": T, "u": U, "y": Y}
    return {
        ".csv": GOOD.encode(),
        ".csv.gz": gzip.compress(GOOD.encode()),
        ".xlsx": written(lambda path: frame.to_excel(path, index=False), ".xlsx", folder),
        ".parquet": written(frame.to_parquet, ".parquet", folder),
        ".5.mat": written(lambda path: savemat(path, plain), ".mat", folder),
        ".5z.mat": written(lambda path: savemat(path, plain, do_compression=True), ".mat", folder),
        ".4.mat": written(lambda path: savemat(path, plain, format="4"), ".mat", folder),
        ".7.mat": written(hdf5(lambda _: None, True), ".mat", folder),
        ".h5": written(hdf5(lambda _: None, False), ".h5", folder),
        ".npz": written(lambda path: np.savez_compressed(path, t=T, u=U, y=Y), ".npz", folder),
    }


def cases(folder: Path, result: bytes, model: bytes) -> Iterator[Case]:
    """All of them, the same every time.

    Args:
        folder: where files may be made on the way.
        result: a stored result.
        model: a model as JSON.
    """
    draw = random.Random(30)
    for suffix, data in bases(folder).items():
        for name, raw in spoilt(data, draw):
            yield Case(f"*{suffix}", name, f"run{suffix}", content(raw))
    for name, raw in texts():
        yield Case("text", name, "run.csv", content(raw))
    yield Case(
        "text", "5 GB in 5 MB", "run.csv.gz", content(many_members(b"1,2,3\n" * 3_000_000, 280))
    )
    yield Case("text", "0.1 GB where 0.05 are allowed", "run.csv.gz",
               content(many_members(b"1,2\n" * 1_000_000, 25)), max_gigabytes=0.05)  # fmt: skip
    for name, raw in archives():
        yield Case("npz", name, "run.npz", content(raw))
    yield Case("npz", "5 GB in 5 MB", "run.npz", lambda path: _put(path, bomb(100, 50)))
    for matlab, kind, file in ((False, "hdf5", "run.h5"), (True, "mat 7.3", "run.mat")):
        for name, add in trees():
            yield Case(kind, name, file, hdf5(add, matlab))
    for name, raw in mats():
        yield Case("mat 5", name, "run.mat", content(raw))
    for name, values in savable():
        yield Case("mat 5", name, "run.mat", saved(values))
    for name, raw in sheets():
        yield Case("xlsx", name, "run.xlsx", content(raw))
    for name, frame in frames():
        yield Case("parquet", name, "run.parquet", lambda path, frame=frame: _parquet(path, frame))
    for name, file, make in places():
        yield Case("names and places", name, file, make)
    for name, raw in configs():
        yield Case("config", name, "rig.toml", content(raw), "config")
    for name, raw in (*jsons(model, draw), *spoilt(model, draw)):
        yield Case("model as JSON", name, "model.json", content(raw), "result")
    for name, raw in (*results(result, draw, 50), *spoilt(result, draw), *archives()):
        yield Case("result", name, "result.npz", content(raw), "result")
    yield Case(
        "result", "5 GB in 5 MB", "result.npz", lambda path: _put(path, bomb(100, 50)), "result"
    )
    for name, raw in (*results(result, draw, 15), *list(spoilt(result, draw))[:12]):
        yield Case("run", f"result: {name}", "run/result.npz", content(raw), "run")
    for file in ("result.json", "report.npz", "config.toml"):
        for name, raw in list(spoilt(result, draw))[:16]:
            yield Case("run", f"{file}: {name}", f"run/{file}", content(raw), "run")


def _parquet(path: Path, frame: pd.DataFrame) -> None:
    frame.columns = [str(one) for one in frame.columns]
    frame.to_parquet(path)
