"""Shape and range checks: the one place that words the errors of a wrong call.

Every message names the field in backquotes, then the rule, the value that broke it, and what
to do. All raise `ValueError`, so that a caller needs one `except`.
"""

import difflib
from collections.abc import Iterable, Sequence
from pathlib import PurePath
from typing import Any

import numpy as np

_AROUND = 40  # characters shown on either side of a mark


class RecordWarning(UserWarning):
    """A record was changed on the way in (resampled, masked): nothing is done silently."""


class StoreWarning(UserWarning):
    """A part of a sweep's store is damaged: it is computed again, or left out."""


class FigureWarning(UserWarning):
    """A figure could not be drawn and is left out: it costs no answer."""


def check(
    condition: bool | np.bool_, name: str, rule: str, value: object, advice: str = ""
) -> None:
    """Raise ``"`name` rule, got value. advice"`` unless `condition` holds.

    Args:
        condition: what must be true.
        name: the field, as the user wrote it.
        rule: what it must be, e.g. ``"must be positive"``.
        value: what it was.
        advice: one sentence on what to do.
    """
    if not condition:
        shown = f"`{name}` {rule}, got {_short(value)}."
        raise ValueError(f"{shown} {advice}".rstrip())


def check_kind(name: str, value: object, kind: type | tuple[type, ...], what: str) -> None:
    """`value` must be of a class, or of one of several; `what` says it in words: ``a Plant``."""
    shown = f"the class {value.__name__}" if isinstance(value, type) else type(value).__name__
    held = [key for key in ("found", "plant") if isinstance(getattr(value, key, None), kind)]
    advice = f"Give its `.{held[0]}`." if held else ""
    check(isinstance(value, kind), name, f"must be {what}", shown, advice)


def is_whole(value: object) -> bool:
    """Whether `value` is an integer, of Python or of NumPy; a truth value is none."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def real(value: Any) -> float:
    """`value` as a number; NaN for what is none: no comparison holds for that."""
    if isinstance(value, str | bytes):
        return np.nan
    try:
        return float(value) if np.ndim(value) == 0 else np.nan
    except (TypeError, ValueError):
        return np.nan


def check_count(name: str, value: Any, least: int = 1) -> int:
    """`value` must be an integer from `least` on; it is returned as one of Python's."""
    check(is_whole(value) and value >= least, name, f"must be an integer ≥ {least}", value)
    return int(value)


def misplaced(name: str, rule: str, text: str, column: int, advice: str = "") -> ValueError:
    """The error to raise for a text that is wrong at one place; it is shown with the column marked.

    Args:
        name: the field, as the user wrote it.
        rule: what it must be.
        text: what it was.
        column: of the first wrong character, counted from 0.
        advice: one sentence on what to do.

    Returns:
        The error; the caller raises it.
    """
    first = max(0, column - _AROUND) if len(text) > 2 * _AROUND else 0
    part = text[first : first + 2 * _AROUND]
    # What does not print would move the mark, or the terminal's cursor.
    clean = part.isprintable()
    shown = part if clean else "".join(one if one.isprintable() else " " for one in part)
    mark = " " * (column - first) + "^"
    message = f"`{name}` {rule}, at column {column + 1}:\n    {shown}\n    {mark}"
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


def check_shape(name: str, array: np.ndarray, shape: Sequence[int | None], meaning: str) -> None:
    """`array` must have `shape`; `None` in it matches any length."""
    fits = len(array.shape) == len(shape) and all(
        want is None or want == have for want, have in zip(shape, array.shape, strict=True)
    )
    wanted = "(" + ", ".join("any" if want is None else str(want) for want in shape) + ")"
    check(fits, name, f"must have shape {wanted}: {meaning}", f"shape {array.shape}")


def check_choice(name: str, value: str, known: Iterable[str]) -> None:
    """`value` must be one of `known`; the message lists them and the closest."""
    known = tuple(known)
    close = difflib.get_close_matches(str(value), known, n=1)
    hint = f" Did you mean `{close[0]}`?" if close else ""
    check(
        value in known,
        name,
        f"must be one of {', '.join(known)}",
        repr(value),
        hint.strip(),
    )


def is_shallow(tree: Any, most: int) -> bool:
    """Whether at most so many dicts and lists stand inside each other, before anything recurs."""
    level = [tree] if isinstance(tree, dict | list) else []
    for _ in range(most):
        parts = (part for one in level for part in (one.values() if isinstance(one, dict) else one))
        level = [part for part in parts if isinstance(part, dict | list)]
    return not level


def printable(text: str, keep: str = "") -> str:
    """A text with whatever does not print as its code: a terminal would obey some of it.

    Args:
        text: of any origin.
        keep: characters that stay as they are.
    """
    if text.isprintable():
        return text
    shown = (one if one.isprintable() or one in keep else repr(one)[1:-1] for one in text)
    return "".join(shown)


def _short(value: object) -> str:
    text = printable(str(value), "" if isinstance(value, str | PurePath) else "\n")
    return text if len(text) <= 200 else text[:197] + "..."
