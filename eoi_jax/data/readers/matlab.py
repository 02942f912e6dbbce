"""MAT files: matrices and structures; structures that stand for `iddata`, or a log of Simulink.

MATLAB's objects (``iddata``, ``timeseries``, ``Simulink.SimulationData.Dataset``) are stored in a
form that only MATLAB reads. What users can do is save what is in them as a structure, and these are
recognised here:

* ``z = get(data)`` of an ``iddata``: `OutputData`, `InputData`, `Ts`, `SamplingInstants`, and names
  and units of the channels. Its columns are called as its channels are.
* "Structure With Time" of Simulink: `time` and `signals` with `values` and `label`.

Everything else is ``structure.field``.
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
_OTHER = "s = struct({name}); save('run.mat', '-struct', 's')"


@dataclass
class _Found:
    """What a walk through a file's variables collects."""

    allowance: Allowance
    columns: Columns = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    objects: dict[str, str] = field(default_factory=dict)
    time: str | None = None
    inputs: list[str] = field(default_factory=list)
    outputs: list[str] = field(default_factory=list)


def read_mat(path: Path, allowance: Allowance) -> Table:
    """The columns of a MAT file of any version.

    Args:
        path: of the file.
        allowance: bytes that it may unpack to.

    Raises:
        ValueError: it holds nothing but objects of MATLAB; the message has the line that saves
            what is in them. It unpacks to more than is allowed.
    """
    import h5py
    from scipy.io import loadmat

    found = _Found(allowance)
    if h5py.is_hdf5(path):  # version 7.3
        content = _from_hdf5(path, allowance, found.notes)
    else:
        check_sizes(path, allowance)
        content = loadmat(path, simplify_cells=True)
    _walk({key: value for key, value in content.items() if not key.startswith("__")}, "", found)
    if not found.columns and found.objects:
        raise ValueError(" ".join(found.objects.values()))
    return Table(
        found.columns,
        found.units,
        tuple(found.notes),
        found.objects,
        found.time,
        tuple(found.inputs),
        tuple(found.outputs),
    )


def _walk(content: Mapping[str, Any], prefix: str, found: _Found) -> None:
    """Collect the arrays of nested structures."""
    if _has(content, "OutputData") and _has(content, "Ts", "SamplingInstants"):
        _add_iddata(content, prefix, found)
        return
    if _has(content, "signals") and "time" in content:
        _add_log(content, prefix, found)
        return
    for key, value in content.items():
        name = prefix + key
        kind = _class_of(value)
        if kind is not None:
            own, kind = (_own_name(value) or name), kind
            found.objects[own] = _advice(own, kind)
        elif hasattr(value, "toarray"):  # a sparse matrix
            found.allowance.take(8.0 * float(value.shape[0]) * float(value.shape[1]))
            add_columns(found.columns, found.notes, name, value.toarray())
        elif isinstance(value, Mapping):
            _walk(value, f"{name}.", found)
        elif isinstance(value, list) and any(isinstance(one, Mapping) for one in value):
            for i, one in enumerate(value):  # an array of structures, counted as columns are
                if isinstance(one, Mapping):
                    _walk(one, f"{name}[{i}].", found)
        else:
            add_columns(found.columns, found.notes, name, _array(value))


def _has(content: Mapping[str, Any], *names: str) -> bool:
    return any(name in content and np.size(content[name]) > 0 for name in names)


# -- iddata -------------------------------------------------------------------------------


def _add_iddata(content: Mapping[str, Any], prefix: str, found: _Found) -> None:
    """The channels of one experiment, by their names, and its time."""
    whole = prefix.rstrip(".") or "iddata"
    outputs, inputs = _only(content["OutputData"]), _only(content.get("InputData", []))
    if outputs is None or inputs is None:
        found.objects[whole] = (
            f"`{whole}` holds several experiments of an iddata object; save one of them a file: "
            "z = get(getexp(data, 1)); save('run1.mat', '-struct', 'z')."
        )
        return
    count = len(_matrix(outputs))
    for kind, values, names in (
        ("Input", inputs, found.inputs),
        ("Output", outputs, found.outputs),
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
            found.columns[name] = column
            names.append(name)
            if unit:
                found.units[name] = unit
    stamps = _only(content.get("SamplingInstants", []))
    period, start = _only(content.get("Ts", [])), _only(content.get("Tstart", []))
    time = f"{prefix}time"
    if np.size(stamps) == count:
        found.columns[time] = np.asarray(stamps, dtype=float).ravel()
    elif np.size(period) == 1 and float(np.ravel(period)[0]) > 0:
        first = float(np.ravel(start)[0]) if np.size(start) else 0.0
        found.columns[time] = first + float(np.ravel(period)[0]) * np.arange(count)
    else:
        return
    found.time = time
    unit = _texts(content.get("TimeUnit"), 1, "s")[0]
    found.units[time] = {"seconds": "s", "milliseconds": "ms"}.get(unit, unit)
    found.notes.append(f"`{whole}` is read as an iddata object: inputs, outputs and time by name.")


def _only(value: Any) -> Any:
    """What a cell of one entry holds; None of several."""
    if isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype == object):
        return None if len(value) > 1 else value[0] if len(value) else []
    return value


