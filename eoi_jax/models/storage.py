"""Any result to one file and back, without pickle.

A file is an `.npz`: its arrays, each once, and one JSON text that says how they make up the result.
Only classes of this package are rebuilt, and no code is run on reading; a model that is a function
of the user's own, or an effect, cannot be stored, so it is given again to `load`.
"""

import dataclasses
import json
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np

from eoi_jax import _display
from eoi_jax._atomic import write_file
from eoi_jax._checks import check
from eoi_jax.data.readers.archive import read_arrays
from eoi_jax.data.readers.limits import MAX_GIGABYTES, Allowance
from eoi_jax.data.resampling import Real
from eoi_jax.models.effects import AbstractEffect
from eoi_jax.models.equations.text_model import plant_from_json
from eoi_jax.models.plant import Plant
from eoi_jax.models.stored_classes import (
    check_fields,
    check_tree,
    class_named,
    function_named,
    stored_form,
    tag_of,
)

# 2: records keep what smoothed them. 3: errors of a pass lie together. 4: classes by their tags
_FORMAT, _OLDEST = 4, 3
_HEADER = "eoi_jax"
_PACKAGE = "eoi_jax."
_FUNCTIONS = ("dynamics", "internal", "internal_initial", "actuator")  # of a plant


class MissingModel:
    """Stands for a model function that a file cannot hold; using it says what to do."""

    def __init__(self, name: str):
        self.name = name

    def __call__(self, *arguments: Any) -> Any:
        """Raise: there is nothing to evaluate."""
        del arguments
        check(
            False,
            "plant",
            "must be given to `load` to be simulated or fitted again",
            f"only the name of its function, {self.name}",
            "Call `eoi_jax.load(path, plant=your_plant)`.",
        )


@dataclasses.dataclass(frozen=True)
class MissingEffect:
    """Stands for an effect of the user's own; it has a name, and using it says what to do."""

    name: str
    kind: str
    fields: dict[str, Any]
    depends_on = "t"  # what a report draws it against, for lack of better knowledge

    def __getattr__(self, attribute: str) -> Any:
        if attribute.startswith("__"):
            raise AttributeError(attribute)
        check(
            False,
            "effects",
            "must be given to `load` where they are not of this package",
            f"only the name {self.name} ({self.kind})",
            "Call `eoi_jax.load(path, effects=(your_effect,))`.",
        )


def save(result: Any, path: str | Path) -> None:
    """Write a result to `path`, whole or not at all.

    Args:
        result: any result of this package.
        path: of the file; ``.npz`` is customary.

    Raises:
        ValueError: the folder cannot be written.
    """
    path = Path(path)
    arrays = _Arrays()
    tree = {
        "format": _FORMAT,
        "version": version("eoi_jax"),
        "result": _encode(result, arrays),
    }

    def fill(draft: Path) -> None:
        with draft.open("wb") as file:
            header = {_HEADER: np.asarray(json.dumps(tree))}
            np.savez_compressed(file, allow_pickle=False, **header, **arrays.by_key)

    try:
        write_file(path, fill)
    except OSError as error:
        check(False, "path", f"must be writable ({error.strerror})", path)


_display.save.register(object, save)


def load(
    path: str | Path,
    plant: Plant | None = None,
    effects: Sequence[AbstractEffect] = (),
    max_gigabytes: Real = MAX_GIGABYTES,
) -> Any:
    """Read a result that `.save(path)` wrote, or a model that `export` wrote as JSON.

    Args:
        path: of the file.
        plant: that the result was made with, if its model is not one of `eoi_jax.plants`; only its
            functions are taken (f, g, the start of z, the actuator), parameters come from the file.
        effects: of the user's own that the result holds.
        max_gigabytes: what the file may unpack to [1e9 bytes]; infinite for no limit.

    Returns:
        The result, of the class that was saved; of a JSON file the `Plant`.

    Raises:
        ValueError: no such file, a file of something else, of another format, damaged or larger
            than `max_gigabytes`, a plant of other parameters, relative degrees or channels, or
            with other functions left out.
    """
    path = Path(path)
    check(path.is_file(), "path", "must be a file", path)
    if path.suffix == ".json":
        try:
            return plant_from_json(path.read_text(encoding="utf-8"))
        except UnicodeDecodeError:
            check(False, "path", "must be a model that `export` wrote", path)
    tree, arrays = _read(path, Allowance(max_gigabytes))
    check(
        _OLDEST <= tree["format"] <= _FORMAT,
        "path",
        f"must be of format {_OLDEST} to {_FORMAT}",
        f"format {tree['format']}, written by eoi_jax {tree['version']}",
        "Update eoi_jax." if tree["format"] > _FORMAT else "Make the result anew.",
    )
    given = _Given(plant, {_name(type(one)): type(one) for one in effects})
    try:
        check_tree(tree["result"], list(arrays))
    except ValueError as error:
        check(False, "path", "must be a result that `save` wrote", path, _reason(error))
    return _decode(tree["result"], arrays, given)


