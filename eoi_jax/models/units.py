"""Units of derivatives and quotients, as text; what a text says in SI base units, and spellings."""

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
    """A unit in SI base units.

    Attributes:
        factor: of the unit, to base units.
        powers: of the base units and of radians, without zeros.
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
    "rad": Dimension(1.0, {"rad": 1}),
    **dict.fromkeys(("deg", "°", "degree", "degrees"), Dimension(math.pi / 180.0, {"rad": 1})),
    "rev": Dimension(2.0 * math.pi, {"rad": 1}),
    "rpm": Dimension(math.pi / 30.0, {"rad": 1, "s": -1}),
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
_PREFIXES = {"k": 1e3, "c": 1e-2, "m": 1e-3, "µ": 1e-6, "u": 1e-6}
_COMPOUNDS = {"Nm": "N m", "Nms": "N m s", "Ns": "N s", "kgm": "kg m"}
_SPELLINGS = {
    **dict.fromkeys("·⋅*", " "),
    "²": "^2",
    "³": "^3",
    "⁴": "^4",
    "⁻¹": "^-1",
    "⁻²": "^-2",
    "⁻³": "^-3",
    "**": "^",
    "−": "-",
    "μ": "µ",  # the Greek letter, and the sign of micro
    "degC": "°C",
    "degF": "°F",
}
_TEMPERATURES = ("°C", "°F", "K")  # of which the zeros differ
_TOKEN = re.compile(r"[A-Za-zµ°]+(?:\^-?\d)?|\S")


def dimension(unit: str) -> Dimension | None:
    """What a unit is in SI base units, radians being 1; None where it is not understood.

    A quotient sign applies to the factor behind it: ``N m s/rad``, ``rad/s²/V``, ``rad/(s² V)``.

    Args:
        unit: as text; "" is not understood.
    """
    product = _read(_spelled(unit))
    if product is None:
        return None
    powers = {base: count for base, count in product.powers.items() if base != "rad"}
    return Dimension(product.factor, powers)


def same_unit(first: str, second: str) -> bool:
    """Whether two texts are one unit: N m and Nm, m/s² and m s^-2, deg and °, J and N m.

    A word that is not understood, such as bar, is a unit of its own. Radians are not 1 here: what
    is in 1/s may count revolutions.

    Args:
        first: as text.
        second: as text.
    """
    left_text, right_text = _spelled(first), _spelled(second)
    units = [_read(text, any_word=True) for text in (left_text, right_text)]
    if units[0] is None or units[1] is None:
        return left_text == right_text
    return units[0].powers == units[1].powers and math.isclose(units[0].factor, units[1].factor)


def is_rescaled(first: str, second: str) -> bool:
    """Whether two texts are different units of one quantity: mm and cm, deg and rad, °F and °C.

    A word that is not understood may be something else than a unit, such as a remark.

    Args:
        first: as text.
        second: as text.
    """
    texts = _spelled(first), _spelled(second)
    if all(text in _TEMPERATURES for text in texts):
        return texts[0] != texts[1]
    units = [unit for unit in map(_read, texts) if unit is not None]
    if len(units) < len(texts) or units[0].powers != units[1].powers:
        return False
    return not math.isclose(units[0].factor, units[1].factor)


def _spelled(unit: str) -> str:
    """A unit in one spelling of its signs, powers and spaces."""
    for spelling in sorted(_SPELLINGS, key=len, reverse=True):
        unit = unit.replace(spelling, _SPELLINGS[spelling])
    return " ".join(re.sub(r"(?<=[A-Za-zµ°])-?\d", r"^\g<0>", unit).split())


def _read(unit: str, any_word: bool = False) -> Dimension | None:
    """The product that a unit is, in one spelling; None where it is not understood."""
    tokens = iter(_TOKEN.findall(unit))
    closed = unit.count("(") == unit.count(")")
    product = _product(tokens, any_word) if unit and closed else None
    return None if next(tokens, None) else product


def _product(tokens: Iterator[str], any_word: bool) -> Dimension | None:
    """The product of factors, up to the end or a closing bracket."""
    product, power = Dimension(), 1
    for token in tokens:
        if token == "/":
            power = -1
        elif token == ")":
            break
        else:
            factor = _product(tokens, any_word) if token == "(" else _factor(token, any_word)
            if factor is None:
                return None
            product, power = product.times(factor, power), 1
    return product


def _factor(token: str, any_word: bool) -> Dimension | None:
    """A unit, with a prefix or without, and its power; or several units that are run together."""
    name, _, power = token.partition("^")
    if name in _COMPOUNDS:
        first, last = _COMPOUNDS[name].rsplit(" ", 1)
        ending = _factor(f"{last}^{power or 1}", any_word)
        return None if ending is None else ending.times(_read(first) or Dimension())
    unit = _UNITS.get(name)
    if unit is None and name[:1] in _PREFIXES and name[1:] in _UNITS:
        unit = Dimension(_PREFIXES[name[0]]).times(_UNITS[name[1:]])
    if unit is None and any_word and (name.strip("°").isalpha() or name in ("%", "‰")):
        unit = Dimension(1.0, {name: 1})
    return None if unit is None else Dimension().times(unit, int(power or 1))
