"""Saving and loading of results in a single file, without pickle.

A file is an `.npz` with the arrays, each once, and a JSON text with the structure of the result.
Only classes of this package are rebuilt, and no code from the file is run. Model functions and
effects of the user cannot be stored; they are arguments of `load`.
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
from eoi_jax._checks import check, counted
from eoi_jax._types import WHERE_SET
from eoi_jax.data.readers.archive import read_arrays
from eoi_jax.data.readers.limits import MAX_GIGABYTES, Allowance
from eoi_jax.data.resampling import Real
from eoi_jax.models.effects import AbstractEffect
from eoi_jax.models.equations.text_model import plant_from_json
from eoi_jax.models.function_snapshot import FunctionSnapshot
from eoi_jax.models.plant import Plant
from eoi_jax.models.stored_classes import (
    check_fields,
    check_tree,
    class_named,
    function_named,
    stored_form,
    tag_of,
    word_of_today,
)

# 2: records with their smoothing. 3: errors of a pass in one class. 4: classes by their tags
_FORMAT, _OLDEST = 4, 3
_HEADER = "eoi_jax"
_PACKAGE = "eoi_jax."
_FUNCTIONS = ("dynamics", "internal", "internal_initial", "actuator")  # of a plant


class MissingModel:
    """Placeholder of a model function that a file cannot hold; a call raises an error."""

    def __init__(self, name: str):
        self.name = name

    def __call__(self, *arguments: Any) -> Any:
        """Raise a `ValueError` that says what to do."""
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
    """Placeholder of a user's effect; it has a name, and any other use raises an error."""

    name: str
    kind: str
    fields: dict[str, Any]
    depends_on = "t"  # abscissa of its figure in reports
    form = ""

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
    """Write a result to `path` atomically.

    Args:
        result: any result of this package.
        path: of the file, usually with the suffix ``.npz``.

    Raises:
        ValueError: the suffix ``.json``, or a folder that cannot be written.
    """
    path = Path(path)
    rule = "must not end in .json, where `load` expects a model"
    advice = "Take .npz for a result; `export` writes its model as JSON."
    check(path.suffix != ".json", "path", rule, path, advice)
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
        plant: the plant of the result, if its model is not one of `eoi_jax.plants`; only its
            functions are used (f, g, the start of z, the actuator), the parameters of the file
            are kept.
        effects: effects of the user that the result contains.
        max_gigabytes: largest unpacked size of the file [1e9 bytes]; infinite for no limit.

    Returns:
        The result, of the class that was saved; for a JSON file the `Plant`.

    Raises:
        ValueError: a file that does not exist, is no result, is of an unknown format, damaged or
            larger than `max_gigabytes`; a plant whose parameters, relative degrees, channels or
            optional functions differ from those of the file.
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
        "Update eoi_jax." if tree["format"] > _FORMAT else "Compute the result again.",
    )
    substitutes = _Substitutes(plant, {_name(type(effect)): type(effect) for effect in effects})
    try:
        check_tree(tree["result"], list(arrays))
    except ValueError as error:
        check(False, "path", "must be a result that `save` wrote", path, _reason(error))
    return _decode(tree["result"], arrays, substitutes)


