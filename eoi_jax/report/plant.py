"""A model as text: its channels, its equations, and a table of its parameters."""

from typing import Any

import equinox as eqx
import numpy as np

from eoi_jax.compiler.jax_private import Tracer
from eoi_jax.models.equations.display import equation_text
from eoi_jax.models.plant import Plant
from eoi_jax.report.tables import columns


def plant_text(plant: Plant) -> str:
    """Inputs and outputs with units, the equations, and a line for each parameter.

    The equations are traced, not compiled. Values that JAX traces, or that several plants side by
    side have, are shown as their type.

    Args:
        plant: any.
    """
    kinds = (("input", plant.inputs), ("output", plant.outputs))
    channels = [
        f"{kind}{'s' * (len(names) > 1)} {', '.join(_label(plant, name) for name in names)}"
        for kind, names in kinds
        if names
    ]
    lines = [f"Plant `{plant.name}`: {'; '.join(channels)}"]
    lines += [f"  {line}" for line in equation_text(plant).splitlines()]
    if plant.actuator is not None:
        lines.append("  with inputs that are delayed or filtered before they act")
    lines += ["", *_parameter_table(plant).splitlines()] if plant.names else []
    return "\n".join(lines)


def _label(plant: Plant, name: str) -> str:
    unit = plant.units.get(name)
    return f"{name} [{unit}]" if unit else name


def _parameter_table(plant: Plant) -> str:
    """Name, value, bounds and unit; columns of which nothing is declared are left out."""
    limits = zip(_cells(plant, plant.lower), _cells(plant, plant.upper), strict=True)
    bounds = ["" if pair == ("-inf", "inf") else f"[{', '.join(pair)}]" for pair in limits]
    table = (
        ("parameter", plant.names, "<"),
        ("value", _cells(plant, plant.theta), ">"),
        ("bounds", bounds, "<"),
        ("", ["fixed" if name in plant.fixed else "" for name in plant.names], "<"),
        ("unit", [plant.units.get(name, "") for name in plant.names], "<"),
    )
    declared = [column for column in table if any(column[1])]
    rows = zip(*([title, *cells] for title, cells, _ in declared), strict=True)
    return columns([list(row) for row in rows], "".join(column[2] for column in declared))


def _cells(plant: Plant, values: Any) -> list[str]:
    """One number a parameter; their type where there are none."""
    count = len(plant.names)
    if isinstance(values, Tracer) or np.shape(values) != (count,):
        return [eqx.tree_pformat(values)] * count
    return [f"{float(value):.6g}" for value in np.asarray(values)]
