"""The store of a sweep's chunks: Zarr, on disk or in memory.

A chunk of a sweep is one chunk of every array, with Zarr's checksum. Its mark in ``done``
(`marks.py`) is written last, when the arrays are on the disk. A store belongs to one sweep, by its
fingerprint; metadata that cannot be read are written again from the plan, with a warning.
"""

import json
import shutil
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from eoi_jax._atomic import fsync, sweep_up, write_file, write_folder
from eoi_jax._checks import StoreWarning, check, counted, is_or_are
from eoi_jax.estimation.sweep.chunk import CODES, OK, Arrays
from eoi_jax.estimation.sweep.marks import Chunks, Condition, Place, digest
from eoi_jax.estimation.sweep.plan import DIMENSIONS, Plan

_FORMAT = 4  # number of the layout of a store; no other one is read
_LABELS = "eoi_jax"
_RESUME = "The same sweep with this store computes what is missing."
_NOT_RUN = {"f": np.nan, "i": 0}  # values of a lane that has not run


@dataclass(frozen=True)
class Labels:
    """Coordinates and attributes of a sweep.

    Attributes:
        texts: dimension and values by name.
        numbers: dimensions and array by name.
        kinds: names for the numbers of the coordinate ``kind``; empty without it.
        attributes: that JSON can hold.
    """

    texts: dict[str, tuple[str, list[str]]]
    numbers: dict[str, tuple[tuple[str, ...], np.ndarray]]
    kinds: list[str]
    attributes: dict[str, Any]


class Store:
    """Arrays of a sweep over its lanes.

    Args:
        plan: of the sweep.
        path: folder; None for memory.
        labels: for `dataset`.

    Raises:
        ValueError: the folder is something else, or belongs to another sweep or version.
        OSError: it cannot be written.
    """

    def __init__(self, plan: Plan, path: str | Path | None, labels: Labels):
        self._plan = plan
        self._path = None if path is None else Path(path)
        import zarr.storage  # slow to import, like xarray below, and only needed here

        if self._path is None:
            self._store: Any = zarr.storage.MemoryStore()
            _create(self._store, plan, labels)
        else:
            if not self._path.exists():
                write_folder(self._path, lambda new: _create(str(new), plan, labels), keep=True)
            self._store = str(self._path)
            _check(self._path, plan)
            _mend(self._path, plan, labels)
        self._root: Any = zarr.open_group(self._store, mode="r+")
        self._chunks = Chunks(self._root, list(_ARRAYS), plan.fingerprint, self._path)

    def unfinished(self, places: Iterable[Place]) -> list[Place]:
        """Chunks that have to be computed.

        Files that a killed process left in them, and damaged files, are removed.

        Warns:
            StoreWarning: how many chunks were damaged.
        """
        places = list(places)
        if self._path is None:
            return places
        sweep_up(self._path.parent)
        conditions = {place: self._chunks.condition(place) for place in places}
        unfinished = [
            place for place, condition in conditions.items() if condition is not Condition.INTACT
        ]
        damaged = [place for place in unfinished if conditions[place] is Condition.DAMAGED]
        for place in unfinished:
            self._clear(place, place in damaged)
        if damaged:
            number = f"{len(damaged)} of {counted(len(places), 'chunk')}"
            verb = is_or_are(len(damaged))
            message = f"{number} of the store {self._path} {verb} damaged, and computed again"
            warnings.warn(message, StoreWarning, stacklevel=3)
        return unfinished

    def write(self, place: Place, arrays: Arrays) -> None:
        """Write a chunk, then its mark."""
        region = self._plan.region(place)
        stored = {name: arrays[name].astype(_ARRAYS[name][0]) for name in _ARRAYS}
        for name, values in stored.items():
            self._root[name][region] = values[None, None]
        self._settle(place, _ARRAYS)
        self._root["done"][place] = digest(self._plan.fingerprint, place, stored)
        self._settle(place, ["done"])

    def mark_lost(self, place: Place) -> None:
        """Give the lanes of a chunk the status ``lost``; a resumed sweep computes it again."""
        self._root["status"][self._plan.region(place)] = CODES.index("lost")

    def _settle(self, place: Place, names: Iterable[str]) -> None:
        """Flush the files of a chunk to the disk; a chunk of fill values only has no file."""
        files = self._chunks.files(place)
        for path in (files[name] for name in names if name in files):
            fsync(path)
            fsync(path.parent)

    def _clear(self, place: Place, damaged: bool) -> None:
        """Remove files that a killed process left beside those of a chunk, and damaged files."""
        for path in self._chunks.files(place).values():
            if damaged:
                _remove(path)
            # Zarr's name for a file that is not yet in place; only this job writes the chunk.
            for leftover in path.parent.glob(f"{path.name}.*.partial"):
                _remove(leftover)
            for folder in path.parents:  # a file in the place of a folder
                if folder == self._path:
                    break
                if folder.is_file():
                    folder.unlink()

    def dataset(self, outcome: dict[str, Any] | None = None) -> Any:
        """The labelled dataset; values are read from disk when they are used.

        Args:
            outcome: more attributes.
        """
        opened = open_sweep(self._store)
        opened = opened.load() if self._path is None else opened
        return opened.assign_attrs(outcome or {})


