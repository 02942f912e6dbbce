"""Checks of arguments; all errors of wrong calls are worded here, and counts in any sentence.

Every message has the field in backquotes, the rule, the invalid value, and what to do. All checks
raise `ValueError`.
"""

import difflib
import inspect
import warnings
from collections.abc import Iterable, Sequence
from pathlib import PurePath
from types import FrameType
from typing import Any

import numpy as np

Whole = int | np.integer
# Packages of frames that lead from a caller to here; the latter four wrap functions.
_INSIDE = ("eoi_jax", "numpy", "contextlib", "jaxtyping", "beartype")


class RecordWarning(UserWarning):
    """The data of a record were changed (resampled, masked) when it was constructed."""


class StoreWarning(UserWarning):
    """A part of a sweep's store is damaged and is computed again or left out."""


class FigureWarning(UserWarning):
    """A figure could not be drawn and is left out; results are not affected."""


def warn_caller(message: str, category: type[Warning]) -> None:
    """A warning with the place outside this package that called it.

    Args:
        message: the sentence.
        category: of the warning.
    """
    frame, level = inspect.currentframe(), 1
    while frame is not None and _is_inside(frame):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, category, stacklevel=level)


def _is_inside(frame: FrameType) -> bool:
    """Whether a frame is of a package that leads here, or of a wrapper hidden from tracebacks."""
    package = frame.f_globals.get("__name__", "").split(".")[0]
    return package in _INSIDE or "__tracebackhide__" in frame.f_locals


def check(
    condition: bool | np.bool_, name: str, rule: str, value: object, advice: str = ""
) -> None:
    """Raise ``"`name` rule, got value. advice"`` unless `condition` holds.

    Args:
        condition: the condition that must hold.
        name: the field, as the user wrote it.
        rule: the rule, e.g. ``"must be positive"``.
        value: the value of the field.
        advice: a sentence on what to do.
    """
    if not condition:
        message = f"`{name}` {rule}, got {_short(value)}."
        raise ValueError(f"{message} {advice}".rstrip())


def check_kind(name: str, value: object, kind: type | tuple[type, ...], expected: str) -> None:
    """`value` must be of a class or of one of several, described by `expected`: ``a Plant``."""
    class_text = f"the class {value.__name__}" if isinstance(value, type) else type(value).__name__
    attributes = [key for key in ("found", "plant") if isinstance(getattr(value, key, None), kind)]
    advice = f"Give its `.{attributes[0]}`." if attributes else ""
    check(isinstance(value, kind), name, f"must be {expected}", class_text, advice)


