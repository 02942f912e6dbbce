"""The hold of each input: what a caller may write, what the samples suggest, and which columns.

Inputs of one record may be made in different ways: a controller switches the heating, the weather
goes on. A hold is one word where all inputs share it, and a word for each input otherwise.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from eoi_jax._checks import check, check_choice, counted
from eoi_jax._types import Signals

HOLDS = ("zero", "linear", "smooth")
TRACED_HOLDS = HOLDS[:2]  # those that JAX's arrays may have: no spline
HOLD_TAKEN = "Hold taken as"  # how a note on a hold that the samples suggest begins
NO_LONGER_HELD = "; held inputs are smooth behind it"  # of a filter: `logged_hold` is theirs
SELDOM = (
    "Where an input is logged only when it changes, seldom, or in rows of its own, declare its "
    '`hold`: "zero" keeps each value up to the next, "linear" goes straight to it.'
)
STAIRCASE = 0.2  # share of steps that may change a held input's value

Hold: TypeAlias = str | tuple[str, ...]  # of all inputs, or of each
HoldArgument: TypeAlias = str | Sequence[str] | Mapping[str, str]
Columns: TypeAlias = slice | np.ndarray


def read_hold(
    hold: Any, names: Sequence[str], automatic: bool = True, words: Sequence[str] = HOLDS
) -> Hold:
    """A hold as a caller may write it: one word where all inputs share it, else a word for each.

    Args:
        hold: a word, a word for each input in their order, or words by name of the input.
        names: of the inputs.
        automatic: whether ``"auto"`` is allowed.
        words: that an input may have.

    Raises:
        ValueError: an unknown word or input, or an input without a hold.
    """
    if isinstance(hold, str):
        check_choice("hold", hold, ("auto", *words) if automatic else words)
        return hold
    if isinstance(hold, Mapping):
        for key in hold:
            check(key in names, f"hold[{key}]",
                  f"must be of an input of the record, {', '.join(names) or 'which has none'}",
                  key)  # fmt: skip
        missing = [key for key in names if key not in hold]
        advice = 'Leave `hold` out, or write "auto", to have the fit decide for all inputs.'
        rule = "must say how each input behaves between its samples"
        check(not missing, "hold", rule, f"nothing for {', '.join(missing)}", advice)
        chosen = [hold[key] for key in names]
    else:
        is_list = isinstance(hold, Sequence) and not isinstance(hold, bytes)
        rule = (
            f"must be {', '.join(words)}, or such a word for each of {counted(len(names), 'input')}"
        )
        check(is_list and len(hold) == len(names), "hold", rule, hold)
        chosen = [*map(str, hold)]
    for key, word in zip(names, chosen, strict=True):
        check_choice(f"hold[{key}]", word, words)
    return shared(chosen)


def shared(words: Sequence[str]) -> Hold:
    """One word in place of as many equal ones; of no input it is ``"zero"``."""
    return tuple(words) if len(set(words)) > 1 else next(iter(words), "zero")


def hold_of_each(hold: Hold, count: int) -> tuple[str, ...]:
    """The hold of each of `count` inputs."""
    return (hold,) * count if isinstance(hold, str) else hold


def held_inputs(hold: Hold, count: int) -> tuple[bool, ...]:
    """Which of `count` inputs are held."""
    return tuple(word == "zero" for word in hold_of_each(hold, count))


def hold_text(hold: Hold, names: Sequence[str]) -> str:
    """``"zero"``, or ``"zero for heating, linear for outdoor"``."""
    if isinstance(hold, str):
        return hold
    parts = {word: [key for key, entry in zip(names, hold, strict=True) if entry == word]
             for word in hold}  # fmt: skip
    return ", ".join(f"{word} for {' and '.join(keys)}" for word, keys in parts.items())


def columns_by_hold(hold: Hold) -> list[tuple[str, Columns]]:
    """Each hold with the columns of its inputs."""
    if isinstance(hold, str):
        return [(hold, slice(None))]
    return [
        (word, np.flatnonzero([entry == word for entry in hold])) for word in dict.fromkeys(hold)
    ]


def by_hold(hold: Hold, inputs: Any, values: Callable[[str, Columns], Any]) -> Any:
    """What a function of inputs with one hold returns, for all inputs; the last axis is theirs.

    Args:
        hold: of the inputs.
        inputs: one column each.
        values: of a hold and of the columns with it.
    """
    if isinstance(hold, str):
        return values(hold, slice(None))
    parts = [(columns, values(word, columns)) for word, columns in columns_by_hold(hold)]
    joined = np.empty((*parts[0][1].shape[:-1], inputs.shape[1]))
    for columns, part in parts:
        joined[..., columns] = part
    return joined


def declared_or_suggested(
    hold: HoldArgument, u: Signals, names: Sequence[str]
) -> tuple[Hold, list[str]]:
    """The hold that a caller declares; for ``"auto"`` that of the samples, with a note.

    Args:
        hold: as for `read_hold`.
        u: samples of the inputs, without missing ones.
        names: of the inputs.
    """
    declared = read_hold(hold, names)
    return suggested_hold(u, names) if declared == "auto" else (declared, [])


def suggested_hold(u: Signals, names: Sequence[str]) -> tuple[Hold, list[str]]:
    """The hold of each input that its samples suggest, and a note with the reason.

    A staircase was held, anything else went on between the samples. An input that never changes
    shows nothing, and is taken as the others.

    Args:
        u: samples of the inputs, without missing ones.
        names: of the inputs.
    """
    if not u.shape[1]:
        return "zero", []
    shares = np.mean(np.diff(u, axis=0) != 0, axis=0)
    moving = shares > 0
    words = np.where(shares <= STAIRCASE, "zero", "linear")
    common = shared(words[moving].tolist())
    words[~moving] = common if isinstance(common, str) else "zero"
    hold = shared(words.tolist())
    limit = f"{100 * STAIRCASE:.0f} %"
    if isinstance(hold, str):
        rule = "at most" if hold == "zero" else "more than"
        share = float(np.max(shares) if hold == "zero" else np.min(shares[moving]))
        reason = f"{100 * share:.3g} % of the steps change an input's value, {rule} {limit}"
    else:
        changes = (f"{key} {100 * share:.3g} %" for key, share in zip(names, shares, strict=True))
        reason = f"share of the steps that change the value is {', '.join(changes)}, limit {limit}"
    return hold, [f"{HOLD_TAKEN} {hold_text(hold, names)}: {reason}."]
