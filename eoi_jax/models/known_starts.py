"""Where records start: known starts of outputs and their derivatives, and internal states."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import check, check_choice, check_kind, counted, real
from eoi_jax.compiler.jax_private import Tracer
from eoi_jax.models.start_weights import PartlyFree

# By output: its value at the start of a record, then those of its derivatives; None: not known.
StartItems = tuple[tuple[str, tuple[float | None, ...]], ...]

_FORM = "Write {output: (value, rate, …)}, with None for what is not known: {'angle': (None, 0.0)}."


_MOST_SHOWN = 4  # records in a sentence
_FREED = 'declare it free (`{} = "free"` in `initial`, or None in `internal_initial`)'


def checked_starts(
    initial: Mapping[str, Any] | None, outputs: Sequence[str], degrees: Sequence[int]
) -> StartItems:
    """Known starts by output, all of its states long; outputs without a known value are left out.

    Args:
        initial: as of `Plant`.
        outputs: names.
        degrees: relative degree of each.

    Raises:
        ValueError: a name that is no output, more values than an output has states, a value that is
            no finite number.
    """
    initial = {} if initial is None else initial
    check_kind("initial", initial, Mapping, "a dict by output")
    items = []
    for name, value in initial.items():
        numbers = _values_of(name, value, outputs, degrees)
        degree = degrees[list(outputs).index(name)]
        if any(number is not None for number in numbers):
            items.append((name, (*numbers, *[None] * (degree - len(numbers)))))
    return tuple(items)


def _values_of(name: str, value: Any, outputs: Sequence[str], degrees: Sequence[int]) -> list[Any]:
    """The start of an output, and of its derivatives, as far as given: finite, traced or None."""
    check_choice("initial", name, outputs)
    degree = degrees[list(outputs).index(name)]
    field = f"initial[{name}]"
    is_sequence = isinstance(value, Sequence) or getattr(value, "ndim", 0) > 0
    values = tuple(value) if is_sequence and not isinstance(value, str) else (value,)
    check(degree > 0, field, "must be left out: the output is a function of the states", value,
          "Give the starts of these states with `internal_initial`.")  # fmt: skip
    rule = f"must be at most {counted(degree, 'value')}: the output, then its derivatives"
    rule += " below the highest"
    check(0 < len(values) <= degree, field, rule, value, _FORM)
    passed = (type(None), Tracer)
    numbers = [number if isinstance(number, passed) else real(number) for number in values]
    good = all(isinstance(number, passed) or np.isfinite(number) for number in numbers)
    check(good, field, "must hold finite numbers, or None for what is not known", value, _FORM)
    return numbers


def start_by_name(
    initial: Mapping[str, Any],
    outputs: Sequence[str],
    degrees: Sequence[int],
    table: Float[np.ndarray, "rows ny"],
) -> list[list[Any]]:
    """A start that is given by output, as rows of `State.y`.

    Args:
        initial: as of `Plant`; values may be numbers that JAX traces.
        outputs: names.
        degrees: relative degree of each.
        table: what holds for states that are not given.

    Raises:
        ValueError: as `checked_starts`.
    """
    rows: list[list[Any]] = table.tolist()
    for name, value in initial.items():
        for row, number in enumerate(_values_of(name, value, outputs, degrees)):
            if number is not None:
                rows[row][list(outputs).index(name)] = number
    return rows


def start_table(
    items: StartItems, outputs: Sequence[str], rows: int
) -> Float[np.ndarray, "rows ny"]:
    """Known starts in the form of `State.y`; NaN where a start is not known.

    Args:
        items: of `checked_starts`.
        outputs: names.
        rows: of `State.y`.
    """
    table = np.full((rows, len(outputs)), np.nan)
    for name, values in items:
        column = table[: len(values), list(outputs).index(name)]
        column[:] = [np.nan if value is None else value for value in values]
    return table


def internal_start_of(internal: Any, initial: Any) -> Any:
    """Internal states at the start of a record: numbers, or a function of the parameters.

    Raises:
        ValueError: starts without a rate `internal`, or the reverse, a start that is no number.
    """
    if internal is None:
        check(initial is None, "internal_initial", "must be left out without `internal`", initial)
        return ()
    check(
        initial is not None,
        "internal_initial",
        "must be given with `internal`",
        "none",
        "Give z at the start of the record, or a function of the parameters.",
    )
    if callable(initial):
        return initial
    starts = tuple(initial) if isinstance(initial, Iterable) else (initial,)
    rule = "must hold finite numbers, or None for a start that is estimated of each record"
    good = all(value is None or bool(np.isfinite(real(value))) for value in starts)
    check(good and not isinstance(initial, str), "internal_initial", rule, initial)
    values = tuple(0.0 if value is None else float(value) for value in starts)
    free = tuple(value is None for value in starts)
    return PartlyFree(values, free) if any(free) else values


def listed(parts: Sequence[str]) -> str:
    """What holds for each of some records, as far as it can be read."""
    return "; ".join([*parts[:_MOST_SHOWN], *["…"] * (len(parts) > _MOST_SHOWN)])


def contradiction(
    plant: Any,
    values: Sequence[tuple[str, Float[np.ndarray, " own"]]],
    internal: Sequence[Sequence[tuple[str, float, float]]] = (),
) -> str:
    """A sentence on known starts that records contradict.

    Args:
        plant: a `Plant` that knows them.
        values: name of each record, and what fits it: the states of the outputs, one output after
            the other.
        internal: of each record, name of each internal state, what fits it and what is declared;
            empty without them.
    """
    declared = plant.initial
    rows = [(name, row) for name, degree in zip(plant.outputs, plant.degrees, strict=True)
              for row in range(degree)]  # fmt: skip
    parts = []
    for record, fitting in values:
        fits = []
        for (name, row), value in zip(rows, fitting, strict=True):
            start = declared[name][row] if name in declared else None
            if start is not None:
                derivative = name + "'" * row
                fits.append((derivative, value, start))
        fits += internal[len(parts)] if internal else []
        text = ", ".join(f"{name} {value:.3g}, not {start:g}" for name, value, start in fits)
        parts.append(f"{record} {text}")
    ways = ["leave it out"] * bool(plant.start_items)
    ways += [_FREED.format(states[0][0]) for states in internal[:1] if states]
    freed = ", or of an internal state ".join(ways)
    return (
        "the known start contradicts the records: free, it would be, by record: "
        f"{listed(parts)}. It stays as declared; correct it, {freed}, or begin the record "
        "where it holds"
    )
