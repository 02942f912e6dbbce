"""Classes and structure of stored results, checked before any object is built.

A tree is a plain value, or an object with a single key for its kind: an array by its key, a path,
a dictionary, a list, a tuple, a function by name, or a class or an effect with its fields.
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
# Files name a class by a tag, which stays when the class is moved or renamed. Values: the module,
# and the name of the class where it differs from the tag.
CLASSES: Mapping[str, str] = {
    "Record": "data.record",
    "Clock": "data.time_axis",
    "Saturation": "data.clipping",
    "Inspection": "data.inspection",
    "Channel": "data.channel",
    "Wrapping": "data.wrapping",
    "Plant": "models.plant",
    "SampledStates": "models.sampled_states",
    "LinearChains": "models.linear_system:_Chains",
    "LinearZeroDynamics": "models.linear_system:_ZeroDynamics",
    "LinearReadout": "models.linear_system:_Readout",
    "LinearCompanion": "models.linear_system:_Companion",
    "TextEquations": "models.equations.system:Equations",
    "TextDynamics": "models.equations.system",
    "TextInternal": "models.equations.system",
    "TextStart": "models.equations.system",
    "PartlyFree": "models.start_weights",
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
    "Measurement": "estimation.observers.measurement",
    "LowPass": "estimation.lowpass",
    "Status": "_status",
    "EngineUsed": "_status",
    "Certainty": "estimation.covariance",
    "CommonFactor": "estimation.common_factors",
    "ParameterHistory": "estimation.parameter_history",
    "ParameterDrift": "estimation.parameter_drift",
    "Identification": "estimation.identify",
    "Validation": "simulation.validation",
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
    "Comparison": "comparison.result",
    "Entry": "comparison.result",
    "Discovery": "discovery.result",
    "Added": "discovery.result",
    "Evidence": "discovery.result",
    "Rival": "discovery.result",
    "Lead": "discovery.result:PartialExplanation",
    "Texts": "discovery.result",
    "Coupling": "models.effects.coupling",
    "Signal": "models.effects.signals",
    "ConstantOffset": "models.effects.disturbance",
    "Drift": "models.effects.disturbance",
    "SinusoidalDisturbance": "models.effects.disturbance",
    "AsymmetricFriction": "models.effects.friction",
    "AsymmetricViscousFriction": "models.effects.friction",
    "CoulombFriction": "models.effects.friction",
    "CubicDamping": "models.effects.friction",
    "DisplacementDamping": "models.effects.friction",
    "Curve": "models.effects.curve",
    "InputCurve": "models.effects.curve",
    "InternalFriction": "models.effects.friction",
    "QuadraticDrag": "models.effects.friction",
    "RateFriction": "models.effects.friction",
    "StribeckFriction": "models.effects.friction",
    "ViscousFriction": "models.effects.friction",
    "ActuatorLag": "models.effects.inputs",
    "ErrorSaturation": "models.effects.inputs",
    "InputAsymmetry": "models.effects.inputs",
    "InputDamping": "models.effects.friction",
    "LoadFriction": "models.effects.friction",
    "CurrentLimit": "models.effects.inputs",
    "ValveFlow": "models.effects.inputs",
    "VaryingCapacity": "models.effects.capacity",
    "RateAsymmetry": "models.effects.capacity",
    "RateLimit": "models.effects.inputs",
    "InputPlay": "models.effects.inputs",
    "SensorCurve": "models.effects.series",
    "InputDeadZone": "models.effects.inputs",
    "InputDelay": "models.effects.inputs",
    "InputQuadratic": "models.effects.inputs",
    "InputSquare": "models.effects.inputs",
    "InputSaturation": "models.effects.inputs",
    "InputRate": "models.effects.inputs",
    "InputModulation": "models.effects.inputs",
    "InputYield": "models.effects.inputs",
    "Hysteresis": "models.effects.memory",
    "SaturatingLoss": "models.effects.outflow",
    "Relaxation": "models.effects.memory",
    "SecondMass": "models.effects.memory",
    "SecondNode": "models.effects.memory",
    "MaxwellElement": "models.effects.memory",
    "InternalOverflow": "models.effects.outflow",
    "Leak": "models.effects.outflow",
    "Overflow": "models.effects.outflow",
    "PowerLoss": "models.effects.outflow",
    "Radiation": "models.effects.outflow",
    "ModulatedSinusoid": "models.effects.products",
    "ParameterDependence": "models.effects.dependence",
    "InputAction": "models.effects.products",
    "InputProduct": "models.effects.products",
    "Product": "models.effects.products",
    "CellsInSeries": "models.effects.series",
    "SensorLag": "models.effects.series",
    "CubicStiffness": "models.effects.stiffness",
    "EndStop": "models.effects.stiffness",
    "FreePlay": "models.effects.stiffness",
    "Gravity": "models.effects.stiffness",
    "GravityTilt": "models.effects.stiffness",
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
# Files of format 3 name classes by their module and name at that time. The names are the tags,
# except for these.
_FORMER = {
    "_Chains": "LinearChains",
    "_ZeroDynamics": "LinearZeroDynamics",
    "Equations": "TextEquations",
    "_Dynamics": "AugmentedDynamics",
    "_Internal": "AugmentedInternal",
    "_Start": "AugmentedStart",
    "_Actuator": "AugmentedActuator",
}
# Words of fields that files of earlier versions have, by tag, field and word.
_FORMER_WORDS = {("Status", "code", "explained"): "complete"}
_TAGS = {
    f"{_PACKAGE}{place if ':' in place else f'{place}:{tag}'}": tag
    for table in (CLASSES, FUNCTIONS)
    for tag, place in table.items()
}
_RENAMES = {"mapping": "dict", "listed": "list", "grouped": "tuple", "kind": "class"}
_WITH_FIELDS = {"class": {"fields"}, "effect": {"fields", "name"}}


class Branch(msgspec.Struct, forbid_unknown_fields=True, rename=_RENAMES):
    """A part of a tree that is no plain value; its kind follows from its keys.

    Attributes:
        array: key of an array in the file.
        path: path of a file.
        mapping: parts by name; key ``dict``.
        listed: parts in order; key ``list``.
        grouped: parts in order; key ``tuple``.
        function: tag of a function, or ``module:name`` if it is not of this package.
        kind: tag of a class, together with `fields`; key ``class``.
        effect: tag of an effect's class, or ``module:name`` if it is not of this package,
            together with `fields` and its canonical `name`.
        fields: parts by name.
        name: name of an effect.
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
    """The object that is stored in place of `value`: `value` itself unless one is registered."""
    return value


