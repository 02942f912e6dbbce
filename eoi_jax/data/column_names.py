"""What the name of a column says of it: its words, and the role that they stand for."""

import re
from collections.abc import Iterable, Sequence

import numpy as np

_INPUT = frozenset((
    "u", "in", "input", "inputs", "volt", "volts", "voltage", "cmd", "command", "pwm", "duty",
    "torque", "tau", "force", "ref", "reference", "referencia", "target", "setpoint", "drive",
    "control", "throttle", "pump", "valve", "heater", "power", "demand", "ctrl", "act",
    "actuator", "current", "v", "vir", "steer", "excitation", "ventil", "stellgrad", "pumpe",
    "ventilstellung", "vanne", "válvula", "valvola",
))  # fmt: skip
# Those that a plant without input has as its output: of a capacitor, a muscle, a solar cell.
_EITHER = frozenset((
    "volt", "volts", "voltage", "v", "current", "force", "torque", "tau", "power",
))  # fmt: skip
_OUTPUT = frozenset((
    "y", "out", "output", "outputs", "angle", "angulo", "winkel", "pos", "position", "theta",
    "phi", "alpha", "q", "qm", "x", "level", "height", "h", "speed", "vel", "velocity", "rate",
    "omega", "rpm", "temp", "temperature", "pressure", "meas", "measured", "enc", "encoder",
    "sensor", "dist", "distance", "displacement", "response", "imu", "gyro", "accelerometer",
    "acceleration",
))  # fmt: skip
# What a controller is to reach or sends, wherever the word stands: `speed_cmd`, `Tsoll`.
_REFERENCES = frozenset((
    "ref", "refs", "reference", "referencia", "référence", "riferimento", "target", "setpoint",
    "sp", "demand", "desired", "des", "wanted", "goal", "soll", "sollwert", "consigne", "consigna",
    "objetivo", "ziel",
))  # fmt: skip
_COMMANDS = frozenset((
    "cmd", "command", "commanded", "befehl", "commande", "comando", "stellgroesse", "stellgröße",
    "stellwert",
))  # fmt: skip
# What is around a plant or comes to it, which it cannot move: `T_amb`, `wind speed`, `feed_flow`.
_SURROUNDINGS = frozenset((
    "ambient", "amb", "outdoor", "outside", "exterior", "weather", "umgebung", "aussen", "außen",
    "sun", "solar", "insolation", "irradiance", "irradiation", "sonne", "wind", "rain", "regen",
    "feed", "inlet", "inflow", "influent", "zulauf", "door", "vent",
))  # fmt: skip
# The same as the first part of one word: Außentemperatur, Globalstrahlung.
_AROUND = ("aussen", "außen", "umgebung", "sonnen", "wetter", "global", "outdoor", "outside")
_TAG = re.compile(r"^[A-Z]{1,4}[- ]?\d{2,}[A-Z]?\s+(?=[^\W\d])")
_WORD = re.compile(r"[A-ZÀ-ÖØ-Þ]?[a-zµß-öø-ÿ]+|[A-ZÀ-ÖØ-Þ]+")  # letters of Latin-1
_DEGREES = frozenset(("°C", "degC", "K", "°F", "degF"))
_TEMPERATURES = frozenset((
    "temp", "temps", "temperature", "temperatures", "temperatur", "température", "temperatura",
))  # fmt: skip
_PORT = re.compile(r"[fipquvw](in|out)")  # Vin, Qout: of a converter, of a tank
_ENDINGS = ("soll", "sollwert", "setpoint", "cmd", "ref", "consigne", "consigna")


def stem(name: str) -> str:
    """The name of a column without path and unit: ``motorVoltage_2`` of ``log.motorVoltage_2 [V]``.

    Args:
        name: any text; one with spaces is no path.
    """
    return _path(name)[-1]


def in_other_units(name: str, names: Sequence[str]) -> list[str]:
    """Names that differ in the unit only; without any those that share the end of the path.

    Args:
        name: of a column.
        names: of others.
    """
    equal = [entry for entry in names if _path(entry) == _path(name)]
    return equal or [entry for entry in names if stem(entry) == stem(name)]


# What an instrument's tag ends with: process value, set point, output, …
_ATTRIBUTES = ("pv", "sp", "op", "mv", "cv", "out", "in", "val", "value", "act", "ist", "soll")


def short_names(names: Sequence[str]) -> list[str]:
    """Names without units and paths that still tell the columns apart.

    ``log.u [V]`` is u; an attribute keeps its instrument, as in ``TIC101.PV``; and names that would
    be one keep their paths.

    Args:
        names: of columns.
    """
    paths = [_path(name) for name in names]
    ends = [path[-2 if path[-1].lower() in _ATTRIBUTES else -1 :] for path in paths]
    pairs = zip(paths, ends, strict=True)
    return [".".join(path if ends.count(end) > 1 else end) for path, end in pairs]


