"""Angles in degrees where a function takes radians."""

from collections.abc import Mapping
from dataclasses import dataclass

from eoi_jax._checks import check
from eoi_jax.compiler.graph import Node, Untranslatable, topological_order
from eoi_jax.models.equations.from_plant import SymbolicPlant
from eoi_jax.models.plant import Plant
from eoi_jax.models.units import same_unit


@dataclass(frozen=True)
class AngleSettings:
    """What counts as an angle in degrees that was not converted.

    Attributes:
        functions: that take radians.
        smallest: factor of the angle from which on it is no conversion, which is 0.0175; a half
            of the angle is one.
    """

    functions: tuple[str, ...] = ("sin", "cos", "tan")
    smallest: float = 0.1


_SETTINGS = AngleSettings()


def check_angles(plant: Plant, units: Mapping[str, str]) -> None:
    """Check that no sine, cosine or tangent is taken of an angle in degrees.

    Args:
        plant: whose f and g are searched.
        units: of its inputs and outputs, by name.

    Raises:
        ValueError: an angle in degrees enters such a function as it is.
    """
    angles = {name for name, unit in units.items() if same_unit(unit, "deg")}
    if not angles:
        return
    symbolic = SymbolicPlant(plant)
    try:
        nodes = symbolic.nodes(plant.derivative)
        nodes += symbolic.nodes(plant.internal_rate) if plant.internal is not None else []
    except Untranslatable:
        return
    for node in topological_order(nodes):
        if node.op not in _SETTINGS.functions:
            continue
        for name, factor in _factors(node.args[0]).items():
            check(
                name not in angles or abs(factor) < _SETTINGS.smallest,
                f"model.units[{name}]",
                f"must be rad, of which {node.op} is taken in the model of `{plant.name}`",
                units.get(name, ""),
                f"Write {node.op}({name}*pi/180) there, or convert the column to rad.",
            )


def _factors(node: Node) -> dict[str, float]:
    """Constant factors of the inputs and outputs in a sum; what is no such term is left out."""
    if node.op == "input":
        symbol = node.value
        return {} if symbol.parameter or symbol.order else {symbol.name: 1.0}
    if node.op in ("add", "sub", "neg"):
        sign = 1.0 if node.op == "add" else -1.0
        first = _factors(node.args[0])
        if node.op == "neg":
            return {name: -factor for name, factor in first.items()}
        second = _factors(node.args[1])
        return {
            name: first.get(name, 0.0) + sign * second.get(name, 0.0) for name in (*first, *second)
        }
    if node.op not in ("mul", "div"):
        return {}
    terms = node.args[::-1] if node.op == "mul" and node.args[0].op == "constant" else node.args
    if terms[1].op != "constant":
        return {}
    scale = terms[1].value if node.op == "mul" else 1.0 / terms[1].value
    return {name: scale * factor for name, factor in _factors(terms[0]).items()}
