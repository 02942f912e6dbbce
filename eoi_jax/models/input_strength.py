r"""Strengths of added effects in the unit of the input that drives the model.

Where $\partial f / \partial u = b$ is constant, an effect of size g in $y^{(r)}$ is as strong as an
input of $g / b$: dry friction of 2 rad/s² as 0.4 V at the motor.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eoi_jax.models.augmented import added_effects, own_states
from eoi_jax.models.effects.effect import AbstractEffect
from eoi_jax.models.jacobians import input_slopes
from eoi_jax.models.plant import Plant


@dataclass(frozen=True)
class InputStrength:
    """One parameter of an effect, as seen at an input.

    Attributes:
        parameter: its name in the plant.
        input: the only input of the equation in which it stands.
        factor: of its value, to that at the input.
        unit: of the input; "" where unknown.
    """

    parameter: str
    input: str
    factor: float
    unit: str

    def text(self, value: float) -> str:
        """``"0.4 V at the input voltage"`` for a value of the parameter."""
        return f"{value * self.factor:.4g} {self.unit}".rstrip() + f" at the input {self.input}"


def input_strengths(plant: Plant) -> tuple[InputStrength, ...]:
    """Parameters of added effects that have the unit of y^(r), and are as an input is.

    Args:
        plant: with effects, at its estimate.

    Returns:
        None of an equation with internal states, with several inputs, or with one whose slope
        depends on the state.
    """
    return tuple(
        strength
        for placed in added_effects(plant)
        if not (placed.on_input or placed.on_state) and placed.through is None
        for strength in strengths_of(plant, placed.effect, placed.names, placed.channel)
    )


def strengths_of(
    plant: Plant, effect: AbstractEffect, names: Sequence[str], output: int
) -> tuple[InputStrength, ...]:
    """The same for one effect, which adds to the equation of an output.

    Args:
        plant: with or without the effect, at its estimate.
        effect: that acts on an output.
        names: of its parameters.
        output: its index.
    """
    pairs = zip(names, effect.parameters, strict=True)
    forces = [name for name, parameter in pairs if parameter.unit == "{f}"]
    gain = _input_gain(plant, output) if forces else None
    if gain is None:
        return ()
    channel, slope = gain
    name, unit = plant.inputs[channel], plant.units.get(plant.inputs[channel], "")
    return tuple(InputStrength(force, name, 1.0 / slope, unit) for force in forces)


def _input_gain(plant: Plant, output: int) -> tuple[int, float] | None:
    """The input that drives an output and ∂f/∂u; None unless there is one and it is constant."""
    if not plant.inputs or own_states(plant) or plant.has_algebraic:
        return None
    draw = np.random.default_rng(0)  # any points: a slope that is not constant differs there
    y = draw.uniform(0.1, 1.0, (3, plant.rows, len(plant.outputs)))
    u = draw.uniform(-1.0, 1.0, (3, len(plant.inputs)))
    slopes = [
        input_slopes(plant, np.zeros(3), y, u, i)[:, output] for i in range(len(plant.inputs))
    ]
    driving = [i for i, slope in enumerate(slopes) if np.any(slope != 0.0)]
    if len(driving) != 1:
        return None
    slope = slopes[driving[0]]
    constant = np.all(np.isfinite(slope)) and np.ptp(slope) <= 1e-9 * abs(slope[0])
    return (driving[0], float(slope[0])) if constant else None
