"""Where the chunks of a sweep land: a Zarr store, on disk or in memory.

A chunk of a sweep is one chunk of every array. Its mark in ``done`` is written last: whatever is
marked is whole. A store belongs to one sweep, whose fingerprint it bears.
"""

import json
import os
import shutil
import tempfile
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from eoi_jax.batch.chunk import CODES, OK, Arrays
from eoi_jax.batch.plan import DIMENSIONS, Plan
from eoi_jax.checks import check

_FORMAT = 3
_LABELS = "eoi_jax"
_LEFT = {"f": np.nan, "i": 0}  # what a lane shows that has not run


@dataclass(frozen=True)
class Labels:
    """Coordinates and attributes of a sweep.

    Attributes:
        texts: dimension and values by name.
        numbers: dimensions and array by name.
        kinds: what the numbers of the coordinate ``kind`` stand for; empty without it.
        attributes: as JSON can hold them.
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
        import zarr.storage  # like xarray below, slow to import and needed by nothing else

        if self._path is None:
            self._store: Any = zarr.storage.MemoryStore()
            _create(self._store, plan, labels)
        else:
            if not self._path.exists():
                _publish(self._path, plan, labels)
            self._store = str(self._path)
            _check(self._path, plan)
        self._root = zarr.open_group(self._store, mode="r+")

    def landed(self, place: tuple[int, ...]) -> bool:
        """Whether a chunk is whole in the store."""
        return bool(self._array("done")[place])

    def write(self, place: tuple[int, ...], arrays: Arrays) -> None:
        """One chunk, then its mark."""
        region = self._plan.region(place)
        for name, values in arrays.items():
            self._array(name)[region] = values[None, None]
        self._array("done")[place] = True

    def mark_lost(self, place: tuple[int, ...]) -> None:
        """A chunk whose workers failed; it is not marked as done, so that a resumed sweep tries."""
        self._array("status")[self._plan.region(place)] = CODES.index("lost")

    def dataset(self, outcome: dict[str, Any] | None = None) -> Any:
        """What is there, labelled; read from disk only when it is used.

        Args:
            outcome: more attributes.
        """
        opened = open_sweep(self._store)
        opened = opened.load() if self._path is None else opened
        return opened.assign_attrs(outcome or {})

    def _array(self, name: str) -> Any:
        return self._root[name]


def open_sweep(path: Any) -> Any:
    """A sweep's store as a labelled dataset; values are read when they are used.

    Args:
        path: of the store.

    Returns:
        The `xarray.Dataset` that `eoi_jax.sweep` gave, or would give by now.

    Raises:
        ValueError: it is not there, or no sweep's.
    """
    if isinstance(path, str | Path):
        check(Path(path).exists(), "store", "must exist", path)
        _labels(Path(path))
    import xarray as xr

    raw = xr.open_zarr(path, consolidated=False, chunks=None)
    labels = json.loads(raw.attrs[_LABELS])
    lanes = raw.drop_vars(["done", *labels["numbers"]])
    # One by one, for a store lists its arrays in an order of its own.
    lanes = lanes.assign_coords({name: raw[name].variable for name in labels["numbers"]})
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


def _version() -> str:
    return version("eoi_jax")


def _publish(path: Path, plan: Plan, labels: Labels) -> None:
    """Made beside and moved into place whole: several machines may start one sweep at a time."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
    try:
        _create(str(draft), plan, labels)
        os.chmod(draft, 0o755)
        os.rename(draft, path)
    except OSError:
        if not path.exists():
            raise
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _create(store: Any, plan: Plan, labels: Labels) -> None:
    import zarr

    root = zarr.open_group(store, mode="w")
    sizes = {"pass": plan.settings.passes, "output": len(plan.plant.outputs)}
    sizes["parameter"] = len(plan.plant.names)
    for name, (kind, extra, about) in _ARRAYS.items():
        tail = tuple(sizes[one] for one in extra)
        root.create_array(
            name,
            shape=plan.shape + tail,
            chunks=plan.steps + tail,
            dtype=kind,
            fill_value=_LEFT[kind[0]],
            dimension_names=DIMENSIONS + extra,
            attributes={"long_name": about},
        )
    places = tuple(f"{one}_chunk" for one in DIMENSIONS)
    root.create_array(
        "done", shape=plan.grid, chunks=(1,) * 5, dtype="bool", dimension_names=places
    )
    for name, (dims, values) in labels.numbers.items():
        root.create_array(name, data=values, chunks=values.shape, dimension_names=dims)
    texts = {
        "format": _FORMAT,
        "sweep": plan.fingerprint,
        "version": _version(),
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


def _labels(path: Path) -> dict[str, Any]:
    import zarr

    try:
        return json.loads(zarr.open_group(str(path), mode="r").attrs[_LABELS])  # type: ignore[arg-type]
    except (KeyError, ValueError, FileNotFoundError, TypeError):
        check(False, "store", "must be the store of a sweep, or not exist", path)
        raise


def _check(path: Path, plan: Plan) -> None:
    own = _labels(path)
    check(
        own["format"] == _FORMAT,
        "store",
        f"must have been written in format {_FORMAT}",
        f"{path}: format {own['format']}, of eoi_jax {own['version']}",
        "Give another folder, or resume with that version.",
    )
    check(
        own["version"] == _version(),
        "store",
        f"must have been written by this version, {_version()}: its numbers would not compare",
        f"{path}: of eoi_jax {own['version']}",
        "Give another folder, or resume with that version.",
    )
    check(
        own["sweep"] == plan.fingerprint,
        "store",
        "must belong to this very sweep (plant, data, gains, filters, starts, settings)",
        f"{path}: of another, {own['sweep']} instead of {plan.fingerprint}",
        "Give another folder.",
    )
