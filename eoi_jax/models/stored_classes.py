"""What a stored result may look like: checked before anything of it is built.

A tree is a plain value, or an object with one key that says what it is: an array by its key, a
path, a dictionary, a list, a tuple, a function by name, or a class or an effect with its fields.
"""

import dataclasses
import types
from collections.abc import Callable, Mapping, Sequence
from functools import singledispatch
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

import jax
import msgspec
import numpy as np
from jaxtyping import AbstractArray, jaxtyped
from msgspec import UNSET, UnsetType

from eoi_jax._checks import check, is_shallow

_PACKAGE = "eoi_jax."
_DEEPEST = 200  # objects and lists inside each other; results have fewer than fifty
# Files name a class by a tag, which stays when the class moves or gets another name: where each
# stands, with its name where that is not the tag.
CLASSES: Mapping[str, str] = {
    "Record": "data.record",
    "Clock": "data.time_axis",
    "Saturation": "data.clipping",
    "Inspection": "data.inspection",
    "Channel": "data.inspection",
    "Plant": "models.plant",
    "LinearChains": "models.linear_system:_Chains",
    "LinearZeroDynamics": "models.linear_system:_ZeroDynamics",
    "TextEquations": "models.equations.system:Equations",
    "TextDynamics": "models.equations.system",
    "TextInternal": "models.equations.system",
    "TextStart": "models.equations.system",
    "Placed": "models.augmented",
    "AugmentedDynamics": "models.augmented:_Dynamics",
    "AugmentedInternal": "models.augmented:_Internal",
    "AugmentedStart": "models.augmented:_Start",
    "AugmentedActuator": "models.augmented:_Actuator",
    "FirstOrder": "estimation.observers.first_order",
    "SecondOrder": "estimation.observers.second_order",
    "HighOrder": "estimation.observers.high_order",
    "SuperTwisting": "estimation.observers.super_twisting",
    "PerOutput": "estimation.observers.per_output",
    "LowPass": "estimation.lowpass",
    "Status": "_status",
    "EngineUsed": "_status",
    "Certainty": "estimation.covariance",
    "Identification": "estimation.identify",
    "Validation": "simulation.validate",
    "Diagnosis": "discovery.diagnosis",
    "Confounded": "discovery.diagnosis",
    "Cross": "discovery.diagnosis",
    "Line": "discovery.diagnosis",
    "Map": "discovery.diagnosis",
    "Window": "discovery.diagnosis",
    "Refinement": "refinement.result",
    "Start": "refinement.result",
    "Candidate": "refinement.score_test",
    "Remaining": "refinement.remaining",
    "Trial": "refinement.remaining",
    "Uncertainty": "uncertainty.uncertainty",
    "Profile": "uncertainty.profile_likelihood",
    "Comparison": "comparison.compare",
    "Entry": "comparison.compare",
    "Discovery": "discovery.result",
    "Added": "discovery.result",
    "Evidence": "discovery.result",
    "Lead": "discovery.result",
    "Texts": "discovery.result",
    "ConstantOffset": "models.effects.disturbance",
    "Drift": "models.effects.disturbance",
    "SinusoidalDisturbance": "models.effects.disturbance",
    "AsymmetricFriction": "models.effects.friction",
    "AsymmetricViscousFriction": "models.effects.friction",
    "CoulombFriction": "models.effects.friction",
    "CubicDamping": "models.effects.friction",
    "QuadraticDrag": "models.effects.friction",
    "StribeckFriction": "models.effects.friction",
    "ViscousFriction": "models.effects.friction",
    "ActuatorLag": "models.effects.inputs",
    "InputDeadZone": "models.effects.inputs",
    "InputDelay": "models.effects.inputs",
    "InputQuadratic": "models.effects.inputs",
    "InputSaturation": "models.effects.inputs",
    "Hysteresis": "models.effects.memory",
    "InternalOverflow": "models.effects.outflow",
    "Leak": "models.effects.outflow",
    "Overflow": "models.effects.outflow",
    "ModulatedSinusoid": "models.effects.products",
    "Product": "models.effects.products",
    "CubicStiffness": "models.effects.stiffness",
    "EndStop": "models.effects.stiffness",
    "FreePlay": "models.effects.stiffness",
    "Gravity": "models.effects.stiffness",
    "LinearStiffness": "models.effects.stiffness",
    "PositionRipple": "models.effects.stiffness",
    "QuadraticStiffness": "models.effects.stiffness",
}
FUNCTIONS: Mapping[str, str] = {
    "cascaded_tanks_dynamics": "models.library.cascaded_tanks",
    "cascaded_tanks_internal": "models.library.cascaded_tanks",
    "cascaded_tanks_start": "models.library.cascaded_tanks",
    "duffing_oscillator_dynamics": "models.library.duffing_oscillator",
    "level_tank_dynamics": "models.library.level_tank",
    "mass_spring_damper_dynamics": "models.library.mass_spring_damper",
    "pendulum_dynamics": "models.library.pendulum",
    "positioning_system_dynamics": "models.library.positioning_system",
    "propeller_arm_dynamics": "models.library.propeller_arm",
    "three_mass_spring_damper_dynamics": "models.library.three_mass_spring_damper",
}
# Files of format 3 name classes by module and name, as they were then; the names are the tags but
# for these.
_FORMER = {
    "_Chains": "LinearChains",
    "_ZeroDynamics": "LinearZeroDynamics",
    "Equations": "TextEquations",
    "_Dynamics": "AugmentedDynamics",
    "_Internal": "AugmentedInternal",
    "_Start": "AugmentedStart",
    "_Actuator": "AugmentedActuator",
}
_TAGS = {
    f"{_PACKAGE}{place if ':' in place else f'{place}:{tag}'}": tag
    for table in (CLASSES, FUNCTIONS)
    for tag, place in table.items()
}
_RENAMES = {"mapping": "dict", "listed": "list", "grouped": "tuple", "kind": "class"}
_WITH_FIELDS = {"class": {"fields"}, "effect": {"fields", "name"}}


