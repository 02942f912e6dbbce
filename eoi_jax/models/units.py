"""Units of derivatives and quotients, as text; what a text says in SI base units."""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

_RAISED = {1: "", 2: "²", 3: "³", 4: "⁴"}


def derivative_unit(unit: str | None, order: int) -> str:
    """The unit of a time derivative: m/s² for m and order 2, or m/s and order 1; "" for none."""
    if not unit:
        return ""
    present = next((n for n, raised in _RAISED.items() if unit.endswith(f"/s{raised}")), 0)
    order += present
    base = unit.removesuffix(f"/s{_RAISED[present]}") if present else unit
    return f"{base}/s{_RAISED.get(order, f'^{order}')}" if order else unit


def quotient_unit(unit: str, divisor: str) -> str:
    """Quotient of two units: a power of 1/s if `unit` is a derivative of `divisor`; "" for none."""
    if not unit or not divisor:
        return ""
    orders = (n for n in range(5) if derivative_unit(divisor, n) == unit)
    plain = f"{unit}/({divisor})" if "/" in divisor else f"{unit}/{divisor}"
    return next((derivative_unit("1", n) for n in orders), plain)


@dataclass(frozen=True)
class Dimension:
    """A unit in SI base units; radians are 1.

    Attributes:
        factor: of the unit, to base units.
        powers: of the base units, without zeros.
    """

    factor: float = 1.0
    powers: Mapping[str, int] = field(default_factory=dict)

    def times(self, other: "Dimension", power: int = 1) -> "Dimension":
        """The product with a power of another one.

        Args:
            other: any.
            power: of `other`.
        """
        powers = dict(self.powers)
        for base, count in other.powers.items():
            powers[base] = powers.get(base, 0) + power * count
        kept = {base: count for base, count in powers.items() if count}
        return Dimension(self.factor * other.factor**power, kept)


_UNITS = {
    "1": Dimension(),
    "rad": Dimension(),
    "deg": Dimension(math.pi / 180.0),
    "°": Dimension(math.pi / 180.0),
    "rev": Dimension(2.0 * math.pi),
    "m": Dimension(1.0, {"m": 1}),
    "s": Dimension(1.0, {"s": 1}),
    "min": Dimension(60.0, {"s": 1}),
    "g": Dimension(1e-3, {"kg": 1}),
    "A": Dimension(1.0, {"A": 1}),
    "V": Dimension(1.0, {"kg": 1, "m": 2, "s": -3, "A": -1}),
    "N": Dimension(1.0, {"kg": 1, "m": 1, "s": -2}),
    "J": Dimension(1.0, {"kg": 1, "m": 2, "s": -2}),
    "W": Dimension(1.0, {"kg": 1, "m": 2, "s": -3}),
}
_PREFIXES = {"k": 1e3, "c": 1e-2, "m": 1e-3, "µ": 1e-6, "μ": 1e-6, "u": 1e-6}
_COMPOUNDS = {"Nm": "N m", "Nms": "N m s", "Ns": "N s", "kgm": "kg m"}
_SPELLINGS = {
    **dict.fromkeys("·⋅*", " "),
    "²": "^2",
    "³": "^3",
    "⁴": "^4",
    "⁻¹": "^-1",
    "⁻²": "^-2",
    "**": "^",
}
_TOKEN = re.compile(r"[A-Za-zµμ°]+(?:\^-?\d)?|\S")


def dimension(unit: str) -> Dimension | None:
    """What a unit is in SI base units; None where it is not understood.

    A quotient sign applies to the factor behind it: ``N m s/rad``, ``rad/s²/V``, ``rad/(s² V)``.

    Args:
        unit: as text; "" is not understood.
    """
    for spelling in sorted(_SPELLINGS, key=len, reverse=True):
        unit = unit.replace(spelling, _SPELLINGS[spelling])
    tokens = iter(_TOKEN.findall(unit))
    closed = unit.count("(") == unit.count(")")
    product = _product(tokens) if unit.strip() and closed else None
    return None if next(tokens, None) else product


def _product(tokens: Iterator[str]) -> Dimension | None:
    """The product of factors, up to the end or a closing bracket."""
    product, power = Dimension(), 1
    for token in tokens:
        if token == "/":
            power = -1
        elif token == ")":
            break
        else:
            factor = _product(tokens) if token == "(" else _factor(token)
            if factor is None:
                return None
            product, power = product.times(factor, power), 1
    return product


def _factor(token: str) -> Dimension | None:
    """A unit, with a prefix or without, and its power; or several units that are run together."""
    name, _, power = token.partition("^")
    if name in _COMPOUNDS:
        first, last = _COMPOUNDS[name].rsplit(" ", 1)
        ending = _factor(f"{last}^{power or 1}")
        return None if ending is None else ending.times(dimension(first) or Dimension())
    unit = _UNITS.get(name)
    if unit is None and name[:1] in _PREFIXES and name[1:] in _UNITS:
        unit = Dimension(_PREFIXES[name[0]]).times(_UNITS[name[1:]])
    return None if unit is None else Dimension().times(unit, int(power or 1))
