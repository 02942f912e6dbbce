"""Terms that are products of named signals of a plant: of any of its outputs and inputs."""

import math
from abc import abstractmethod
from collections import Counter
from dataclasses import dataclass
from typing import Any

from eoi_jax.models.effects.effect import AbstractTerm, At, Parameter
from eoi_jax.models.plant import Plant


@dataclass(frozen=True)
class Signal:
    """A derivative of an output, or an input, of a plant.

    Attributes:
        name: of the channel.
        column: its index among the outputs, or among the inputs.
        row: order of the derivative of an output; None for an input.
    """

    name: str
    column: int
    row: int | None = 0

    @property
    def symbol(self) -> str:
        """As in an equation: ``angle'``."""
        return self.name + "'" * (self.row or 0)

    @property
    def words(self) -> str:
        """As in the name of a parameter: ``angle_rate``."""
        return self.name + "_rate" * (self.row or 0)


@dataclass(frozen=True)
class AbstractSignalProduct(AbstractTerm):
    """a w, a w₁ w₂: a signal, or a product of two.

    Attributes:
        signals: of the plant.
    """

    signals: tuple[Signal, ...]

    depends_on = "y"

    @property
    def gains(self) -> tuple[Parameter, ...]:  # type: ignore[override]
        """The factor of the product."""
        return (Parameter("_".join(signal.words for signal in self.signals), ""),)

    @property
    def kind(self) -> str:
        return f"{self.name} {self.form}"

    @property
    def form(self) -> str:
        """Its signals, as an equation has them: ``x·z``."""
        powers = Counter(signal.symbol for signal in self.signals)
        return "·".join(symbol + ("", "²")[power - 1] for symbol, power in powers.items())

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """Those of its signals that are outputs or their rates."""
        return tuple(signal for signal in self.signals if signal.row is not None)

    @abstractmethod
    def fits(self, plant: Plant, output: int) -> bool:
        """Whether a plant has all of its signals."""
        del output
        return all(is_of(plant, signal) for signal in self.signals)

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        values = (
            at.inputs[signal.column] if signal.row is None else at.state[signal.row][signal.column]
            for signal in self.signals
        )
        return math.prod(values, start=gain[0])


def signals_of(plant: Plant) -> tuple[list[Signal], list[Signal]]:
    """The outputs of a plant with the rates of positions, and its inputs."""
    outputs = [
        Signal(name, j, row)
        for j, (name, degree) in enumerate(zip(plant.outputs, plant.degrees, strict=True))
        for row in range(min(degree, 2))
    ]
    return outputs, [Signal(name, i, None) for i, name in enumerate(plant.inputs)]


def is_of(plant: Plant, signal: Signal) -> bool:
    """Whether a plant has this signal."""
    if signal.row is None:
        return plant.inputs[signal.column : signal.column + 1] == (signal.name,)
    named = plant.outputs[signal.column : signal.column + 1] == (signal.name,)
    return named and signal.row < plant.degrees[signal.column]