class Branch(msgspec.Struct, forbid_unknown_fields=True, rename=_RENAMES):
    """A part of a tree that is no plain value: one of its keys says what it is.

    Attributes:
        array: key of an array of the file.
        path: of a file.
        mapping: of the key ``dict``: parts by name.
        listed: of the key ``list``: parts in order.
        grouped: of the key ``tuple``: parts in order.
        function: its tag, or ``module:name`` of one that is not of this package.
        kind: of the key ``class``: its tag, with its `fields`.
        effect: tag of an effect's class, or ``module:name`` of one that is not of this package,
            with its `fields` and its canonical `name`.
        fields: by name.
        name: of an effect.
    """

    array: str | UnsetType = UNSET
    path: str | UnsetType = UNSET
    mapping: "dict[str, Branch | str | float | int | bool | None] | UnsetType" = UNSET
    listed: "list[Branch | str | float | int | bool | None] | UnsetType" = UNSET
    grouped: "list[Branch | str | float | int | bool | None] | UnsetType" = UNSET
    function: str | UnsetType = UNSET
    kind: str | UnsetType = UNSET
    effect: str | UnsetType = UNSET
    fields: "dict[str, Branch | str | float | int | bool | None] | UnsetType" = UNSET
    name: str | UnsetType = UNSET


@singledispatch
def stored_form(value: Any) -> Any:
    """What of a result a file holds in its place: itself, where nothing else is registered."""
    return value


def check_tree(tree: Any, keys: Sequence[str]) -> None:
    """A tree must be of the form that `save` writes, and name arrays that are there.

    Args:
        tree: as JSON has it.
        keys: of the arrays.

    Raises:
        ValueError: it is not, or is nested too deeply.
    """
    if not is_shallow(tree, _DEEPEST):
        raise ValueError("it is nested too deeply")
    try:
        msgspec.convert(tree, Branch | str | float | int | bool | None)
    except msgspec.ValidationError as error:
        raise ValueError(f"its structure is not that of a result: {error}") from None
    known, waiting = set(keys), [tree]
    while waiting:
        part = waiting.pop()
        if not isinstance(part, dict):
            continue
        marks = [key for key in part if key not in ("fields", "name")]
        rest = set(part) - set(marks)
        if len(marks) != 1 or rest != _WITH_FIELDS.get(marks[0], set()):
            shown = ", ".join(sorted(part)) or "no key"
            raise ValueError(f"its structure is not that of a result: an object of {shown}")
        content = part.get("fields", part[marks[0]])
        if marks[0] == "array" and content not in known:
            raise ValueError(f"it has no array {content}")
        if isinstance(content, dict | list):
            waiting += content.values() if isinstance(content, dict) else content


def class_named(name: str) -> type | None:
    """A stored class of this package; None for any other.

    Args:
        name: its tag; or, of files of format 3, ``module:name`` of where it stood.
    """
    return _found(name, CLASSES)


def function_named(name: str) -> Callable | None:
    """A function of a plant of this package; None for any other.

    Args:
        name: as of `class_named`.
    """
    return _found(name, FUNCTIONS)


