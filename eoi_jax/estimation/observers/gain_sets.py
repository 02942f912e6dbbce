"""Many observers of one kind, their gains stacked: the lanes of a sweep."""

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from eoi_jax._checks import check, check_kind
from eoi_jax.estimation.observers.observer import AbstractObserver


@dataclass(frozen=True)
class GainSets:
    """Observers of one class and scheme that differ in their gains.

    Attributes:
        observer: one observer whose gains have a leading axis (sets,).
        labels: values of each gain, shape (sets,), or (sets, ny) where outputs have their own.
    """

    observer: AbstractObserver
    labels: dict[str, Float[np.ndarray, "sets *ny"]]

    def __len__(self) -> int:
        return max((len(values) for values in self.labels.values()), default=1)

    def __getitem__(self, selection: Any) -> "GainSets":
        """Selected sets, by slice or indices."""
        labels = {name: value[selection] for name, value in self.labels.items()}
        return GainSets(jax.tree.map(lambda leaf: leaf[selection], self.observer), labels)

    @property
    def kind(self) -> str:
        """Name of the observer's class."""
        return type(self.observer).__name__

    @property
    def valid(self) -> Bool[np.ndarray, " sets"]:
        """Which sets have gains that are positive and finite."""
        conditions = [
            np.all(np.isfinite(value) & (value > 0), axis=tuple(range(1, value.ndim)))
            for value in self.labels.values()
        ]
        return np.all([np.ones(len(self), dtype=bool), *conditions], axis=0)


def gains(
    kind: Callable[..., AbstractObserver],
    values: Mapping[str, Any],
    scheme: str | None = None,
    grid: bool = False,
) -> GainSets:
    """Gain sets of one observer, for `eoi_jax.sweep`.

    Args:
        kind: the observer's class, or a `functools.partial` of it, e.g. ``SecondOrder``.
        values: of each gain: a number, or (sets,), or (sets, ny) for one value per output. Lanes
            with a value that is not positive end as ``"invalid_gains"``.
        scheme: ``"implicit"`` or ``"explicit"``; default: that of the observer.
        grid: whether to take every combination of the values, rather than pair them in order.

    Returns:
        The sets, in the order of the values; in a grid the last gain varies fastest.

    Raises:
        ValueError: no such gain, lengths that differ without `grid`, no value at all.

    Example:
        >>> gains(SecondOrder, {"c1": 50.0, "c2": [1e2, 1e3], "c3": [10.0, 30.0]}, grid=True)
    """
    names = [name for name in inspect.signature(kind).parameters if name != "scheme"]
    arrays = {name: np.asarray(value, dtype=float) for name, value in values.items()}
    for name, array in arrays.items():
        check(name in names, name, f"must be a gain of the observer ({', '.join(names)})", name)
        check(array.ndim <= 2, name, "must be a number, (sets,) or (sets, ny)", array.shape)
        check(array.size > 0, name, "must hold at least one value", "none: that is no lane")
    missing = [name for name in names if _required(kind, name) and name not in arrays]
    check(not missing, "gains", f"must give {', '.join(names)}", f"no {', '.join(missing)}")
    arrays = _combined(arrays) if grid else _side_by_side(arrays)
    extra = {} if scheme is None else {"scheme": scheme}
    build = jax.vmap(lambda gain_values: kind(**gain_values, **extra))
    observer = jax.tree.map(np.asarray, build({k: jnp.asarray(v) for k, v in arrays.items()}))
    return GainSets(observer, arrays)


_OBSERVERS = "observers with their gains, or `observers.gains(…)`"


def gain_sets(observers: Any, outputs: int) -> tuple[GainSets, ...]:
    """The observers of a sweep, in order, as groups that can be stacked.

    Args:
        observers: one observer, `GainSets`, or a sequence of either.
        outputs: ny; gains are broadcast to one per output where a group mixes both forms.
    """
    is_single = isinstance(observers, AbstractObserver | GainSets)
    items = (observers,) if is_single else () if observers is None else observers
    check_kind("observers", items, Iterable, _OBSERVERS)
    items = list(items)
    check(len(items) > 0, "observers", "must hold at least one observer", "none: that is no lane")
    groups: list[GainSets] = []
    pending: list[AbstractObserver] = []
    for item in items:
        check_kind("observers", item, (AbstractObserver, GainSets), _OBSERVERS)
        if pending and (isinstance(item, GainSets) or _form(item) != _form(pending[0])):
            groups.append(_stacked(pending, outputs))
            pending = []
        if isinstance(item, GainSets):
            groups.append(item)
        else:
            pending.append(item)
    if pending:
        groups.append(_stacked(pending, outputs))
    return tuple(groups)


def _required(kind: Callable, name: str) -> bool:
    return inspect.signature(kind).parameters[name].default is inspect.Parameter.empty


def _combined(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    lengths = [len(np.atleast_1d(values)) for values in arrays.values()]
    picks = np.indices(lengths).reshape(len(lengths), -1)
    return {
        name: np.atleast_1d(values)[pick]
        for (name, values), pick in zip(arrays.items(), picks, strict=True)
    }


def _side_by_side(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    lengths = {name: len(values) for name, values in arrays.items() if values.ndim}
    check(
        len(set(lengths.values())) <= 1,
        "gains",
        "must have as many values each, or one number for all sets",
        ", ".join(f"{name}: {length}" for name, length in lengths.items()),
        "For every combination of them, say `grid=True`.",
    )
    sets = max(lengths.values(), default=1)
    return {
        name: values if values.ndim else np.full(sets, float(values))
        for name, values in arrays.items()
    }


def _form(observer: AbstractObserver) -> Any:
    """Structure that stacked observers share: class, scheme, and all that is not an array."""
    return jax.tree.structure(observer)


def _stacked(observers: Sequence[AbstractObserver], outputs: int) -> GainSets:
    def leaf(*values: Any) -> np.ndarray:
        arrays = [np.asarray(array, dtype=float) for array in values]
        if len({array.shape for array in arrays}) > 1:
            arrays = [np.broadcast_to(array, (outputs,)) for array in arrays]
        return np.stack(arrays)

    stacked = jax.tree.map(leaf, *observers)
    paths, _ = jax.tree_util.tree_flatten_with_path(stacked)
    return GainSets(stacked, {_path(path): value for path, value in paths})


def _path(path: Any) -> str:
    text = jax.tree_util.keystr(path)
    return text.replace(".observers", "").lstrip(".").replace("[", "").replace("]", "")