def open_sweep(path: Any) -> Any:
    """A sweep's store as a labelled dataset; values are read when they are used.

    Every chunk is read once and compared with its mark.

    Args:
        path: of the store.

    Returns:
        The `xarray.Dataset` that `eoi_jax.sweep` returned, or would return now. Damaged chunks are
        ``not_run``; `eoi_jax.sweep` with this store computes them again.

    Raises:
        ValueError: the store does not exist, is not of a sweep, or its metadata are damaged.

    Warns:
        StoreWarning: how many chunks are damaged.
    """
    if isinstance(path, str | Path):
        check(Path(path).exists(), "store", "must exist", path)
        check(
            _labels(Path(path)) is not None, "store", "must be the store of a sweep", path, _RESUME
        )
    try:
        return _labelled(path)
    except Exception as error:  # of the disk, a codec or Zarr: they have no common class
        reason = f"{path}, which does not read: {error}"
        check(False, "store", "must be whole", reason, _RESUME)
        raise


def _labelled(path: Any) -> Any:
    import xarray as xr
    import zarr

    raw = xr.open_zarr(path, consolidated=False, chunks=None)
    labels = json.loads(raw.attrs[_LABELS])
    raw = raw.assign(_without_damage(zarr.open_group(path, mode="r"), labels["sweep"], path))
    lanes = raw[list(_ARRAYS)].drop_vars(labels["numbers"], errors="ignore")
    # One by one: a store lists its arrays in arbitrary order.
    coordinates = {name: raw[name].variable.load() for name in labels["numbers"]}
    lanes = lanes.assign_coords(coordinates)
    if labels["kinds"]:
        names = np.asarray(labels["kinds"])
        lanes = lanes.assign_coords(kind=("observer", names[lanes["kind"].values]))
    lanes = lanes.assign_coords(
        {name: (dim, np.asarray(values)) for name, (dim, values) in labels["texts"].items()}
    )
    lanes["status"].attrs.update(flag_values=list(range(len(CODES))), flag_meanings=" ".join(CODES))
    ok = lanes["status"].isin(OK)
    attributes = {key: labels[key] for key in ("version", "sweep")} | labels["attributes"]
    data = lanes.assign(ok=ok.assign_attrs(long_name="whether the lane has an answer"))
    return data.drop_attrs(deep=False).assign_attrs(attributes)


