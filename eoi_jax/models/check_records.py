"""Check that records match the plant that is fitted to them."""

from collections.abc import Iterable, Sequence
from pathlib import PurePath

import jax
import numpy as np

from eoi_jax._checks import check, check_kind, counted
from eoi_jax.compiler.jax_setup import check_process
from eoi_jax.data.cleaning import numbered_names
from eoi_jax.data.record import Record
from eoi_jax.models.angles import check_angles
from eoi_jax.models.plant import Plant
from eoi_jax.models.units import (
    same_unit,
    temperature_conversion,
    unit_of_rates,
    units_agree,
)


def check_records(plant: Plant, records: Record | Sequence[Record]) -> tuple[Record, ...]:
    """A record or several as a tuple, checked against the plant's channels and units.

    Raises:
        ValueError: a forked process, no plant, no record, inputs and outputs that have changed
            places, a wrong number of channels, channels in a different order, different units, an
            angle in degrees where the model takes radians.
    """
    check_process()
    check_kind("plant", plant, Plant, "a Plant")
    if isinstance(records, Record):
        records = (records,)
    is_path = isinstance(records, str | PurePath)
    rule, advice = "must be a Record or several", "Read it with `read_record`."
    check(not is_path, "records", rule, records, advice)
    elements = records if isinstance(records, list | tuple) else (records,)
    is_array = any(isinstance(element, np.ndarray | jax.Array) for element in elements)
    advice = "Make one of it, `Record(time, inputs, outputs)`; for arrays there is `observe`."
    check(not is_array, "records", rule, "an array", advice)
    check_kind("records", () if records is None else records, Iterable, "a Record or several")
    data_set = tuple(records or ())
    check(len(data_set) > 0, "records", "must hold at least one record", "none")
    for element in data_set:
        check_kind("records", element, Record, "a Record or several")
    for record in data_set:
        _check_places(plant, record)
        check_inputs(plant, record)
        _check_channels(plant, record, "outputs", plant.outputs, record.output_names)
    channels = plant.inputs + plant.outputs
    units = {
        name: record.units[label]
        for record in data_set
        for name, label in zip(channels, record.input_names + record.output_names, strict=True)
        if label in record.units
    }
    check_angles(plant, {**units, **plant.units})
    return data_set


def check_inputs(plant: Plant, record: Record) -> None:
    """Check the inputs of a record against the plant's: their number, order and units.

    Raises:
        ValueError: they differ.
    """
    _check_channels(plant, record, "inputs", plant.inputs, record.input_names)


def _check_channels(
    plant: Plant, record: Record, kind: str, names: Sequence[str], labels: Sequence[str]
) -> None:
    """Check inputs or outputs; `names` are those of the plant, `labels` those of the record."""
    check(
        len(labels) == len(names),
        f"records[{record.name}].{kind}",
        f"must have {counted(len(names), 'channel')} ({', '.join(names)}) for `{plant.name}`",
        f"{len(labels)} ({', '.join(labels)})",
        _extra_inputs(names, labels) if kind == "inputs" else "",
    )
    equal = set(labels) == set(names)
    check(
        not equal or tuple(labels) == tuple(names),
        f"records[{record.name}].{kind}",
        f"must come in the plant's order ({', '.join(names)})",
        f"({', '.join(labels)})",
    )
    for name, label in zip(names, labels, strict=True):
        field = f"records[{record.name}].{kind}[{label}]"
        _check_unit(field, record, label, plant.units.get(name), name)


def unit_notes(plant: Plant, records: Sequence[Record]) -> list[str]:
    """A sentence for each channel whose unit in its file cannot be compared with the plant's.

    And where its rates are in another unit of time than that in which the records count.

    Args:
        plant: with units.
        records: that `check_records` has accepted.
    """
    channels = plant.inputs + plant.outputs
    pairs = {
        (label, header, plant.units[name])
        for record in records
        for name, label in zip(channels, record.input_names + record.output_names, strict=True)
        if (header := (record.file_units or {}).get(label)) and name in plant.units
    }
    sentences = [
        f"{label} is in {header!r} in its file and in {unit!r} in the model: whether these are one "
        "unit is not known. If they are, give it by `units`"
        for label, header, unit in sorted(pairs)
        if units_agree(header, unit) is None
    ]
    rates = unit_of_rates(plant.units.get(name, "") for name in plant.names)
    counted_in = {(record.file_units or {}).get("time", "") for record in records}
    if rates and counted_in == {"s"}:
        sentences.append(
            f"rates of the model are declared per {rates}, and the records count time in s: what "
            "is fitted is per s, unless the equations convert it. Where the model counts time in "
            f"{rates}, give the time a `scale` that makes it {rates} (1, of a column in {rates})"
        )
    return sentences


def _check_places(plant: Plant, record: Record) -> None:
    """Check that no output is among the inputs while an input is among the outputs, by name."""
    u, y = record.input_names, record.output_names
    if (u, y) == (numbered_names("u", len(u)), numbered_names("y", len(y))):
        return  # these are no names of anything
    foreign = [name for name in u if name in plant.outputs and name not in plant.inputs]
    mistaken = [name for name in y if name in plant.inputs and name not in plant.outputs]
    check(
        not (foreign and mistaken),
        f"records[{record.name}].inputs",
        f"must hold the plant's inputs ({', '.join(plant.inputs)}), and `outputs` its outputs "
        f"({', '.join(plant.outputs)})",
        f"the output {', '.join(foreign)} as an input and the input {', '.join(mistaken)} as an "
        "output",
        "Give the inputs first: `Record(time, inputs, outputs)`.",
    )


def _check_unit(field: str, record: Record, label: str, expected: str | None, name: str) -> None:
    """A channel must be in the unit of the plant, as far as its caller or its file gives one."""
    if expected is None:
        return
    unit, header = record.units.get(label), (record.file_units or {}).get(label, "")
    rule = f"must be in the plant's unit for `{name}`, {expected!r}"
    advice = "Convert the column, or correct the unit."
    check(unit is None or same_unit(unit, expected), field, rule, repr(unit), advice)
    advice = (
        "Convert the column by `scale` (a temperature by [factor, offset]), or name the right one; "
        "or give its unit by `units`, if it is not that of the file."
    )
    pair = temperature_conversion(header, expected)
    if pair is not None:
        advice = f"Their zeros differ: give the column the `scale` [{pair[0]:.10g}, {pair[1]:.10g}]"
        advice += ", a factor and an offset; [1, 0], if it is not in the unit of the file."
    value = f"{header!r} in its file"
    check(units_agree(header, expected) is not False, field, rule, value, advice)


def _extra_inputs(names: Sequence[str], labels: Sequence[str]) -> str:
    """What to do with inputs that the plant does not read, or where a record has none."""
    if not labels:
        return "Write `inputs=()` in `Plant` for a system without input."
    extra = [label for label in labels if label not in names]
    if len(labels) - len(extra) != len(names):
        return ""
    listed = ", ".join(f'"{label}"' for label in extra)
    return f"Leave the others out: `record.without_inputs({listed})`."
