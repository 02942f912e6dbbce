"""MAT files: matrices and structures, including structures saved from `iddata` and Simulink logs.

MATLAB's objects (``iddata``, ``timeseries``, ``Simulink.SimulationData.Dataset``) are stored in a
form that only MATLAB reads. Users can save their contents as structures. These are recognised:

* ``z = get(data)`` of an ``iddata``: `OutputData`, `InputData`, `Ts`, `SamplingInstants`, names and
  units of the channels, and `InterSample`. The columns have the names of the channels.
* "Structure With Time" of Simulink: `time` and `signals` with `values` and `label`.

Other structures give columns ``structure.field``.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from eoi_jax.data.readers.hdf5 import Walk
from eoi_jax.data.readers.limits import Allowance
from eoi_jax.data.readers.mat5_scan import check_sizes
from eoi_jax.data.readers.table import Columns, Table, add_columns

_SAVE = {
    "iddata": "z = get({name}); save('run.mat', '-struct', 'z')",
    "timeseries": "time = {name}.Time; data = squeeze({name}.Data); "
    "save('run.mat', 'time', 'data')",
    "timetable": "time = seconds({name}.Properties.RowTimes - {name}.Properties.RowTimes(1)); "
    "data = {name}.Variables; save('run.mat', 'time', 'data')",
    "table": "data = table2struct({name}, 'ToScalar', true); save('run.mat', '-struct', 'data')",
    "Dataset": "time = {name}{{1}}.Values.Time; data = squeeze({name}{{1}}.Values.Data); "
    "save('run.mat', 'time', 'data')",
}
_HOLD_OF_INTERSAMPLE = {"zoh": "zero", "foh": "linear", "bl": "smooth"}
_SAVE_OBJECT = "s = struct({name}); save('run.mat', '-struct', 's')"


@dataclass
class _Contents:
    """Contents of a file, collected while its variables are walked through."""

    allowance: Allowance
    columns: Columns = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    objects: dict[str, str] = field(default_factory=dict)
    time: str | None = None
    inputs: list[str] = field(default_factory=list)
    outputs: list[str] = field(default_factory=list)
    holds: dict[str, str] = field(default_factory=dict)


def read_mat(path: Path, allowance: Allowance) -> Table:
    """The columns of a MAT file of any version.

    Args:
        path: of the file.
        allowance: bytes that the file may unpack to.

    Raises:
        ValueError: a file that holds only objects of MATLAB (the message has the MATLAB code that
            saves their contents), or that unpacks to more than is allowed.
    """
    import h5py
    from scipy.io import loadmat

    contents = _Contents(allowance)
    if h5py.is_hdf5(path):  # version 7.3
        content = _from_hdf5(path, allowance, contents.notes)
    else:
        check_sizes(path, allowance)
        content = loadmat(path, simplify_cells=True)
    _walk({key: value for key, value in content.items() if not key.startswith("__")}, "", contents)
    if not contents.columns and contents.objects:
        raise ValueError(" ".join(contents.objects.values()))
    return Table(
        contents.columns,
        contents.units,
        tuple(contents.notes),
        contents.objects,
        contents.time,
        tuple(contents.inputs),
        tuple(contents.outputs),
        contents.holds,
    )


def _walk(content: Mapping[str, Any], prefix: str, contents: _Contents) -> None:
    """Collect the arrays of nested structures."""
    if _has_values(content, "OutputData") and _has_values(content, "Ts", "SamplingInstants"):
        _add_iddata(content, prefix, contents)
        return
    if _has_values(content, "signals") and "time" in content:
        _add_log(content, prefix, contents)
        return
    for key, value in content.items():
        name = prefix + key
        kind = _class_of(value)
        if kind is not None:
            label = _stored_name(value) or name
            contents.objects[label] = _advice(label, kind)
        elif hasattr(value, "toarray"):  # a sparse matrix
            contents.allowance.take(8.0 * float(value.shape[0]) * float(value.shape[1]))
            add_columns(contents.columns, contents.notes, name, value.toarray())
        elif isinstance(value, Mapping):
            _walk(value, f"{name}.", contents)
        elif isinstance(value, list) and any(isinstance(element, Mapping) for element in value):
            for i, element in enumerate(value):  # an array of structures, numbered like columns
                if isinstance(element, Mapping):
                    _walk(element, f"{name}[{i}].", contents)
        else:
            add_columns(contents.columns, contents.notes, name, _array(value))


def _has_values(content: Mapping[str, Any], *names: str) -> bool:
    return any(name in content and np.size(content[name]) > 0 for name in names)


# -- iddata -------------------------------------------------------------------------------


def _add_iddata(content: Mapping[str, Any], prefix: str, contents: _Contents) -> None:
    """Add the channels of an experiment, by their names, and its time."""
    variable = prefix.rstrip(".") or "iddata"
    outputs, inputs = _single(content["OutputData"]), _single(content.get("InputData", []))
    if outputs is None or inputs is None:
        contents.objects[variable] = (
            f"`{variable}` holds several experiments of an iddata object; save each in its own "
            "file: z = get(getexp(data, 1)); save('run1.mat', '-struct', 'z')."
        )
        return
    count = len(_matrix(outputs))
    for kind, values, names in (
        ("Input", inputs, contents.inputs),
        ("Output", outputs, contents.outputs),
    ):
        matrix = _matrix(values, count)
        labels = _texts(
            content.get(f"{kind}Name"),
            matrix.shape[1],
            kind[0].lower().replace("i", "u").replace("o", "y"),
        )
        units = _texts(content.get(f"{kind}Unit"), matrix.shape[1], "")
        for label, unit, column in zip(labels, units, matrix.T, strict=True):
            name = prefix + label
            contents.columns[name] = column
            names.append(name)
            if unit:
                contents.units[name] = unit
    contents.holds |= _holds(content.get("InterSample"), contents.inputs)
    stamps = _single(content.get("SamplingInstants", []))
    period, start = _single(content.get("Ts", [])), _single(content.get("Tstart", []))
    time = f"{prefix}time"
    if np.size(stamps) == count:
        contents.columns[time] = np.asarray(stamps, dtype=float).ravel()
    elif np.size(period) == 1 and float(np.ravel(period)[0]) > 0:
        first = float(np.ravel(start)[0]) if np.size(start) else 0.0
        contents.columns[time] = first + float(np.ravel(period)[0]) * np.arange(count)
    else:
        return
    contents.time = time
    unit = _texts(content.get("TimeUnit"), 1, "s")[0]
    contents.units[time] = {"seconds": "s", "milliseconds": "ms"}.get(unit, unit)
    contents.notes.append(
        f"`{variable}` is read as an iddata object: inputs, outputs and time by name."
    )


def _holds(intersample: Any, inputs: list[str]) -> dict[str, str]:
    """The hold of each input by its column; nothing where that of any is not known."""
    texts = [intersample] * len(inputs) if isinstance(intersample, str) else intersample
    words = [_HOLD_OF_INTERSAMPLE.get(text, "") for text in _texts(texts, len(inputs), "")]
    return dict(zip(inputs, words, strict=True)) if all(words) else {}


def _single(value: Any) -> Any:
    """The entry of a cell with a single entry; None if there are several."""
    if isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype == object):
        return None if len(value) > 1 else value[0] if len(value) else []
    return value


def _matrix(values: Any, count: int | None = None) -> np.ndarray:
    """Channels as columns; `count` samples tell a row of channels from a single channel."""
    array = np.asarray(values)
    if array.dtype.kind == "c":
        raise ValueError("its iddata object is complex; save its real and imaginary parts apart")
    array = array.astype(float)
    if array.size == 0:
        return np.zeros((count or 0, 0))
    if array.ndim < 2:
        array = array.reshape(-1, 1)
    return array.T if count is not None and len(array) != count else array


def _texts(value: Any, count: int, default: str) -> list[str]:
    """Names or units, stored as a text, a cell of texts, or not at all."""
    texts = [value] if isinstance(value, str) else [] if value is None else np.ravel(value).tolist()
    if len(texts) == count and all(isinstance(text, str) for text in texts):
        return texts
    if not default or count == 1:
        return [default] * count
    return [f"{default}{i + 1}" for i in range(count)]


# -- logs of Simulink ---------------------------------------------------------------------


def _add_log(content: Mapping[str, Any], prefix: str, contents: _Contents) -> None:
    """Add the signals of a structure with time, by their labels."""
    signals = content["signals"]
    signals = [signals] if isinstance(signals, Mapping) else list(signals)
    if np.size(content["time"]):
        contents.columns[f"{prefix}time"] = np.ravel(np.asarray(content["time"], dtype=float))
        contents.time = f"{prefix}time"
    else:
        contents.notes.append(
            f"`{prefix.rstrip('.')}` has no time: choose the format Structure With Time, or give "
            "a sample period."
        )
    labels = [
        str(signal.get("label", "")) if np.size(signal.get("label", "")) else ""
        for signal in signals
    ]
    unique = all(labels) and len(set(labels)) == len(labels)
    for i, (signal, label) in enumerate(zip(signals, labels, strict=True)):
        default = "signals.values" if len(signals) == 1 else f"signals[{i}].values"
        name = prefix + (label if unique and label else default)
        add_columns(contents.columns, contents.notes, name, _array(signal.get("values", [])))


# -- objects ------------------------------------------------------------------------------


def _class_of(value: Any) -> str | None:
    """The class of an object of MATLAB; None for any other value."""
    if isinstance(value, _Opaque):
        return value.kind
    names = getattr(getattr(value, "dtype", None), "names", None) or ()
    for key in ("s2", "_Class"):  # of scipy's MatlabOpaque, before and since version 1.18
        if key in names:
            return _text(value[key])
    return None


def _stored_name(value: Any) -> str | None:
    names = getattr(getattr(value, "dtype", None), "names", None) or ()
    return _text(value["s0"]) if "s0" in names else None


def _text(cell: Any) -> str:
    entry = np.ravel(cell)[0]
    return entry.decode(errors="replace") if isinstance(entry, bytes) else str(entry)


def _advice(name: str, kind: str) -> str:
    line = _SAVE.get(kind.rsplit(".", 1)[-1], _SAVE_OBJECT).format(name=name)
    return (
        f"`{name}` is an object of MATLAB's class {kind}, which only MATLAB reads; save its "
        f"contents there: {line}"
    )


@dataclass(frozen=True)
class _Opaque:
    kind: str


# -- version 7.3 --------------------------------------------------------------------------


def _from_hdf5(path: Path, allowance: Allowance, notes: list[str]) -> dict[str, Any]:
    """The nested dictionary that `scipy.io.loadmat` returns for older versions."""
    import h5py

    with h5py.File(path, "r") as file:
        walk = Walk(file, allowance, notes)
        members = walk.members(file, "")
        return {
            key: _item(file, key, member, walk)
            for key, member in members
            if not key.startswith("#")
        }


def _item(file: Any, name: str, item: Any, walk: Walk) -> Any:
    import h5py

    if isinstance(item, h5py.Group):
        members = walk.members(item, f"{name}.")
        return {key: _item(file, f"{name}.{key}", member, walk) for key, member in members}
    if not isinstance(item, h5py.Dataset):
        return np.zeros(0)
    kind = item.attrs.get("MATLAB_class", b"")
    kind = kind.decode(errors="replace") if isinstance(kind, bytes) else str(kind)
    if "MATLAB_object_decode" in item.attrs and kind not in ("", "char", "cell", "struct"):
        return _Opaque(kind)
    if item.attrs.get("MATLAB_empty", 0):
        return "" if kind == "char" else np.zeros(0)
    values = walk.values(name, item)
    if values is None:
        return np.zeros(0)
    if kind == "char" and values.dtype.kind in "iu":
        return values.T.astype("<u4").tobytes().decode("utf-32-le", errors="replace")
    if h5py.check_ref_dtype(values.dtype) is not None:  # a cell
        cells = [file[reference] if reference else None for reference in values.T.ravel()]
        return [
            _item(file, f"{name}{{{i + 1}}}", cell, walk)
            if cell is not None and walk.is_new(cell)
            else np.zeros(0)
            for i, cell in enumerate(cells)
        ]
    if values.dtype.names is not None and set(values.dtype.names) == {"real", "imag"}:
        return (values["real"] + 1j * values["imag"]).T
    return values.T


# -- columns ------------------------------------------------------------------------------


def _array(value: Any) -> np.ndarray:
    if isinstance(value, list):
        return _cell(value)
    return np.asarray(value)


def _cell(entries: list[Any]) -> np.ndarray:
    """Vectors of equal length as the columns of a matrix, numbers and texts as a column."""
    arrays = [np.squeeze(array) if isinstance(array, np.ndarray) else array for array in entries]
    lengths = {array.shape if isinstance(array, np.ndarray) else () for array in arrays}
    if len(lengths) == 1 and all(np.ndim(array) < 2 for array in arrays):
        kinds = {np.asarray(array).dtype.kind for array in arrays}
        if kinds <= set("biufc"):
            return np.stack([np.asarray(array) for array in arrays], axis=-1)
    values = np.empty(len(arrays), dtype=object)
    for i, array in enumerate(arrays):
        values[i] = array if isinstance(array, str) else f"an entry of shape {np.shape(array)}"
    return values