def _without_damage(root: Any, sweep: str, path: Any) -> dict[str, Any]:
    """Arrays in memory, with damaged chunks filled as if not run; empty without damage."""
    folder = Path(path) if isinstance(path, str | Path) else None
    chunks = Chunks(root, list(_ARRAYS), sweep, folder)
    places = list(chunks)
    sound = [place for place in places if chunks.condition(place) is not Condition.DAMAGED]
    if len(sound) == len(places):
        return {}
    damaged = len(places) - len(sound)
    number, verb = f"{damaged} of {counted(len(places), 'chunk')}", is_or_are(damaged)
    message = f"{number} of the store {path} {verb} damaged, and shown as not_run. {_RESUME}"
    warnings.warn(message, StoreWarning, stacklevel=4)
    arrays = {
        name: np.full(root[name].shape, _NOT_RUN[kind[0]], kind)
        for name, (kind, _, _) in _ARRAYS.items()
    }
    for place in sound:
        for name, values in chunks.read(place).items():
            arrays[name][chunks.region(place)] = values
    return {name: (DIMENSIONS + _ARRAYS[name][1], values) for name, values in arrays.items()}


def _version() -> str:
    return version("eoi_jax")


def _create(store: Any, plan: Plan, labels: Labels) -> None:
    import zarr
    from zarr.codecs import Crc32cCodec, ZstdCodec

    root = zarr.open_group(store, mode="w")
    checked = (ZstdCodec(), Crc32cCodec())
    sizes = {"pass": plan.settings.passes, "output": len(plan.plant.outputs)}
    sizes["parameter"] = len(plan.plant.names)
    for name, (kind, extra, long_name) in _ARRAYS.items():
        tail = tuple(sizes[dimension] for dimension in extra)
        root.create_array(
            name,
            shape=plan.shape + tail,
            chunks=plan.steps + tail,
            dtype=kind,
            fill_value=_NOT_RUN[kind[0]],
            compressors=checked,
            dimension_names=DIMENSIONS + extra,
            attributes={"long_name": long_name},
        )
    identity = {"format": _FORMAT, "sweep": plan.fingerprint, "version": _version()}
    root.create_array(
        "done",
        shape=plan.grid,
        chunks=(1,) * 5,
        dtype="u8",
        fill_value=0,
        compressors=checked,
        dimension_names=tuple(f"{dimension}_chunk" for dimension in DIMENSIONS),
        attributes={_LABELS: json.dumps(identity)},  # again, should those of the group be lost
    )
    for name, (dims, values) in labels.numbers.items():
        root.create_array(
            name, data=values, chunks=values.shape, compressors=checked, dimension_names=dims
        )
    texts = {
        **identity,
        "texts": labels.texts,
        "numbers": list(labels.numbers),
        "kinds": labels.kinds,
        "attributes": labels.attributes,
    }
    root.attrs[_LABELS] = json.dumps(texts)


_ARRAYS: dict[str, tuple[str, tuple[str, ...], str]] = {
    "parameters": ("f8", ("parameter",), "estimate"),
    "standard_error": ("f8", ("parameter",), "standard error, of coloured residuals"),
    "index": ("f8", ("pass", "output"), "index P of each pass, eq. (14)"),
    "common_index": ("f8", ("output",), "index of the estimate, one observer and filter for all"),
    "sliding_fraction": ("f8", ("output",), "share of scored steps in sliding, best pass"),
    "status": ("i1", (), "how the lane ended"),
    "blocks": ("i4", (), "complete blocks of scores, of which errors and resamples are made"),
    "best_pass": ("i2", (), "pass of the estimate, from 0"),
    "passes": ("i2", (), "passes taken"),
}


def _labels(path: Path) -> dict[str, Any] | None:
    """Labels of the group of a store; None if they cannot be read, or are not of a sweep."""
    import zarr

    try:
        return _identified(zarr.open_group(str(path), mode="r"))
    except Exception:  # of the disk, JSON or Zarr: they have no common class
        return None


def _identified(node: Any) -> dict[str, Any]:
    """Labels of a group or an array that name format, version and sweep."""
    labels = json.loads(node.attrs[_LABELS])
    return labels | {key: labels[key] for key in ("format", "version", "sweep")}


