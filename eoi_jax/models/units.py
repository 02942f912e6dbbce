"""Units of derivatives and quotients, as text; what a text says in SI base units, and spellings."""

import math
import re
from collections.abc import Iterable, Iterator, Mapping
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


_TORQUE = Dimension(1.0, {"kg": 1, "m": 2, "s": -2})
_POWER = Dimension(1.0, {"kg": 1, "m": 2, "s": -3})
_PRESSURE = Dimension(1.0, {"kg": 1, "m": -1, "s": -2})
_VOLUME = Dimension(1.0, {"m": 3})
_REVOLUTION = Dimension(2.0 * math.pi, {"rad": 1})
_SPEED = Dimension(1.0, {"m": 1, "s": -1})
_PER_SECOND = Dimension(1.0, {"s": -1})


def _scaled(unit: Dimension, factor: float, *names: str) -> dict[str, Dimension]:
    """Names of a unit that is a multiple of another one."""
    return dict.fromkeys(names, Dimension(factor).times(unit))


_PREFIXED = {  # units that take a prefix
    "rad": Dimension(1.0, {"rad": 1}),
    "m": Dimension(1.0, {"m": 1}),
    "s": Dimension(1.0, {"s": 1}),
    "g": Dimension(1e-3, {"kg": 1}),
    "A": Dimension(1.0, {"A": 1}),
    "V": Dimension(1.0, {"kg": 1, "m": 2, "s": -3, "A": -1}),
    "ohm": Dimension(1.0, {"kg": 1, "m": 2, "s": -3, "A": -2}),
    "N": Dimension(1.0, {"kg": 1, "m": 1, "s": -2}),
    "K": Dimension(1.0, {"K": 1}),
    "mol": Dimension(1.0, {"mol": 1}),
    "J": _TORQUE,
    **_scaled(_TORQUE, 3600.0, "Wh"),
    **_scaled(_TORQUE, 4.184, "cal"),
    **_scaled(_POWER, 1.0, "W", "VA"),
    **_scaled(_PRESSURE, 1.0, "Pa"),
    **_scaled(_PRESSURE, 1e5, "bar"),
    **_scaled(_VOLUME, 1e-3, "l", "L"),
    "Ah": Dimension(3600.0, {"A": 1, "s": 1}),
    "Hz": _REVOLUTION.times(_PER_SECOND),
}
_UNITS = {
    **_PREFIXED,
    "1": Dimension(),
    **dict.fromkeys(("%", "percent"), Dimension(1.0, {"%": 1})),
    "‰": Dimension(0.1, {"%": 1}),
    "ppm": Dimension(1e-4, {"%": 1}),
    **dict.fromkeys(("deg", "°", "degree", "degrees"), Dimension(math.pi / 180.0, {"rad": 1})),
    "rev": _REVOLUTION,
    **_scaled(_REVOLUTION.times(_PER_SECOND), 1.0, "rps"),
    **_scaled(_REVOLUTION.times(_PER_SECOND), 1.0 / 60.0, "rpm"),
    **dict.fromkeys(("sec", "second", "seconds"), Dimension(1.0, {"s": 1})),
    **dict.fromkeys(("min", "minute", "minutes"), Dimension(60.0, {"s": 1})),
    **dict.fromkeys(("h", "hr", "hour", "hours"), Dimension(3600.0, {"s": 1})),
    **dict.fromkeys(("d", "day", "days"), Dimension(86400.0, {"s": 1})),
    "t": Dimension(1e3, {"kg": 1}),
    **dict.fromkeys(("lb", "lbs"), Dimension(0.45359237, {"kg": 1})),
    "in": Dimension(0.0254, {"m": 1}),
    "inch": Dimension(0.0254, {"m": 1}),
    "ft": Dimension(0.3048, {"m": 1}),
    **_scaled(_SPEED, 0.44704, "mph"),
    **_scaled(_SPEED, 1.0 / 3.6, "kph", "kmh"),
    **_scaled(_SPEED, 1852.0 / 3600.0, "kn", "kt", "kts", "knot", "knots"),
    **_scaled(_VOLUME, 3.785411784e-3, "gal"),  # of the United States
    **_scaled(_VOLUME.times(_PER_SECOND), 3.785411784e-3 / 60.0, "gpm"),
    **_scaled(_VOLUME.times(_PER_SECOND), 1e-3 / 60.0, "lpm", "LPM"),
    **_scaled(_PRESSURE, 6894.757293168, "psi"),
    **_scaled(_PRESSURE, 101325.0, "atm"),
    **_scaled(_PRESSURE, 133.322387415, "mmHg"),
    **_scaled(_TORQUE, 1055.05585262, "BTU", "Btu", "btu"),
    **_scaled(_POWER, 745.6998715822702, "hp"),
    "°C": Dimension(1.0, {"K": 1}),  # in products; alone, their zeros differ
    "°F": Dimension(5.0 / 9.0, {"K": 1}),
}
# Without nano: nm is also written for N m.
_PREFIXES = {"G": 1e9, "M": 1e6, "k": 1e3, "h": 1e2, "d": 1e-1, "c": 1e-2, "m": 1e-3}
_PREFIXES |= {"µ": 1e-6, "u": 1e-6}
_COMPOUNDS = {"Nm": "N m", "Nms": "N m s", "Ns": "N s", "kgm": "kg m"}
_NORMAL_VOLUME = "Nm^3"  # of a gas at normal conditions, not a product with newtons
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
    "º": "°",  # the ordinal sign
    "Ω": "ohm",
    "Ohm": "ohm",
}
_WHOLE_SPELLINGS = {
    **dict.fromkeys(("C", "deg C", "° C", "Celsius", "celsius"), "°C"),
    **dict.fromkeys(("F", "deg F", "° F", "Fahrenheit", "fahrenheit"), "°F"),
    "U/min": "rpm",
}
_GAUGE = re.compile(r"(bar|psi) ?\(?[ag]\)?$")  # absolute, or above that of the air: not grams
_NOTHING = ("", "-", "–", "—")
_REMARKS = ("min", "in")  # also the minimum, or an inlet
# Size of a degree, and the zero [K]. ISO 80000-5.
_KELVINS = {"°C": (1.0, 273.15), "°F": (5.0 / 9.0, 459.67 * 5.0 / 9.0), "K": (1.0, 0.0)}
_TEMPERATURES = tuple(_KELVINS)  # of which the zeros differ
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
    return Dimension(product.factor, _without_radians(product))


