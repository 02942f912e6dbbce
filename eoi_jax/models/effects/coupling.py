"""Actions of one output on another: terms of the state of the whole plant.

The effects of the other modules depend on the output at which they act. In a plant of several
outputs one may act on another: joints of an arm, species, concentrations, coupled tanks, axes of a
rotating body.
"""

import itertools
import math
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
class Coupling(AbstractTerm):
    """a w, a w₁ w₂: an output acts on another one, alone or times a second signal.

    Attributes:
        signals: one or two of the plant's; at least one is of another output.
    """

    signals: tuple[Signal, ...]

    name = "coupling"
    sentence = "an action of another output"
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

    def fits(self, plant: Plant, output: int) -> bool:
        """Where a signal of it is of another output, of this plant."""
        outputs = [signal for signal in self.signals if signal.row is not None]
        return all(_is_of(plant, signal) for signal in self.signals) and any(
            signal.column != output for signal in outputs
        )

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        values = (
            at.inputs[signal.column] if signal.row is None else at.state[signal.row][signal.column]
            for signal in self.signals
        )
        return math.prod(values, start=gain[0])


def _is_of(plant: Plant, signal: Signal) -> bool:
    """Whether a plant has this signal."""
    if signal.row is None:
        return plant.inputs[signal.column : signal.column + 1] == (signal.name,)
    named = plant.outputs[signal.column : signal.column + 1] == (signal.name,)
    return named and signal.row < plant.degrees[signal.column]


def couplings(plant: Plant) -> tuple[Coupling, ...]:
    """Every coupling of a plant's outputs: by one of them or its rate, by products of two signals.

    Args:
        plant: a model; one of a single output has none.

    Returns:
        One object of each form; `Coupling.fits` tells at which outputs it may act.
    """
    if len(plant.outputs) < 2:
        return ()
    outputs = [
        Signal(name, j, row)
        for j, (name, degree) in enumerate(zip(plant.outputs, plant.degrees, strict=True))
        for row in range(min(degree, 2))
    ]
    inputs = [Signal(name, i, None) for i, name in enumerate(plant.inputs)]
    pairs = itertools.combinations_with_replacement(outputs, 2)
    driven = itertools.product(inputs, outputs)
    return tuple(Coupling(signals) for signals in (*((one,) for one in outputs), *pairs, *driven))