def _path(name: str) -> list[str]:
    """The parts of a name without unit; one with spaces is no path."""
    plain = _without_unit(name)
    return [plain] if " " in plain else re.split(r"[./]", plain)


def is_reference(name: str) -> bool:
    """Whether a name stands for what a controller is to reach.

    Args:
        name: of a column.
    """
    return any(word in _REFERENCES or word.endswith(_ENDINGS) for word in _words(name))


def _words(name: str) -> list[str]:
    """The words of a name without path and unit: motor, voltage of ``log.motorVoltage_2 [V]``."""
    return [word.lower() for word in _WORD.findall(stem(name))]


# What an OPC server or a historian says of a sample of another column.
_RATING = re.compile(r"(quality|qualität|qualitaet|flags?|valid|validity|status)$", re.IGNORECASE)
RATING = "it rates the samples of another column; those that are bad are not masked"


def rates_samples(name: str, names: Iterable[str], values: np.ndarray, good: float = 192.0) -> bool:
    """Whether a column says how good the samples of another one are: `T.quality` beside `T`.

    A status may also be that of a pump, which is an input.

    Args:
        name: of the column.
        names: of all columns.
        values: of the column.
        good: code of good samples, that of OPC.
    """
    match = _RATING.search(_without_unit(name))
    if match is None:
        return False
    rated = match.string[: match.start()].rstrip(" ._-/:")
    is_code = 2 * np.sum(values == good) > len(values)
    is_alone = not rated and match[1].lower() != "status"
    return bool(is_code) or is_alone or rated in map(_without_unit, names)


def _without_unit(name: str) -> str:
    return re.sub(r"[\[(].*", "", name).strip()


def _may_answer(name: str) -> bool:
    """Whether a plant without input may have a signal of this name as its output."""
    quantity = any(word in _EITHER for word in _words(name)) and not _is_sent(name)
    return quantity or role_of_name(name) != "input"


def _is_sent(name: str) -> bool:
    """Whether a name stands for what is sent, set or around: no answer of a plant."""
    sent = _REFERENCES | _COMMANDS | _SURROUNDINGS
    return any(
        word in sent or word.endswith(_ENDINGS) or word.startswith(_AROUND) for word in _words(name)
    )


def role_of_name(name: str) -> str:
    """The role that a name stands for: what is sent, set or around, else by its first known word.

    Args:
        name: of a column.

    Returns:
        ``"input"``, ``"output"``, or nothing.
    """
    if _is_sent(name):
        return "input"
    # Behind the tag of an instrument, Y-101, its letter says less than the words.
    for word in _words(_TAG.sub("", name)) or _words(name):
        port = _PORT.fullmatch(word)
        if port:
            return f"{port[1]}put"
        if word in _INPUT or word in _OUTPUT:
            return "input" if word in _INPUT else "output"
    return ""


def is_called_rate(name: str) -> bool:
    """Whether a name has the word rate: of turning, of an infusion, of a feed.

    Args:
        name: of a column.
    """
    return "rate" in _words(name)


def is_temperature(name: str, unit: str) -> bool:
    """Whether a column is a temperature, by its unit or a word of its name.

    Args:
        name: of a column.
        unit: as the file gives it; empty if it gives none.
    """
    units = (unit.strip(), unit_of_name(name))
    return any(known in _DEGREES for known in units) or any(
        word in _TEMPERATURES for word in _words(name)
    )


def separate_drives(roles: dict[str, tuple[str, str]], limits: dict[str, float]) -> None:
    """Make what stops at a limit an input, where there is none and another column is an output.

    A pump cannot suck, a heater cannot cool. That other one is called an output.

    Args:
        roles: with reasons, by column; changed.
        limits: of the columns that pile up at one.
    """
    guessed = [role for role, _ in roles.values()]
    if "input" in guessed or not any(role_of_name(name) == "output" for name in roles):
        return
    for name, limit in limits.items():
        if name in roles and roles[name][0] == "output" != role_of_name(name):
            roles[name] = ("input", f"it stops at {limit:.6g}, as what drives does")


def separate_references(roles: dict[str, tuple[str, str]], held: set[str]) -> None:
    """Take references out of the inputs where another input follows them; keep one output.

    Args:
        roles: with reasons, by column; changed.
        held: columns that keep their values between changes.
    """
    inputs = [key for key, (role, _) in roles.items() if role == "input"]
    references = [key for key in inputs if is_reference(key)]
    if len(references) < len(inputs):
        roles |= dict.fromkeys(references, ("other", "a reference, beside another input"))
        inputs = [key for key in inputs if key not in references]
    if any(role == "output" for role, _ in roles.values()):
        return
    if len(inputs) == len(roles) == 1 and _may_answer(inputs[0]):
        roles[inputs[0]] = ("output", "there must be one, and it is the only column")
    elif len(inputs) > 1:
        moving = [key for key in inputs if key not in held] or inputs
        unnamed = [key for key in moving if role_of_name(key) != "input"] or moving
        reason = "it comes last by its name"
        if len(unnamed) == 1:
            reason = f"it alone is not {'held' if len(moving) == 1 else 'called an input'}"
        roles[max(unnamed)] = ("output", f"there must be one, and {reason}")