def same_unit(first: str, second: str) -> bool:
    """Whether two texts are one unit: N m and Nm, m/s² and m s^-2, deg and °, J and N m.

    A word that is not understood, such as bar, is a unit of its own. Radians are not 1 here: what
    is in 1/s may count revolutions.

    Args:
        first: as text.
        second: as text.
    """
    left_text, right_text = _spelled(first), _spelled(second)
    if all(text in _TEMPERATURES for text in (left_text, right_text)):
        return left_text == right_text
    units = [_read(text, any_word=True) for text in (left_text, right_text)]
    if units[0] is None or units[1] is None:
        return left_text == right_text
    return units[0].powers == units[1].powers and math.isclose(units[0].factor, units[1].factor)


def units_agree(first: str, second: str) -> bool | None:
    """Whether a channel that is said to be in one unit may be in another one.

    False for other units of one quantity (mm and cm, °F and °C) and for another quantity (kW and
    %). Where radians may count as 1, or 1/min as revolutions, they agree. "" and "-" say nothing
    and agree with any unit, but "-" may stand for a fraction of which % is another one.

    Args:
        first: as text.
        second: as text.

    Returns:
        None where it is not known: one of the texts is not understood, may be a remark (min for a
        minimum) or is 1, or - beside %, which may stand for any fraction.
    """
    texts = _spelled(first), _spelled(second)
    is_share = any(getattr(_read(text), "powers", {}).keys() == {"%"} for text in texts)
    if is_share and any(text in _NOTHING[1:] for text in texts):
        return None
    if any(text in _NOTHING for text in texts) or same_unit(first, second):
        return True
    if all(text in _TEMPERATURES for text in texts):
        return False
    left_unit, right_unit = map(_read, texts)
    if left_unit is None or right_unit is None:
        return None
    turns = [
        unit.factor / (2.0 * math.pi) ** unit.powers.get("rad", 0)
        for unit in (left_unit, right_unit)
    ]
    alike = _without_radians(left_unit) == _without_radians(right_unit)
    if alike and (math.isclose(left_unit.factor, right_unit.factor) or math.isclose(*turns)):
        return True
    is_remark = any(text in _REMARKS for text in texts) and not alike
    return None if is_remark or "1" in texts else False


def temperature_conversion(first: str, second: str) -> tuple[float, float] | None:
    """Factor and offset from one unit of temperature to another: °C = 5/9 °F - 160/9.

    Args:
        first: as text.
        second: as text.

    Returns:
        None unless both are °C, °F or K.
    """
    pair = [_KELVINS.get(_spelled(text)) for text in (first, second)]
    if pair[0] is None or pair[1] is None:
        return None
    (size, zero), (other_size, other_zero) = pair[0], pair[1]
    return size / other_size, (zero - other_zero) / other_size


def unit_of_rates(units: Iterable[str]) -> str:
    """The unit of time, other than s, in which all rates and time constants among units are.

    Args:
        units: as texts; those of other quantities, and what counts turns, are passed over.

    Returns:
        min, h, d; "" where they are in s, in several, or where there is none.
    """
    seconds = set()
    for unit in units:
        product = _read(_spelled(unit))
        if product is not None and product.powers.keys() == {"s"}:
            seconds.add(round(product.factor ** (1.0 / product.powers["s"]), 6))
    names = {60.0: "min", 3600.0: "h", 86400.0: "d"}
    return names.get(seconds.pop(), "") if len(seconds) == 1 else ""


def _without_radians(unit: Dimension) -> dict[str, int]:
    """The powers of the base units."""
    return {base: count for base, count in unit.powers.items() if base != "rad"}


def _spelled(unit: str) -> str:
    """A unit in one spelling of its signs, powers and spaces."""
    for spelling in sorted(_SPELLINGS, key=len, reverse=True):
        unit = unit.replace(spelling, _SPELLINGS[spelling])
    unit = " ".join(re.sub(r"(?<=[A-Za-zµ°])-?\d", r"^\g<0>", unit).split())
    return _WHOLE_SPELLINGS.get(unit, unit)


def _read(unit: str, any_word: bool = False) -> Dimension | None:
    """The product that a unit is, in one spelling; None where it is not understood."""
    if _GAUGE.match(unit):
        return None
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
    if token == _NORMAL_VOLUME:
        return None
    if name in _COMPOUNDS:
        first, last = _COMPOUNDS[name].rsplit(" ", 1)
        ending = _factor(f"{last}^{power or 1}", any_word)
        return None if ending is None else ending.times(_read(first) or Dimension())
    unit = _UNITS.get(name)
    if unit is None and name[:1] in _PREFIXES and name[1:] in _PREFIXED:
        unit = Dimension(_PREFIXES[name[0]]).times(_PREFIXED[name[1:]])
    if unit is None and any_word and name.strip("°").isalpha():
        unit = Dimension(1.0, {name: 1})
    return None if unit is None else Dimension().times(unit, int(power or 1))
