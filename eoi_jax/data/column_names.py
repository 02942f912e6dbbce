"""What the name of a column says of it: its words, and the role that they stand for."""

import re

_INPUT = frozenset((
    "u", "in", "input", "inputs", "volt", "volts", "voltage", "cmd", "command", "pwm", "duty",
    "torque", "tau", "force", "ref", "reference", "referencia", "target", "setpoint", "drive",
    "control", "throttle", "pump", "valve", "heater", "power", "demand", "ctrl", "act",
    "actuator", "current", "v", "vir", "steer", "excitation",
))  # fmt: skip
_OUTPUT = frozenset((
    "y", "out", "output", "outputs", "angle", "angulo", "winkel", "pos", "position", "theta",
    "phi", "alpha", "q", "qm", "x", "level", "height", "h", "speed", "vel", "velocity", "rate",
    "omega", "rpm", "temp", "temperature", "pressure", "meas", "measured", "enc", "encoder",
    "sensor", "dist", "distance", "displacement", "response",
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
_ENDINGS = ("soll", "sollwert", "setpoint", "cmd", "ref", "consigne", "consigna")


def stem(name: str) -> str:
    """The name of a column without path and unit: ``motorVoltage_2`` of ``log.motorVoltage_2 [V]``.

    Args:
        name: any text; one with spaces is no path.
    """
    plain = re.sub(r"[\[(].*", "", name).strip()
    return plain if " " in plain else re.split(r"[./]", plain)[-1]


def is_reference(name: str) -> bool:
    """Whether a name stands for what a controller is to reach.

    Args:
        name: of a column.
    """
    return any(word in _REFERENCES or word.endswith(_ENDINGS) for word in _words(name))


def _words(name: str) -> list[str]:
    """The words of a name without path and unit: motor, voltage of ``log.motorVoltage_2 [V]``."""
    return [word.lower() for word in re.findall(r"[A-Z]?[a-zµ]+|[A-Z]+", stem(name))]


def role_of_name(name: str) -> str:
    """The role that a name stands for, by what is sent or set, else by its first known word.

    Args:
        name: of a column.

    Returns:
        ``"input"``, ``"output"``, or nothing.
    """
    words = _words(name)
    if any(word in _REFERENCES | _COMMANDS or word.endswith(_ENDINGS) for word in words):
        return "input"
    for word in words:
        if word in _INPUT or word in _OUTPUT:
            return "input" if word in _INPUT else "output"
    return ""