def _read(path: Path, allowance: Allowance) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The tree of a file with its format and version, and its arrays."""
    rule = "must be a result that `save` wrote"
    try:
        content = read_arrays(path, allowance)
        arrays = {key: array for key, array in content.items() if array is not None}
        header = arrays[_HEADER]
        tree = json.loads(str(header)) if header.ndim == 0 and header.dtype.kind == "U" else {}
    except Exception as error:  # damaged archives raise errors of many classes
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


def has_all_functions(plant: Plant) -> bool:
    """Whether a loaded plant has all its functions, so that it can be simulated and fitted.

    Args:
        plant: of a loaded result.

    Returns:
        False if `load` needs the plant of the result as an argument.
    """
    for key in _FUNCTIONS:
        function = getattr(plant, key)
        while _of_package(function) and hasattr(function, "base"):
            function = function.base
        if isinstance(function, MissingModel):
            return False
    return True


class _Arrays:
    """Arrays by key; an array that several parts of a result share is stored once."""

    def __init__(self):
        self.by_key: dict[str, np.ndarray] = {}
        # Key and array by the array's id; the reference to the array keeps the id from reuse.
        self._keys: dict[int, tuple[str, Any]] = {}

    def key(self, array: Any) -> str:
        if id(array) not in self._keys:
            key = f"a{len(self.by_key)}"
            self.by_key[key] = np.asarray(array)
            self._keys[id(array)] = (key, array)
        return self._keys[id(array)][0]


@dataclasses.dataclass(frozen=True)
class _Substitutes:
    """Arguments of `load` that replace what a file cannot hold.

    Attributes:
        plant: the plant whose functions are used, or None.
        effects: classes of effects by name.
    """

    plant: Plant | None
    effects: dict[str, type]

    def check(self, fields: dict[str, Any]) -> None:
        """Check the plant against the declarations in the file."""
        if self.plant is None:
            return
        declared = _declared(_encode(self.plant, _Arrays())["fields"])
        for key, expected in _declared(fields).items():
            advice = "Give the plant that the result was made with."
            check(
                expected == declared[key],
                f"plant.{key}",
                f"must be as in the file, {expected}",
                declared[key],
                advice,
            )

    def function(self, field: str | None) -> Any:
        """The function in a field of the plant, without the effects that wrap it, or None."""
        function: Any = getattr(self.plant, field, None) if field else None
        while _of_package(function) and hasattr(function, "base"):
            function = function.base
        return function


def _declared(fields: dict[str, Any]) -> dict[str, str]:
    """Declarations of a stored plant, without the effects that wrap its functions."""
    bare = {key: _bare(fields[key]) for key in _FUNCTIONS}
    names = {"parameters": bare["dynamics"][1] or fields["names"]}
    names |= {key: fields[key] for key in ("degrees", "inputs", "outputs")}
    description = {
        key: ", ".join(map(str, entry["tuple"])) or "none" for key, entry in names.items()
    }
    for key in ("internal", "actuator"):
        description[key] = "none" if bare[key][0] is None else "a function"
    start = bare["internal_initial"][0]
    description["internal_initial"] = (
        counted(len(start["tuple"]), "value") if "tuple" in start else "a function"
    )
    return description


def _bare(tree: Any) -> tuple[Any, Any]:
    """A stored function without the effects that wrap it, and the names of its parameters."""
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
        return {"dict": {key: _encode(element, arrays) for key, element in value.items()}}
    if isinstance(value, list | tuple):
        kind = "list" if isinstance(value, list) else "tuple"
        return {kind: [_encode(element, arrays) for element in value]}
    value = stored_form(value)
    value = value.function if isinstance(value, FunctionSnapshot) else value
    fields = dataclasses.fields(value) if dataclasses.is_dataclass(value) else ()
    content = {
        field.name: _encode(getattr(value, field.name), arrays)
        for field in fields
        if not (
            WHERE_SET.items() <= field.metadata.items()
            and getattr(value, field.name) is field.default
        )
    }
    if isinstance(value, MissingEffect):
        content = {key: _encode(element, arrays) for key, element in value.fields.items()}
        return {"effect": value.kind, "name": value.name, "fields": content}
    if isinstance(value, AbstractEffect):
        return {"effect": _name(type(value)), "name": value.name, "fields": content}
    if dataclasses.is_dataclass(value) and (_of_package(value) or not callable(value)):
        return {"class": _name(type(value)), "fields": content}
    return {"function": _name(value)}


def _decode(
    tree: Any, arrays: dict[str, np.ndarray], substitutes: _Substitutes, field: str | None = None
) -> Any:
    """The object of a tree; `field` is the field of the plant to whose function it belongs."""
    if not isinstance(tree, dict):
        return tree
    if "array" in tree:
        return arrays[tree["array"]]
    if "path" in tree:
        return Path(tree["path"])
    if "dict" in tree:
        return {key: _decode(element, arrays, substitutes) for key, element in tree["dict"].items()}
    if "list" in tree:
        return [_decode(element, arrays, substitutes) for element in tree["list"]]
    if "tuple" in tree:
        return tuple(_decode(element, arrays, substitutes) for element in tree["tuple"])
    if "function" in tree:
        return _function(tree["function"], substitutes.function(field))
    kind = _kind(tree, substitutes)
    if kind is Plant:
        substitutes.check(tree["fields"])
    content = {}
    for name, element in tree["fields"].items():
        # Effects that wrap a function of the plant have it as their base; rates of their states may
        # need all of f.
        is_function = name in _FUNCTIONS and (kind is Plant or name == "dynamics")
        function_field = name if is_function else field if name == "base" else None
        content[name] = _decode(element, arrays, substitutes, function_field)
        content[name] = word_of_today(kind.__name__, name, content[name])
    if kind is MissingEffect:
        return MissingEffect(tree["name"], tree["effect"], content)
    # Without __init__: the object was checked when it was first constructed.
    check_fields(kind, content, (MissingModel, MissingEffect))
    new = object.__new__(kind)
    fields = dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ()
    defaults = {field.name: field.default for field in fields
                if field.default is not dataclasses.MISSING}  # fmt: skip
    defaults |= {field.name: field.default_factory() for field in fields
                 if field.default_factory is not dataclasses.MISSING}  # fmt: skip
    for name, element in {**defaults, **content}.items():
        object.__setattr__(new, name, element)
    return new


def _kind(tree: dict[str, Any], substitutes: _Substitutes) -> Any:
    """The class of a stored result or effect."""
    if "effect" in tree:
        kind = substitutes.effects.get(tree["effect"], class_named(tree["effect"]))
        is_effect = isinstance(kind, type) and issubclass(kind, AbstractEffect)
        return kind if is_effect else MissingEffect
    kind = class_named(tree["class"])
    good = kind is not None and dataclasses.is_dataclass(kind)
    check(good, "path", "must hold results of eoi_jax only", tree["class"])
    return kind


def _function(name: str, substitute: Any) -> Callable:
    if substitute is not None:
        return substitute
    function = function_named(name)
    return function if function is not None else MissingModel(name)


def _of_package(value: Any) -> bool:
    """Whether the class of a value is of this package."""
    return not isinstance(value, FunctionSnapshot) and type(value).__module__.startswith(_PACKAGE)


def _name(value: Any) -> str:
    if isinstance(value, MissingModel):
        return value.name
    if isinstance(value, type) or hasattr(value, "__qualname__"):
        return tag_of(value)
    if callable(value):  # a model that is an object
        return tag_of(type(value))
    raise TypeError(f"cannot store {type(value).__name__}")