def _matrix(values: Any, count: int | None = None) -> np.ndarray:
    """Channels as columns; a single sample row of several channels is told from one channel."""
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
    """Names or units as MATLAB keeps them: a text, a cell of texts, or nothing."""
    texts = [value] if isinstance(value, str) else [] if value is None else np.ravel(value).tolist()
    if len(texts) == count and all(isinstance(one, str) for one in texts):
        return texts
    if not default or count == 1:
        return [default] * count
    return [f"{default}{i + 1}" for i in range(count)]


# -- logs of Simulink ---------------------------------------------------------------------


def _add_log(content: Mapping[str, Any], prefix: str, found: _Found) -> None:
    """The signals of a structure with time, by their labels."""
    signals = content["signals"]
    signals = [signals] if isinstance(signals, Mapping) else list(signals)
    if np.size(content["time"]):
        found.columns[f"{prefix}time"] = np.ravel(np.asarray(content["time"], dtype=float))
        found.time = f"{prefix}time"
    else:
        found.notes.append(
            f"`{prefix.rstrip('.')}` has no time: choose the format Structure With Time, or give "
            "a sample period."
        )
    labels = [str(one.get("label", "")) if np.size(one.get("label", "")) else "" for one in signals]
    unique = all(labels) and len(set(labels)) == len(labels)
    for i, (one, label) in enumerate(zip(signals, labels, strict=True)):
        other = "signals.values" if len(signals) == 1 else f"signals[{i}].values"
        name = prefix + (label if unique and label else other)
        add_columns(found.columns, found.notes, name, _array(one.get("values", [])))


# -- objects ------------------------------------------------------------------------------


def _class_of(value: Any) -> str | None:
    """The class of an object of MATLAB; None of anything else."""
    if isinstance(value, _Opaque):
        return value.kind
    names = getattr(getattr(value, "dtype", None), "names", None) or ()
    for key in ("s2", "_Class"):  # of scipy's MatlabOpaque, before and since version 1.18
        if key in names:
            return _text(value[key])
    return None


def _own_name(value: Any) -> str | None:
    names = getattr(getattr(value, "dtype", None), "names", None) or ()
    return _text(value["s0"]) if "s0" in names else None


def _text(cell: Any) -> str:
    one = np.ravel(cell)[0]
    return one.decode(errors="replace") if isinstance(one, bytes) else str(one)


def _advice(name: str, kind: str) -> str:
    line = _SAVE.get(kind.rsplit(".", 1)[-1], _OTHER).format(name=name)
    return (
        f"`{name}` is an object of MATLAB's class {kind}, which only MATLAB reads; save what is "
        f"in it there: {line}"
    )


@dataclass(frozen=True)
class _Opaque:
    kind: str


# -- version 7.3 --------------------------------------------------------------------------


def _from_hdf5(path: Path, allowance: Allowance, notes: list[str]) -> dict[str, Any]:
    """The same nested dictionary that scipy makes of the older versions."""
    import h5py

    with h5py.File(path, "r") as file:
        walk = Walk(file, allowance, notes)
        members = walk.members(file, "")
        return {key: _item(file, key, one, walk) for key, one in members if not key.startswith("#")}


def _item(file: Any, name: str, item: Any, walk: Walk) -> Any:
    import h5py

    if isinstance(item, h5py.Group):
        members = walk.members(item, f"{name}.")
        return {key: _item(file, f"{name}.{key}", one, walk) for key, one in members}
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
        cells = [file[one] if one else None for one in values.T.ravel()]
        return [_item(file, f"{name}{{{i + 1}}}", one, walk) if one is not None and walk.is_new(one)
                else np.zeros(0) for i, one in enumerate(cells)]  # fmt: skip
    if values.dtype.names is not None and set(values.dtype.names) == {"real", "imag"}:
        return (values["real"] + 1j * values["imag"]).T
    return values.T


# -- columns ------------------------------------------------------------------------------


def _array(value: Any) -> np.ndarray:
    if isinstance(value, list):
        return _cell(value)
    return np.asarray(value)


def _cell(entries: list[Any]) -> np.ndarray:
    """Vectors of one length as the columns of a matrix, numbers and texts as a column."""
    arrays = [np.squeeze(one) if isinstance(one, np.ndarray) else one for one in entries]
    lengths = {one.shape if isinstance(one, np.ndarray) else () for one in arrays}
    if len(lengths) == 1 and all(np.ndim(one) < 2 for one in arrays):
        kinds = {np.asarray(one).dtype.kind for one in arrays}
        if kinds <= set("biufc"):
            return np.stack([np.asarray(one) for one in arrays], axis=-1)
    values = np.empty(len(arrays), dtype=object)
    for i, one in enumerate(arrays):
        values[i] = one if isinstance(one, str) else f"an entry of shape {np.shape(one)}"
    return values