# Ends of names that are units whatever stands before them.
_ENDS = {
    "rad/s": ("rad_s", "rad_per_s", "radps"), "rad/s²": ("rad_s2",),
    "deg/s": ("deg_s", "deg_per_s", "dps"), "m/s": ("m_s", "m_per_s", "mps"),
    "m/s²": ("m_s2", "mps2"),
    "mm/s": ("mm_s",), "km/h": ("km_h", "kmh"), "l/min": ("l_min",), "m³/s": ("m3_s",),
    "m³/h": ("m3_h",), "kg/s": ("kg_s",), "N m": ("N_m", "Nm"), "°F": ("degF",),
    "°C": ("degC", "degc", "celsius", "Celsius"), "K": ("kelvin", "Kelvin"), "A": ("amps",),
    "V": ("volt", "volts"), "W": ("watts",), "%": ("pct", "percent", "prozent"),
    "deg": ("degrees",), "rpm": ("RPM",), "kn": ("kts", "knots"),
}  # fmt: skip
_SPELLED = (
    "rad/s", "rad/s²", "rad/s^2", "deg/s", "m/s", "m/s²", "m/s^2", "mm/s", "km/h", "l/min", "m³/s",
    "m3/s", "m³/h", "m3/h", "kg/s", "1/min", "1/s", "°C", "°", "%", "mV", "kV", "mA", "kW", "mW",
    "mm", "cm", "µm", "rpm", "Hz", "kHz", "Pa", "hPa", "kPa", "MPa", "mbar",
)  # fmt: skip
_UNIT_OF_END = {
    **{spelling: unit for unit, spellings in _ENDS.items() for spelling in spellings},
    **{unit: unit for unit in _SPELLED},
}
# Ends that may mean something else (motor A, gain K, x measured, solar radiation): the words before
# them of which they are the unit.
_WORDS_OF_END = {
    "A": r"i|id|iq|current|strom|courant|corriente|corrente",
    "V": r"u|v|ud|uq|volt|voltage|spannung|tension|voltaje|tensione",
    "K": r"t|temp|temperature|temperatur|temperatura|température",
    "C": r"temp|temperature|temperatur|temperatura|température",
    "N": r"f|force|kraft|fuerza|forza|thrust|load",
    "W": r"p|power|leistung|puissance|potencia|potenza|heizleistung|heating|heater|heizung",
    "m": r"pos|position|displacement|distance|weg|lage|level|height|hoehe|höhe|pegel|niveau|nivel",
    "bar": r"p|pressure|druck|pression|presion",
    "rad": r"angle|pos|position|theta|phi|alpha|winkel|encoder|enc",
    "deg": r"angle|pos|position|theta|phi|alpha|winkel|encoder|enc",
    **dict.fromkeys(("kn", "kt"), r"speed|velocity|sog|stw|wind|geschwindigkeit|fahrt|vitesse"),
}
_SHOWN_END = {"C": "°C", "kt": "kn"}
_COUNTING = ("A", "C", "N", "V")  # sensor A, B, C; number N: the word must be the one before


_PER_TIME = re.compile(
    r"(/|\bper\b)\s*(ms|s|sec|min|h|hr|d|day)(?![a-z])|\b(ms|s|min|h|d)\s*(⁻¹|\^?-1)"
)


def is_per_time(unit: str) -> bool:
    """Whether a unit is one per time, as that of a rate: ``mg/h``.

    Args:
        unit: as a file gives it; empty if it gives none.
    """
    return bool(_PER_TIME.search(unit))


def unit_of_name(name: str) -> str:
    """The unit at the end of a name without brackets: ``voltage_V``, ``speed rad/s``; or nothing.

    Units of time are left out, and a single letter counts only behind a word of its quantity:
    ``I_A``, but not ``motor_A``.

    Args:
        name: of a column.
    """
    if name.rstrip()[-1:] in ("]", ")"):
        return ""
    parts = re.split(r"[_\s]+", name.strip())
    for count in (3, 2, 1):
        head, end = parts[:-count], "_".join(parts[-count:])
        if not any(re.search(r"[^\W\d]", word) for word in head):
            continue
        if end in _UNIT_OF_END:
            return _UNIT_OF_END[end]
        words = _words("_".join(head))
        candidates = words[-1:] if end in _COUNTING else words
        if any(re.fullmatch(_WORDS_OF_END.get(end, "(?!)"), word) for word in candidates):
            return _SHOWN_END.get(end, end)
    return ""