def _read(path: Path, allowance: Allowance) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The tree of a file with its format and version, and its arrays."""
    rule = "must be a result that `save` wrote"
    try:
        found = read_arrays(path, allowance)
        arrays = {key: one for key, one in found.items() if one is not None}
        header = arrays[_HEADER]
        tree = json.loads(str(header)) if header.ndim == 0 and header.dtype.kind == "U" else {}
    except Exception as error:  # each part of a damaged archive raises its own kinds
        check(False, "path", rule, path, _reason(error))
        raise
    good = isinstance(tree, dict) and "result" in tree
    good = good and type(tree.get("format")) is int and isinstance(tree.get("version"), str)
    check(good, "path", rule, path)
    return tree, arrays


def _reason(error: Exception) -> str:
    if isinstance(error, KeyError):
        return ""
    if isinstance(error, RecursionError):
        return "It is nested too deeply."
    return f"The reader says: {error or type(error).__name__}."


def is_whole(plant: Plant) -> bool:
    """Whether a loaded plant has all its functions, so that it can be simulated and fitted.

    Args:
        plant: of a result that was loaded.

    Returns:
        False where `load` needs the plant that the result was made with.
    """
    for key in _FUNCTIONS:
        function = getattr(plant, key)
        while _own(function) and hasattr(function, "base"):
            function = function.base
        if isinstance(function, MissingModel):
            return False
    return True


class _Arrays:
    """Arrays by key; one that several parts of a result share is kept once."""

    def __init__(self):
        self.by_key: dict[str, np.ndarray] = {}
        # Beside its key the array itself: while it is held no other one can have its id.
        self._seen: dict[int, tuple[str, Any]] = {}

    def key(self, array: Any) -> str:
        if id(array) not in self._seen:
            key = f"a{len(self.by_key)}"
            self.by_key[key] = np.asarray(array)
            self._seen[id(array)] = (key, array)
        return self._seen[id(array)][0]


@dataclasses.dataclass(frozen=True)
class _Given:
    """What a file cannot hold, and the caller of `load` gave.

    Attributes:
        plant: whose functions are taken; None for none.
        effects: classes by name.
    """

    plant: Plant | None
    effects: dict[str, type]

    def check(self, fields: dict[str, Any]) -> None:
        """The plant must be that of the file, as far as the file tells."""
        if self.plant is None:
            return
        mine = _declared(_encode(self.plant, _Arrays())["fields"])
        for key, own in _declared(fields).items():
            advice = "Give the plant that the result was made with."
            check(
                own == mine[key],
                f"plant.{key}",
                f"must be as in the file, {own}",
                mine[key],
                advice,
            )

    def function(self, field: str | None) -> Any:
        """What the plant has in one of its fields, without effects around it; None for nothing."""
        found: Any = getattr(self.plant, field, None) if field else None
        while _own(found) and hasattr(found, "base"):
            found = found.base
        return found


def _declared(fields: dict[str, Any]) -> dict[str, str]:
    """What a stored plant says of itself, without the effects around it."""
    bare = {key: _bare(fields[key]) for key in _FUNCTIONS}
    names = {"parameters": bare["dynamics"][1] or fields["names"]}
    names |= {key: fields[key] for key in ("degrees", "inputs", "outputs")}
    about = {key: ", ".join(map(str, one["tuple"])) or "none" for key, one in names.items()}
    for key in ("internal", "actuator"):
        about[key] = "none" if bare[key][0] is None else "a function"
    start = bare["internal_initial"][0]
    about["internal_initial"] = (
        f"{len(start['tuple'])} values" if "tuple" in start else "a function"
    )
    return about


def _bare(tree: Any) -> tuple[Any, Any]:
    """A stored function without effects around it, and the parameters that these leave to it."""
    names = None
    while isinstance(tree, dict) and "base" in tree.get("fields", ()):
        names = tree["fields"].get("names", names)
        tree = tree["fields"]["base"]
    return tree, names


def _encode(value: Any, arrays: _Arrays) -> Any:
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        return {"array": arrays.key(value)}
    if isinstance(value, Path):
        return {"path": str(value)}
    if isinstance(value, dict):
        return {"dict": {key: _encode(one, arrays) for key, one in value.items()}}
    if isinstance(value, list | tuple):
        kind = "list" if isinstance(value, list) else "tuple"
        return {kind: [_encode(one, arrays) for one in value]}
    value = stored_form(value)
    fields = dataclasses.fields(value) if dataclasses.is_dataclass(value) else ()
    content = {field.name: _encode(getattr(value, field.name), arrays) for field in fields}
    if isinstance(value, MissingEffect):
        content = {key: _encode(one, arrays) for key, one in value.fields.items()}
        return {"effect": value.kind, "name": value.name, "fields": content}
    if isinstance(value, AbstractEffect):
        return {"effect": _name(type(value)), "name": value.name, "fields": content}
    if dataclasses.is_dataclass(value) and (_own(value) or not callable(value)):
        return {"class": _name(type(value)), "fields": content}
    return {"function": _name(value)}


def _decode(
    tree: Any, arrays: dict[str, np.ndarray], given: _Given, field: str | None = None
) -> Any:
    """What a tree stands for; `field` is that of the plant whose function it is part of."""
    if not isinstance(tree, dict):
        return tree
    if "array" in tree:
        return arrays[tree["array"]]
    if "path" in tree:
        return Path(tree["path"])
    if "dict" in tree:
        return {key: _decode(one, arrays, given) for key, one in tree["dict"].items()}
    if "list" in tree:
        return [_decode(one, arrays, given) for one in tree["list"]]
    if "tuple" in tree:
        return tuple(_decode(one, arrays, given) for one in tree["tuple"])
    if "function" in tree:
        return _function(tree["function"], given.function(field))
    kind = _kind(tree, given)
    if kind is Plant:
        given.check(tree["fields"])
    content = {}
    for name, one in tree["fields"].items():
        # Effects around a function of the plant hold it as their base.
        within = name if kind is Plant and name in _FUNCTIONS else field if name == "base" else None
        content[name] = _decode(one, arrays, given, within)
    if kind is MissingEffect:
        return MissingEffect(tree["name"], tree["effect"], content)
    # Past __init__: what was checked once is not worked out anew.
    check_fields(kind, content, (MissingModel, MissingEffect))
    new = object.__new__(kind)
    for name, one in content.items():
        object.__setattr__(new, name, one)
    return new


def _kind(tree: dict[str, Any], given: _Given) -> Any:
    """The class of a stored result, or effect."""
    if "effect" in tree:
        kind = given.effects.get(tree["effect"], class_named(tree["effect"]))
        known = isinstance(kind, type) and issubclass(kind, AbstractEffect)
        return kind if known else MissingEffect
    kind = class_named(tree["class"])
    good = kind is not None and dataclasses.is_dataclass(kind)
    check(good, "path", "must hold results of eoi_jax only", tree["class"])
    return kind


def _function(name: str, given: Any) -> Callable:
    if given is not None:
        return given
    found = function_named(name)
    return found if found is not None else MissingModel(name)


def _own(value: Any) -> bool:
    """Whether its class is of this package."""
    return type(value).__module__.startswith(_PACKAGE)


def _name(value: Any) -> str:
    if isinstance(value, MissingModel):
        return value.name
    if isinstance(value, type) or hasattr(value, "__qualname__"):
        return tag_of(value)
    if callable(value):  # a model that is an object
        return tag_of(type(value))
    raise TypeError(f"cannot store {type(value).__name__}")
