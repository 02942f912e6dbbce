"""What an output is: a position, a speed, a level, … It says which effects fit it.

Declared, else by its unit, else by its name; where neither tells, the kind is unknown (``""``) and
the records decide: a signal of relative degree one that takes both signs is a speed.
"""

import re
from collections.abc import Mapping, Sequence

from eoi_jax._checks import check, check_choice

KINDS = ("position", "speed", "acceleration", "level", "temperature", "pressure", "voltage",
         "current", "force", "flow", "concentration")  # fmt: skip

# Volts and amperes tell nothing: a sensor's may stand for any quantity.
_LENGTHS = ("m", "mm", "cm", "µm", "um", "km", "in", "ft")
_ANGLES = ("rad", "mrad", "°", "deg", "degree", "degrees", "rev")
_UNITS = {
    "speed": (
        *(f"{length}/{time}" for length in (*_LENGTHS, *_ANGLES) for time in ("s", "min", "h")),
        *("km/h", "kph", "kmh", "mph", "kn", "kt", "kts", "knot", "knots"),
        *("rpm", "1/min", "min⁻¹", "U/min", "Hz"),
    ),
    "position": _ANGLES,
    "temperature": ("K", "°C", "degC", "C", "°F", "degF"),
    "pressure": ("Pa", "hPa", "kPa", "MPa", "bar", "mbar", "psi"),
    "force": ("N", "kN", "Nm", "N m", "N·m"),
    "flow": ("m³/s", "m3/s", "l/s", "l/min", "L/min", "m³/h", "kg/s", "kg/h"),
    "concentration": ("mol/l", "mol/L", "g/l", "g/L", "mg/l", "mg/L", "mol/m³", "M", "mM"),
}
_OF_UNIT = {unit: kind for kind, units in _UNITS.items() for unit in units}
# Words that occur in names of outputs, in a few languages.
_OF_NAME = {
    "speed": r"speed|velocity|velo|vel|omega|rpm|rate|geschwindigkeit|drehzahl|vitesse|velocidad",
    "position": r"position|pos|angle|displacement|winkel|weg|lage|theta|phi",
    "level": r"level|height|fuellstand|füllstand|pegel|niveau|nivel",
    "temperature": r"temp|temperature|temperatur|temperatura",
    "pressure": r"pressure|druck|pression|presion",
    "voltage": r"voltage|spannung|tension",
    "current": r"current|strom|courant|corriente",
}


def kind_of(name: str, unit: str, degree: int) -> str:
    """The kind of an output that is not declared; ``""`` where neither unit nor name tells.

    Args:
        name: of the output.
        unit: of it; "" where it is not known.
        degree: its relative degree: a length of degree one is a level, of degree two a position.
    """
    unit = unit.strip()
    if unit in _LENGTHS:
        return "level" if degree == 1 else "position"
    if unit in _OF_UNIT:
        return _OF_UNIT[unit]
    words = re.split(r"[\W_\d]+", name.lower())
    kinds = (kind for kind, pattern in _OF_NAME.items()
             if any(re.fullmatch(pattern, word) for word in words))  # fmt: skip
    return next(kinds, "")


def checked_kinds(
    kinds: Mapping[str, str], outputs: Sequence[str], units: Mapping[str, str]
) -> tuple[tuple[str, str], ...]:
    """Declared kinds by output.

    Raises:
        ValueError: a name that is no output, an unknown kind, or one that contradicts the unit.
    """
    for name, kind in kinds.items():
        check_choice("kinds", name, tuple(outputs))
        check_choice(f"kinds[{name}]", kind, KINDS)
        unit = units.get(name, "").strip()
        fitting = ("position", "level") if unit in _LENGTHS else (_OF_UNIT.get(unit, kind),)
        check(
            kind in fitting,
            f"kinds[{name}]",
            f"must fit the unit {unit}, which is that of a {' or a '.join(fitting)}",
            kind,
            "Leave it out, or correct the unit.",
        )
    return tuple(kinds.items())