def check_tree(tree: Any, keys: Sequence[str], max_depth: int = 200) -> None:
    """Check that a tree has the form that `save` writes and refers to existing arrays.

    Args:
        tree: the tree, from JSON.
        keys: of the arrays.
        max_depth: nesting of objects and lists; results have fewer than fifty levels.

    Raises:
        ValueError: a tree of a different form, or one that is nested too deeply.
    """
    if not is_shallow(tree, max_depth):
        raise ValueError("it is nested too deeply")
    try:
        msgspec.convert(tree, Branch | str | float | int | bool | None)
    except msgspec.ValidationError as error:
        raise ValueError(f"its structure is not that of a result: {error}") from None
    keys_present, pending = set(keys), [tree]
    while pending:
        part = pending.pop()
        if not isinstance(part, dict):
            continue
        marks = [key for key in part if key not in ("fields", "name")]
        companions = set(part) - set(marks)
        if len(marks) != 1 or companions != _WITH_FIELDS.get(marks[0], set()):
            key_text = ", ".join(sorted(part)) or "no key"
            raise ValueError(f"its structure is not that of a result: an object of {key_text}")
        content = part.get("fields", part[marks[0]])
        if marks[0] == "array" and content not in keys_present:
            raise ValueError(f"it has no array {content}")
        if isinstance(content, dict | list):
            pending += content.values() if isinstance(content, dict) else content


def class_named(name: str) -> type | None:
    """A stored class of this package; None for any other.

    Args:
        name: its tag; in files of format 3 its former ``module:name``.
    """
    return _import_named(name, CLASSES)


