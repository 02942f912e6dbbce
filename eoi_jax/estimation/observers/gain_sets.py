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
        return len(next(iter(self.labels.values())))

    def __getitem__(self, which: Any) -> "GainSets":
        """Some of the sets, by slice or indices."""
        labels = {name: value[which] for name, value in self.labels.items()}
        return GainSets(jax.tree.map(lambda leaf: leaf[which], self.observer), labels)

    @property
    def kind(self) -> str:
        """Name of the observer's class."""
        return type(self.observer).__name__

    @property
    def valid(self) -> Bool[np.ndarray, " sets"]:
        """Which sets have gains that are positive and finite."""
        each = [
            np.all(np.isfinite(value) & (value > 0), axis=tuple(range(1, value.ndim)))
            for value in self.labels.values()
        ]
        return np.all(each, axis=0)


def gains(
    kind: Callable[..., AbstractObserver],
    values: Mapping[str, Any],
    scheme: str | None = None,
    grid: bool = False,
) -> GainSets:
    """Gain sets of one observer, for `eoi_jax.sweep`.

    Args:
        kind: the observer's class, or a `functools.partial` of it, e.g. ``SecondOrder``.
        values: of each gain: a number, or (sets,), or (sets, ny) for one value an output. A value
            that is not positive is kept: its lanes end as ``"invalid_gains"``.
        scheme: ``"implicit"`` or ``"explicit"``; the observer's own default if left out.
        grid: try every combination of the values, instead of the first of each, the second, ….

    Returns:
        The sets, in the order of the values; of a grid the last gain runs fastest.

    Raises:
        ValueError: no such gain, lengths that differ without `grid`, no value at all.

    Example:
        >>> gains(SecondOrder, {"c1": 50.0, "c2": [1e2, 1e3], "c3": [10.0, 30.0]}, grid=True)
    """
    known = [name for name in inspect.signature(kind).parameters if name != "scheme"]
    arrays = {name: np.asarray(value, dtype=float) for name, value in values.items()}
    for name, array in arrays.items():
        check(name in known, name, f"must be a gain of the observer ({', '.join(known)})", name)
        check(array.ndim <= 2, name, "must be a number, (sets,) or (sets, ny)", array.shape)
        check(array.size > 0, name, "must hold at least one value", "none: that is no lane")
    missing = [name for name in known if _required(kind, name) and name not in arrays]
    check(not missing, "gains", f"must give {', '.join(known)}", f"no {', '.join(missing)}")
    arrays = _combined(arrays) if grid else _side_by_side(arrays)
    extra = {} if scheme is None else {"scheme": scheme}
    build = jax.vmap(lambda each: kind(**each, **extra))
    observer = jax.tree.map(np.asarray, build({k: jnp.asarray(v) for k, v in arrays.items()}))
    return GainSets(observer, arrays)


_OBSERVERS = "observers with their gains, or `observers.gains(…)`"


def gain_sets(observers: Any, outputs: int) -> tuple[GainSets, ...]:
    """Observers as they may be given to a sweep, in order, as groups that can be stacked.

    Args:
        observers: one observer, `GainSets`, or a sequence of either.
        outputs: ny; gains are spread to one an output where a group mixes both forms.

    """
    alone = isinstance(observers, AbstractObserver | GainSets)
    given = (observers,) if alone else () if observers is None else observers
    check_kind("observers", given, Iterable, _OBSERVERS)
    given = list(given)
    check(len(given) > 0, "observers", "must hold at least one observer", "none: that is no lane")
    groups: list[GainSets] = []
    alike: list[AbstractObserver] = []
    for one in given:
        check_kind("observers", one, (AbstractObserver, GainSets), _OBSERVERS)
        if alike and (isinstance(one, GainSets) or _form(one) != _form(alike[0])):
            groups.append(_stacked(alike, outputs))
            alike = []
        if isinstance(one, GainSets):
            groups.append(one)
        else:
            alike.append(one)
    if alike:
        groups.append(_stacked(alike, outputs))
    return tuple(groups)


def _required(kind: Callable, name: str) -> bool:
    return inspect.signature(kind).parameters[name].default is inspect.Parameter.empty


def _combined(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    lengths = [len(np.atleast_1d(one)) for one in arrays.values()]
    picks = np.indices(lengths).reshape(len(lengths), -1)
    return {
        name: np.atleast_1d(one)[pick]
        for (name, one), pick in zip(arrays.items(), picks, strict=True)
    }


def _side_by_side(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    lengths = {name: len(one) for name, one in arrays.items() if one.ndim}
    check(
        len(set(lengths.values())) <= 1,
        "gains",
        "must have as many values each, or one number for all sets",
        ", ".join(f"{name}: {length}" for name, length in lengths.items()),
        "For every combination of them, say `grid=True`.",
    )
    sets = max(lengths.values(), default=1)
    return {name: one if one.ndim else np.full(sets, float(one)) for name, one in arrays.items()}


def _form(observer: AbstractObserver) -> Any:
    """What observers must share to be stacked: class, scheme, everything that is no array."""
    return jax.tree.structure(observer)


def _stacked(observers: Sequence[AbstractObserver], outputs: int) -> GainSets:
    def leaf(*values: Any) -> np.ndarray:
        arrays = [np.asarray(one, dtype=float) for one in values]
        if len({one.shape for one in arrays}) > 1:
            arrays = [np.broadcast_to(one, (outputs,)) for one in arrays]
        return np.stack(arrays)

    stacked = jax.tree.map(leaf, *observers)
    paths, _ = jax.tree_util.tree_flatten_with_path(stacked)
    return GainSets(stacked, {_path(path): value for path, value in paths})


def _path(path: Any) -> str:
    text = jax.tree_util.keystr(path)
    return text.replace(".observers", "").lstrip(".").replace("[", "").replace("]", "")