def _identity(path: Path) -> dict[str, Any] | None:
    """Format, version and sweep of a store, from ``done`` if the group's attributes are lost."""
    import zarr

    try:
        return _labels(path) or _identified(zarr.open_array(str(path / "done"), mode="r"))
    except Exception:  # as in `_labels`
        return None


def _mend(path: Path, plan: Plan, labels: Labels) -> None:
    """Write damaged attributes, metadata and coordinates again from the plan.

    Warns:
        StoreWarning: what was damaged.
    """
    import zarr.storage

    contents: dict[str, Any] = {}  # in memory: a process that is killed leaves nothing
    sound = zarr.storage.MemoryStore(contents)
    _create(sound, plan, labels)
    damaged = [
        name
        for name in ("", "done", *_ARRAYS, *labels.numbers)
        if not _is_intact(path / name, sound, name, name in labels.numbers)
    ]
    for name in damaged:
        sweep_up(path / name)
        metadata = f"{name}/zarr.json".lstrip("/")
        for key in [key for key in contents if key.startswith(f"{name}/")] or [metadata]:
            if key == metadata or name in labels.numbers:
                _replace(path, Path(key), contents[key].to_bytes())
    if damaged:
        names = ", ".join(f"`{name}`" if name else "attributes" for name in damaged)
        message = f"{names} of the store {path} were damaged, and are written anew"
        warnings.warn(message, StoreWarning, stacklevel=4)


def _is_intact(node: Path, sound: Any, name: str, values: bool) -> bool:
    """Whether a group or an array can be read and has the expected metadata, and `values`."""
    import zarr

    try:
        stored = zarr.open(str(node), mode="r")
        expected = zarr.open(sound, path=name, mode="r")
        if isinstance(expected, zarr.Group):
            return isinstance(stored, zarr.Group) and dict(stored.attrs) == dict(expected.attrs)
        if (
            not isinstance(stored, zarr.Array)
            or stored.metadata.to_dict() != expected.metadata.to_dict()
        ):
            return False
        if not values:
            return True
        a, b = np.asarray(stored[...]), np.asarray(expected[...])
        return np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    except Exception:  # of the disk, JSON, a codec or Zarr: they have no common class
        return False


def _replace(path: Path, place: Path, content: bytes) -> None:
    """Put a file into a store, replacing files and folders in its way."""
    for parent in reversed(place.parents):
        if (path / parent).is_file():
            (path / parent).unlink()
    goal = path / place
    if goal.is_dir():
        shutil.rmtree(goal)
    goal.parent.mkdir(parents=True, exist_ok=True)

    def write(draft: Path) -> None:
        draft.write_bytes(content)

    write_file(goal, write)


def _remove(path: Path) -> None:
    """Remove a file or a folder, if it exists."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    elif not any(parent.is_file() for parent in path.parents):
        path.unlink(missing_ok=True)


def _check(path: Path, plan: Plan) -> None:
    identity = _identity(path)
    check(identity is not None, "store", "must be the store of a sweep, or not exist", path)
    assert identity is not None
    check(
        identity["format"] == _FORMAT,
        "store",
        f"must have been written in format {_FORMAT}",
        f"{path}: format {identity['format']}, of eoi_jax {identity['version']}",
        "Give another folder, or resume with that version.",
    )
    check(
        identity["version"] == _version(),
        "store",
        f"must have been written by this version, {_version()}: its numbers would not compare",
        f"{path}: of eoi_jax {identity['version']}",
        "Give another folder, or resume with that version.",
    )
    check(
        identity["sweep"] == plan.fingerprint,
        "store",
        "must belong to this very sweep (plant, data, gains, filters, starts, settings)",
        f"{path}: of another, {identity['sweep']} instead of {plan.fingerprint}",
        "Give another folder.",
    )
