"""What the methods of a user's class read outside themselves: a constant of a notebook, a table.

A program is found again by the classes and objects that it was traced from. With another value of a
global name a class computes something else, so these values are part of what is compared.
"""

import hashlib
from collections.abc import Hashable, Iterator, Mapping
from types import CodeType, FunctionType, ModuleType
from typing import Any

import jax
import numpy as np

from eoi_jax.compiler.jax_private import Tracer
from eoi_jax.models.function_snapshot import is_of_package


class _Identity:
    """An object that is equal to itself alone; the reference keeps its address from reuse."""

    def __init__(self, value: Any):
        self.value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Identity) and self.value is other.value

    def __hash__(self) -> int:
        return id(self.value)


def object_content(value: Any) -> Hashable:
    """Class and fields of an object, by their content, and what the methods of the class read.

    Args:
        value: of a user's class.

    Returns:
        The same for objects that compute the same.
    """
    kind, content = type(value), _Content()
    members = tuple(
        (name, content.comparable(member))
        for parent in kind.__mro__
        if not is_of_package(parent)
        for name, member in vars(parent).items()
        if not name.startswith(("__", "_abc"))
    )
    return kind, content.comparable(vars(value)), members


class _Content:
    """Values by their content, each object once."""

    def __init__(self):
        self._visited: dict[int, Any] = {}

    def comparable(self, value: Any, names: frozenset[str] = frozenset()) -> Hashable:
        """A value by its content where it has any, else by its identity.

        Args:
            value: any.
            names: that the code reads of classes and modules.
        """
        if isinstance(value, bool | int | float | complex | str | bytes | np.generic):
            return type(value), repr(value)
        if isinstance(value, np.ndarray | jax.Array) and not isinstance(value, Tracer):
            array = np.asarray(value)
            if array.dtype.kind in "biufc":
                digest = hashlib.sha256(np.ascontiguousarray(array).tobytes()).digest()
                return array.shape, str(array.dtype), digest
        if id(value) in self._visited or is_of_package(value):
            return _Identity(value)
        self._visited[id(value)] = value
        if isinstance(value, tuple | list):
            return type(value), tuple(self.comparable(part, names) for part in value)
        if isinstance(value, Mapping):
            pairs = tuple((repr(key), self.comparable(part, names)) for key, part in value.items())
            return type(value), pairs
        if isinstance(value, FunctionType):
            return _Identity(value.__code__), self._captured(value)
        if isinstance(value, type | ModuleType):
            members, read = vars(value), sorted(names & vars(value).keys())
            return _Identity(value), tuple((name, self.comparable(members[name])) for name in read)
        if hasattr(value, "__dict__"):
            return _Identity(type(value)), self.comparable(vars(value), names)
        return _Identity(value)

    def _captured(self, function: FunctionType) -> Hashable:
        """What a function reads outside itself."""
        names = dict.fromkeys(_names(function.__code__))
        captured = [function.__globals__[name] for name in names if name in function.__globals__]
        captured += [cell.cell_contents for cell in function.__closure__ or () if _is_set(cell)]
        captured += [*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()]
        return tuple(self.comparable(value, frozenset(names)) for value in captured)


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


def _is_set(cell: Any) -> bool:
    try:
        return cell.cell_contents is not None
    except ValueError:
        return False
