"""Records must suit the plant that is to be fitted to them."""

from collections.abc import Iterable, Sequence

from eoi_jax._checks import check, check_kind
from eoi_jax.compiler.jax_setup import check_process
from eoi_jax.data.record import Record
from eoi_jax.models.plant import Plant


def check_records(plant: Plant, records: Record | Sequence[Record]) -> tuple[Record, ...]:
    """One or several records as a tuple, checked against the plant's channels and units.

    Raises:
        ValueError: a forked process, no plant, no record, another number of channels, channels in
            another order, other units.
    """
    check_process()
    check_kind("plant", plant, Plant, "a Plant")
    if isinstance(records, Record):
        records = (records,)
    check_kind("records", () if records is None else records, Iterable, "a Record or several")
    several = tuple(records or ())
    check(len(several) > 0, "records", "must hold at least one record", "none")
    for one in several:
        check_kind("records", one, Record, "a Record or several")
    for record in several:
        for kind, names, own, signals in (
            ("inputs", plant.inputs, record.input_names, record.inputs),
            ("outputs", plant.outputs, record.output_names, record.outputs),
        ):
            check(
                signals.shape[1] == len(names),
                f"records[{record.name}].{kind}",
                f"must have {len(names)} channels ({', '.join(names)}) for `{plant.name}`",
                f"{signals.shape[1]} ({', '.join(own)})",
            )
            same = set(own) == set(names)
            check(
                not same or tuple(own) == tuple(names),
                f"records[{record.name}].{kind}",
                f"must come in the plant's order ({', '.join(names)})",
                f"({', '.join(own)})",
            )
            for name, mine in zip(names, own, strict=True):
                unit, want = record.units.get(mine), plant.units.get(name)
                check(
                    unit is None or want is None or unit == want,
                    f"records[{record.name}].{kind}[{mine}]",
                    f"must be in the plant's unit for `{name}`, {want!r}",
                    repr(unit),
                    "Convert the column, or correct the unit.",
                )
    return several