def function_named(name: str) -> Callable | None:
    """A function of a plant of this package; None for any other.

    Args:
        name: as in `class_named`.
    """
    return _import_named(name, FUNCTIONS)


def tag_of(item: Any) -> str:
    """The name of a class or function in files: its tag, or ``module:name`` if it has none.

    Args:
        item: class or function.

    Raises:
        TypeError: a class of this package without a tag, as it could not be loaded.
    """
    name = f"{getattr(item, '__module__', '')}:{item.__qualname__}"
    if isinstance(item, type) and name.startswith(_PACKAGE) and name not in _TAGS:
        raise TypeError(f"{name} has no tag: give it one in `stored_classes.py`")
    return _TAGS.get(name, name)


def _import_named(name: str, table: Mapping[str, str]) -> Any:
    """Import the class or function of a name; only names in the table are imported."""
    module, colon, last = name.rpartition(":")
    if colon:
        last = _FORMER.get(last, last) if module.startswith(_PACKAGE) else ""
    if last not in table:
        return None
    module, _, attribute = table[last].partition(":")
    return vars(import_module(_PACKAGE + module))[attribute or last]


def word_of_today(tag: str, field: str, value: Any) -> Any:
    """The value of a field; a word of an earlier version becomes that of this one.

    Args:
        tag: of the class.
        field: name.
        value: as it is stored.
    """
    return _FORMER_WORDS.get((tag, field, value), value) if isinstance(value, str) else value


def check_fields(kind: type, content: Mapping[str, Any], stand_ins: tuple[type, ...]) -> None:
    """Check the fields of a stored object against the names and types that its class declares.

    Args:
        kind: a dataclass, or a class without fields.
        content: the fields, decoded.
        stand_ins: classes of placeholders for objects that a file cannot hold.

    Raises:
        ValueError: a field that is unknown, missing, or of a wrong type or shape.
    """
    fields = dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ()
    declared = {field.name: field for field in fields}
    unknown = sorted(set(content) - set(declared))
    check(not unknown, "path", f"must hold a {kind.__name__} of this version", f"a field {unknown}")
    with jaxtyped("context"):  # an axis name has the same size in all fields
        for name, field in declared.items():
            optional = field.default is not dataclasses.MISSING
            optional |= field.default_factory is not dataclasses.MISSING
            where = f"{kind.__name__}.{name}"
            check(name in content or optional, "path", f"must hold {where}", "nothing")
            if name in content:
                good = conforms(content[name], field.type, stand_ins)
                description = _shape(content[name])
                check(good, "path", f"must hold {where} as it is declared", description)


def _shape(value: Any) -> str:
    array = isinstance(value, np.ndarray)
    return f"an array {value.dtype} of shape {value.shape}" if array else type(value).__name__


def conforms(value: Any, annotation: Any, stand_ins: tuple[type, ...]) -> bool:
    """Whether a value is of a declared type; the elements of containers are checked, too.

    Args:
        value: any.
        annotation: of a field.
        stand_ins: as in `check_fields`.
    """
    if annotation is None:
        return value is None
    if isinstance(annotation, str | TypeVar) or annotation is Any:
        return True
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin in (Union, types.UnionType):
        return any(conforms(value, member, stand_ins) for member in inner)
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
        equal_length = isinstance(value, tuple) and len(value) == len(inner)
        return equal_length and all(
            conforms(v, a, stand_ins) for v, a in zip(value, inner, strict=True)
        )
    if issubclass(origin, Mapping):
        return isinstance(value, dict) and all(
            conforms(key, inner[0], stand_ins)
            and _conforms_separately(element, inner[1], stand_ins)
            for key, element in value.items()
        )
    if issubclass(origin, Sequence):
        return isinstance(value, origin) and all(
            _conforms_separately(v, inner[0], stand_ins) for v in value
        )
    return isinstance(value, origin)


def _conforms_separately(value: Any, annotation: Any, stand_ins: tuple[type, ...]) -> bool:
    """`conforms` for an element of a collection, whose axis sizes may differ from the others'."""
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
