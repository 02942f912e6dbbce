"""Arguments and results are checked as they are annotated, sizes of axes included."""

import dataclasses
import functools
import inspect
import threading
from collections.abc import Callable
from types import CellType, CodeType, FunctionType
from typing import Any

import beartype
import jaxtyping
from beartype.roar import BeartypeCallHintViolation

_jaxtyped = jaxtyping.jaxtyped
_AXES = _jaxtyped("context")  # a name of an axis has one size in one call
_CHECKS: dict[CodeType, Callable[..., Any]] = {}  # of functions that are defined within others
_THREAD = threading.local()


def jaxtyped(defined: Any = None, *, typechecker: Any = None) -> Any:
    """What the import hook puts above functions and classes, in place of jaxtyping's own.

    Makes the same checks in half of the time of all tests. jaxtyping's own writes and compiles two
    functions for each one that is defined, again at every call of a function around it, and binds
    the arguments of each call in Python. Here a check is written at the first call, and once for
    all functions of the same lines.
    """
    return checked if defined is None else _jaxtyped(defined)


def checked(defined: Any) -> Any:
    """A function, or a class that is a dataclass, whose calls are checked."""
    if inspect.isclass(defined):
        start = defined.__init__
        inherited = getattr(start, "__globals__", None) is globals()  # and checked already
        if dataclasses.is_dataclass(defined) and isinstance(start, FunctionType) and not inherited:
            defined.__init__ = checked(start)
        return defined
    if isinstance(defined, classmethod | staticmethod):
        return type(defined)(checked(defined.__func__))
    if not defined.__annotations__:
        return defined
    nested = "<locals>" in defined.__qualname__
    return _function(defined, _nested if nested else beartype.beartype)


def _function(function: FunctionType, check_of: Callable[..., Any]) -> Callable[..., Any]:
    check = None

    @functools.wraps(function)
    def call(*values: Any, **named: Any) -> Any:
        nonlocal check
        __tracebackhide__ = True
        if check is None:
            check = check_of(function)
        try:
            with _AXES:
                return check(*values, **named)
        except BeartypeCallHintViolation as error:
            raise jaxtyping.TypeCheckError(str(error)) from error

    return call


def _nested(function: FunctionType) -> Callable[..., Any]:
    """The check of all functions of these lines; it calls the one that its thread sets."""
    code = function.__code__
    check = _CHECKS.get(code)
    if check is None or check.__annotations__ != function.__annotations__:
        cells = tuple(CellType() for _ in code.co_freevars)  # nothing of this function is kept
        lines = FunctionType(code, function.__globals__, function.__name__, None, cells)

        @functools.wraps(function)
        def run(*values: Any, **named: Any) -> Any:
            return _THREAD.__dict__.pop("function")(*values, **named)

        lines.__annotations__ = function.__annotations__
        run.__wrapped__ = lines
        check = _CHECKS[code] = beartype.beartype(run)

    def call(*values: Any, **named: Any) -> Any:
        _THREAD.function = function
        return check(*values, **named)

    return call