def tag_of(item: Any) -> str:
    """What files name a class or a function by: its tag, or ``module:name`` where it has none.

    Args:
        item: class or function.

    Raises:
        TypeError: a class of this package without a tag, which could not be read back.
    """
    name = f"{getattr(item, '__module__', '')}:{item.__qualname__}"
    if isinstance(item, type) and name.startswith(_PACKAGE) and name not in _TAGS:
        raise TypeError(f"{name} has no tag: give it one in `stored_classes.py`")
    return _TAGS.get(name, name)


def _found(name: str, table: Mapping[str, str]) -> Any:
    """Only what the table names is imported, whatever a file says."""
    module, colon, last = name.rpartition(":")
    if colon:
        last = _FORMER.get(last, last) if module.startswith(_PACKAGE) else ""
    if last not in table:
        return None
    module, _, own = table[last].partition(":")
    return vars(import_module(_PACKAGE + module))[own or last]


def check_fields(kind: type, content: Mapping[str, Any], stand_ins: tuple[type, ...]) -> None:
    """Fields of a stored object must be those that its class declares, and of their types.

    Args:
        kind: a dataclass, or a class without fields.
        content: the fields, built.
        stand_ins: classes of what stands for something that a file cannot hold.

    Raises:
        ValueError: a field that is unknown, missing, or of another type or shape.
    """
    fields = dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ()
    declared = {field.name: field for field in fields}
    unknown = sorted(set(content) - set(declared))
    check(not unknown, "path", f"must hold a {kind.__name__} of this version", f"a field {unknown}")
    with jaxtyped("context"):  # a size that two arrays share is one size
        for name, field in declared.items():
            optional = field.default is not dataclasses.MISSING
            optional |= field.default_factory is not dataclasses.MISSING
            where = f"{kind.__name__}.{name}"
            check(name in content or optional, "path", f"must hold {where}", "nothing")
            if name in content:
                good = conforms(content[name], field.type, stand_ins)
                shown = _shape(content[name])
                check(good, "path", f"must hold {where} as it is declared", shown)


def _shape(value: Any) -> str:
    array = isinstance(value, np.ndarray)
    return f"an array {value.dtype} of shape {value.shape}" if array else type(value).__name__


def conforms(value: Any, annotation: Any, stand_ins: tuple[type, ...]) -> bool:
    """Whether a value is of a declared type, containers with all that is in them.

    Args:
        value: any.
        annotation: of a field.
        stand_ins: as of `check_fields`.
    """
    if annotation is None:
        return value is None
    if isinstance(annotation, str | TypeVar) or annotation is Any:
        return True
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin in (Union, types.UnionType):
        return any(conforms(value, one, stand_ins) for one in inner)
    if origin is Annotated:
        return conforms(value, inner[0], stand_ins)
    if origin is Literal:
        return value in inner
    if origin is not None:
        return _container(value, origin, inner, stand_ins)
    return _plain(value, annotation, stand_ins)


def _container(value: Any, origin: Any, inner: tuple, stand_ins: tuple[type, ...]) -> bool:
    if origin is Callable or not inner:
        return callable(value) if origin is Callable else isinstance(value, origin)
    if issubclass(origin, tuple) and not (len(inner) == 2 and inner[1] is Ellipsis):
        same = isinstance(value, tuple) and len(value) == len(inner)
        return same and all(conforms(v, a, stand_ins) for v, a in zip(value, inner, strict=True))
    if issubclass(origin, Mapping):
        return isinstance(value, dict) and all(
            conforms(key, inner[0], stand_ins) and _alone(one, inner[1], stand_ins)
            for key, one in value.items()
        )
    if issubclass(origin, Sequence):
        return isinstance(value, origin) and all(_alone(v, inner[0], stand_ins) for v in value)
    return isinstance(value, origin)


def _alone(value: Any, annotation: Any, stand_ins: tuple[type, ...]) -> bool:
    """One of several, as the records are: its sizes are its own."""
    with jaxtyped("context"):
        return conforms(value, annotation, stand_ins)


def _plain(value: Any, annotation: Any, stand_ins: tuple[type, ...]) -> bool:
    if isinstance(value, stand_ins):
        return True
    if isinstance(annotation, type) and issubclass(annotation, AbstractArray):
        if isinstance(value, np.ndarray) and annotation.array_type is jax.Array:
            annotation = annotation.dtype[np.ndarray, annotation.dim_str]
        return isinstance(value, annotation)
    if annotation is float:
        return isinstance(value, float | int | np.number) and not isinstance(value, bool)
    if annotation is int:
        return isinstance(value, int | np.integer) and not isinstance(value, bool)
    if annotation is Path or annotation in (str, bool):
        return isinstance(value, annotation)
    if annotation is Callable:
        return callable(value)
    if annotation is jax.Array or annotation is np.ndarray:
        return isinstance(value, np.ndarray)
    return not isinstance(annotation, type) or isinstance(value, annotation)