def is_whole(value: object) -> bool:
    """Whether `value` is an integer of Python or of NumPy; a bool is not."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def real(value: Any) -> float:
    """`value` as a float; NaN, for which no comparison holds, if it is not a number."""
    if isinstance(value, str | bytes):
        return np.nan
    try:
        return float(value) if np.ndim(value) == 0 else np.nan
    except (TypeError, ValueError):
        return np.nan


def check_count(name: str, value: Any, minimum: int = 1) -> int:
    """`value` must be an integer ≥ `minimum`; it is returned as an `int`."""
    check(is_whole(value) and value >= minimum, name, f"must be an integer ≥ {minimum}", value)
    return int(value)


def misplaced(
    name: str, rule: str, text: str, column: int, advice: str = "", width: int = 40
) -> ValueError:
    """The error for a text that is wrong at a single place; the message marks the column.

    Args:
        name: the field, as the user wrote it.
        rule: the rule.
        text: the value of the field.
        column: of the first wrong character, counted from 0.
        advice: a sentence on what to do.
        width: characters of a long text that are shown on either side of the mark.

    Returns:
        The error; the caller raises it.
    """
    first = max(0, column - width) if len(text) > 2 * width else 0
    excerpt = text[first : first + 2 * width]
    # Unprintable characters would shift the mark or move the terminal's cursor.
    is_printable = excerpt.isprintable()
    visible = (
        excerpt
        if is_printable
        else "".join(character if character.isprintable() else " " for character in excerpt)
    )
    mark = " " * (column - first) + "^"
    message = f"`{name}` {rule}, at column {column + 1}:\n    {visible}\n    {mark}"
    return ValueError(f"{message}\n{advice}" if advice else message)


def check_positive(name: str, value: object, advice: str = "") -> None:
    """`value` (number or array) must be finite and > 0 everywhere."""
    numbers = np.asarray(value)
    array = numbers.astype(float) if numbers.dtype.kind in "fiub" else np.full(1, real(value))
    check(
        bool(np.all(np.isfinite(array) & (array > 0))),
        name,
        "must be positive and finite",
        value,
        advice,
    )


def check_shape(
    name: str, array: Any, shape: Sequence[int | None], meaning: str, advice: str = ""
) -> None:
    """`array`, of NumPy or JAX, must have `shape`; `None` in it matches any length."""
    fits = len(array.shape) == len(shape) and all(
        length is None or length == size for length, size in zip(shape, array.shape, strict=True)
    )
    expected = "(" + ", ".join("any" if length is None else str(length) for length in shape) + ")"
    check(fits, name, f"must have shape {expected}: {meaning}", f"shape {array.shape}", advice)


def check_choice(name: str, value: str, choices: Iterable[str]) -> None:
    """`value` must be one of `choices`; the message lists them and the closest."""
    choices = tuple(choices)
    close = difflib.get_close_matches(str(value), choices, n=1)
    hint = f" Did you mean `{close[0]}`?" if close else ""
    check(
        value in choices,
        name,
        f"must be one of {', '.join(choices)}",
        repr(value),
        hint.strip(),
    )


def is_shallow(tree: Any, max_depth: int) -> bool:
    """Whether dicts and lists are nested at most `max_depth` deep; found without recursion."""
    level = [tree] if isinstance(tree, dict | list) else []
    for _ in range(max_depth):
        parts = (
            part for node in level for part in (node.values() if isinstance(node, dict) else node)
        )
        level = [part for part in parts if isinstance(part, dict | list)]
    return not level


def printable(text: str, keep: str = "") -> str:
    """The text with unprintable characters as escape codes, as a terminal would obey some of them.

    Args:
        text: from any source.
        keep: characters that are not replaced.
    """
    if text.isprintable():
        return text
    characters = (
        character if character.isprintable() or character in keep else repr(character)[1:-1]
        for character in text
    )
    return "".join(characters)


def counted(number: Whole, noun: str) -> str:
    """A number with its noun: ``1 gap``, ``2 gaps``, ``0 passes``.

    Args:
        number: of things.
        noun: in singular; it may have words before it, as in ``single missing sample``.
    """
    ending = "es" if noun.endswith(("s", "x", "ch", "sh")) else "s"
    return f"{number} {noun}{'' if number == 1 else ending}"


def timed(number: Whole, period: float, noun: str = "sample") -> str:
    """A number of samples with the time that they take: ``250 samples (2.5 s)``.

    Args:
        number: of samples.
        period: between two of them [s].
        noun: what they are called, in singular.
    """
    return f"{counted(number, noun)} ({number * period:.5g} s)"


def percent(share: float, digits: int = 2) -> str:
    """A share with the sign of percent and no power of ten: ``5.3 %``, ``100 %``, ``833 %``.

    Args:
        share: 1 for all.
        digits: that count, of a number that is not longer.
    """
    number = f"{100.0 * share:.{digits}g}"
    return f"{100.0 * share:.0f} %" if "e+" in number else f"{number} %"


def is_or_are(number: Whole) -> str:
    """The verb behind a number of things."""
    return "is" if number == 1 else "are"


def _short(value: object, elements: int = 12) -> str:
    """The value in a line or so; of an array with many elements its shape."""
    shape = getattr(value, "shape", ())
    if isinstance(shape, tuple) and np.prod(shape, dtype=float) > elements:
        return f"an array of shape {shape}"
    text = printable(str(value), "" if isinstance(value, str | PurePath) else "\n")
    return text if len(text) <= 200 else text[:197] + "..."
