"""Conversion of columns into other units, as `scale` says: a factor, or a factor and an offset."""

import re
from collections.abc import Container, Iterable, Mapping, Sequence
from typing import TypeAlias

import numpy as np

from eoi_jax._checks import check
from eoi_jax.data.readers.table import Columns
from eoi_jax.data.resampling import Real

Scale: TypeAlias = Real | Sequence[Real]
# Units whose zeros differ: to go from one to another takes an offset.
_TEMPERATURE = re.compile(
    r"(°|º|deg\s?)\s?[CF]|[CFK]|℃|℉|(degrees?\s)?(Celsius|Fahrenheit|Kelvin)", re.IGNORECASE
)


def factor_and_offset(field: str, scale: Scale) -> tuple[float, float]:
    """The numbers f and o of ``f x + o``.

    Args:
        field: for the errors.
        scale: ``f``, or ``[f, o]``.

    Raises:
        ValueError: a number that is not finite, a factor of zero, more or fewer numbers than two.
    """
    numbers = [float(number) for number in np.atleast_1d(np.asarray(scale, float)).tolist()]
    rule = "must be a factor, or [factor, offset]"
    check(len(numbers) in (1, 2), field, rule, scale)
    factor, offset = (*numbers, 0.0)[:2]
    good = bool(np.isfinite(factor)) and factor != 0
    check(good, field, "must be finite and not zero", factor)
    check(bool(np.isfinite(offset)), field, "must have a finite offset", offset)
    return factor, offset


def scaled_columns(
    columns: Columns, scales: Mapping[str, Scale]
) -> tuple[Columns, dict[str, float]]:
    """The columns after `scale`, and its factors by column.

    Args:
        columns: that are read.
        scales: of some of them.

    Raises:
        ValueError: those of `factor_and_offset`.
    """
    pairs = {key: factor_and_offset(f"scale[{key}]", scale) for key, scale in scales.items()}
    changed = {key: factor * columns[key] + offset for key, (factor, offset) in pairs.items()}
    return columns | changed, {key: factor for key, (factor, _) in pairs.items()}


def compared_columns(
    keys: Iterable[str],
    scales: Mapping[str, Scale],
    named: Container[str],
    units: Mapping[str, str],
) -> list[str]:
    """Columns whose unit in the file is compared with that of the model.

    That are those without a `scale` and without a unit of the caller, and temperatures with a
    factor alone: it moves no zero.

    Args:
        keys: of inputs and outputs.
        scales: by column.
        named: columns whose unit the caller gives.
        units: in the file, by column.
    """
    factored = {
        key
        for key, scale in scales.items()
        if not isinstance(scale, Sequence) and _TEMPERATURE.fullmatch(units.get(key, "").strip())
    }
    return [key for key in keys if key in factored or not (key in scales or key in named)]
