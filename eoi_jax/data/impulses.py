"""Inputs whose values are amounts given at the instant of their row: a dose, a tip of a rain gauge.

Between two samples a record has rates. An amount becomes one over the sample period of the grid,
held for the step behind its row, so that its integral is the amount wherever the next row is.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import check, check_choice, counted, is_or_are
from eoi_jax._types import Signals, TimeAxis
from eoi_jax.data.column_names import is_per_time
from eoi_jax.data.input_holds import HoldArgument, hold_of_each, read_hold, shared
from eoi_jax.data.record import Record
from eoi_jax.data.resampling import GridSettings, uniform_grid

SINGLE_ROWS = "is not zero in single rows"  # of a note on what may be amounts
_SINGLE_ROWS = (
    f"`{{}}` {SINGLE_ROWS}, and what it does depends on where the next row is. If these "
    'are amounts given at that instant (doses), declare `impulses` = ["{}"]; if a rate, write the '
    "row at which it ends."
)


def stands_in_single_rows(values: Float[np.ndarray, " time"], stamps: TimeAxis) -> bool:
    """Whether an input of unevenly spaced rows is zero but for rows without a neighbour that acts.

    Args:
        values: of the input; NaN where a cell is empty.
        stamps: of the rows, increasing [s].
    """
    entered = np.isfinite(values)
    acts = entered & (values != 0.0)
    adjacent = acts[1:] & acts[:-1]
    if not acts.any() or adjacent.any() or 2 * int(np.sum(acts)) > int(np.sum(entered)):
        return False
    distinct = np.unique(stamps)
    if len(distinct) < 2:
        return False
    try:
        grid = uniform_grid(distinct)
    except ValueError:  # of pauses that dominate
        return True
    return grid.scattered or grid.index is None


def single_row_notes(
    stamps: TimeAxis,
    signals: Signals,
    keys: Sequence[str],
    units: Mapping[str, str],
) -> list[str]:
    """A sentence on each input that may hold amounts.

    Args:
        stamps: of the rows [s].
        signals: one row a stamp.
        keys: of the inputs, whose columns come first.
        units: in the file, by column; a unit per time is that of a rate.
    """
    candidates = (
        (key, column)
        for key, column in zip(keys, signals.T, strict=False)
        if not is_per_time(units.get(key, ""))
    )
    return [
        _SINGLE_ROWS.format(key, key)
        for key, column in candidates
        if stands_in_single_rows(column, stamps)
    ]


def zero_hold_of_impulses(
    hold: HoldArgument, names: Sequence[str], impulses: Sequence[str]
) -> HoldArgument:
    """The hold of all inputs, zero for those that are amounts.

    Args:
        hold: as in `Record`; a word is that of the other inputs.
        names: of the inputs.
        impulses: names of those that are amounts.

    Raises:
        ValueError: another hold of an amount than zero, none of another input.
    """
    if not impulses:
        return hold
    if isinstance(hold, Mapping):
        hold = {**dict.fromkeys(impulses, "zero"), **hold}
    elif hold == "auto":
        undeclared = [name for name in names if name not in impulses]
        rule = "must be declared for inputs beside those of `impulses`"
        advice = f'Write {{"{undeclared[0]}": "linear"}}, or "zero".' if undeclared else ""
        check(not undeclared, "hold", rule, f"nothing for {', '.join(undeclared)}", advice)
        return "zero"
    elif isinstance(hold, str) and len(impulses) < len(names):
        read_hold(hold, names)
        return shared(["zero" if name in impulses else hold for name in names])
    words = hold_of_each(read_hold(hold, names), len(names))
    for name, word in zip(names, words, strict=True):
        rule = "must be zero, or left out, for an input of `impulses`"
        check(name not in impulses or word == "zero", f"hold[{name}]", rule, word)
    return shared(words)


def without_amounts(
    signals: Signals, keys: Sequence[str], impulses: Sequence[str], notes: list[str]
) -> tuple[Signals, dict[int, Float[np.ndarray, " time"]]]:
    """Signals with zeros in the columns of amounts, and these, by column; an empty cell is none.

    Args:
        signals: one row a stamp.
        keys: of the inputs, whose columns come first.
        impulses: keys of those that are amounts.
        notes: to which a sentence on empty cells is added.

    Raises:
        ValueError: a name that is none of the inputs.
    """
    kept_signals, amounts = np.array(signals), dict[int, Float[np.ndarray, " time"]]()
    for key in impulses:
        check_choice("impulses", key, tuple(keys))
        j = list(keys).index(key)
        column = kept_signals[:, j]
        finite = np.isfinite(column)
        if not finite.all():
            empty = counted(int(np.sum(~finite)), "cell")
            notes.append(f"`{key}` is empty in {empty}: no amount there, as of `impulses`.")
        amounts[j] = np.where(finite, column, 0.0)
        column[:] = 0.0
    return kept_signals, amounts


def with_impulses(
    record: Record, stamps: TimeAxis, amounts: Mapping[int, Float[np.ndarray, " time"]]
) -> Record:
    """The record with amounts as rates [unit of the amount over that of time].

    Args:
        record: with zeros in these inputs.
        stamps: of the rows, as they stand in the file; amounts of one stamp add up [s].
        amounts: in each row, by index of the input.
    """
    if not amounts:
        return record
    distinct, row = np.unique(stamps, return_inverse=True)
    grid, h = uniform_grid(distinct), record.sample_period
    position = (distinct - record.time[0]) / h
    index = np.floor(position + GridSettings.tolerance) if grid.index is None else grid.index
    step = np.clip(index, 0, len(record) - 1).astype(int)[row]
    inputs, notes, has_amount = np.array(record.inputs), list[str](), np.zeros(len(stamps), bool)
    names = [record.input_names[j] for j in amounts]
    for name, (j, column) in zip(names, amounts.items(), strict=True):
        np.add.at(inputs[:, j], step, column / h)
        has_amount |= column != 0.0
        count = counted(int(np.sum(column != 0.0)), "amount")
        notes.append(
            f"`{name}`: {count}, {np.sum(column):.6g} in all, as rates over the step of {h:g} s "
            "behind each row."
        )
    added = int(np.sum(has_amount)) - len(np.unique(row[has_amount]))
    if added:
        notes.append(f"Amounts of one stamp are added up: {added} to one of a row before.")
    distance = np.abs(position - np.rint(position))[row]
    count = int(np.sum(has_amount & (distance > GridSettings.tolerance)))
    if grid.index is None and count:
        notes.append(
            f"{counted(count, 'row')} with an amount {is_or_are(count)} between the points of the "
            "grid: it acts over the step in which its stamp lies."
        )
    new = record._changed(" ".join(notes))
    masks = record.valid, record.input_valid, record.output_valid
    new._set(inputs, record.outputs, masks, record.time, h)
    return new._assign(_units_of_rates(record, names))


def _units_of_rates(record: Record, names: Sequence[str]) -> dict[str, dict[str, str] | None]:
    """The units of a record, by field, with these inputs per unit of time; none is of its file."""
    in_file = dict(record.file_units or {})
    units = {**{name: in_file.pop(name) for name in names if name in in_file}, **record.units}
    time_unit = in_file.get("time", "s")
    rates = {name: f"{units[name]}/{time_unit}" for name in names if units.get(name)}
    return {"units": {**record.units, **rates}, "file_units": in_file or None}
