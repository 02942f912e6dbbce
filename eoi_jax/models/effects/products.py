"""Terms outside the library of effects, which discovery uses as alternatives to its answer."""

import itertools
import math
from collections import Counter
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp

from eoi_jax.models.effects.effect import AbstractTerm, At, Parameter
from eoi_jax.models.effects.signals import AbstractSignalProduct, signals_of
from eoi_jax.models.plant import Plant
from eoi_jax.models.used_inputs import product_inputs, used_inputs


@dataclass(frozen=True)
class Product(AbstractTerm):
    """a v w: product of two or three of y, ẏ and u, as in a gain that changes with the position.

    Attributes:
        first, second: "y", "v" or "u", the first input.
        third: likewise; "" for a product of two.
    """

    first: str
    second: str
    third: str = ""

    name = "product"
    sentence = "a product of signals"
    gains = (Parameter("", ""),)
    rarity = 2.0  # it names no cause: a law that is as good does
    depends_on = "y"
    only_in_free_runs = True

    @property
    def factors(self) -> tuple[str, ...]:
        """Its signals."""
        return tuple(filter(None, (self.first, self.second, self.third)))

    @property
    def kind(self) -> str:
        return " ".join((self.name, *self.factors))

    @property
    def form(self) -> str:
        """Its signals, as an equation has them: ``y·y'²``."""
        powers = Counter("y'" if signal == "v" else signal for signal in self.factors)
        return "·".join(signal + ("", "²", "³")[power - 1] for signal, power in powers.items())

    def fits(self, plant: Plant, output: int) -> bool:
        """An output of first order has no velocity of its own; powers of a position are springs."""
        if plant.degrees[output] == 1:
            return "v" not in self.factors
        return set(self.factors) != {"y"}

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return math.prod((getattr(at, signal) for signal in self.factors), start=gain[0])


class InputProduct(AbstractSignalProduct):
    """a u w: an input times the output or its rate, or times another input.

    A flow that carries heat, a valve under pressure, a field and an armature: `Product` has the
    first input only.

    Attributes:
        signals: two of the plant's, an input first.
    """

    name = "product"
    sentence = "a product of signals"
    rarity = 2.0
    only_in_free_runs = True

    def fits(self, plant: Plant, output: int) -> bool:
        """Where its output is the one of this equation."""
        local = all(signal.column == output for signal in self.outputs)
        return local and super().fits(plant, output)


class InputAction(AbstractSignalProduct):
    """a u: an input acts on an output whose equation does not have it, or in products alone.

    The sun on a room, a second pump, the speed of the wind: it was recorded, and left out. The
    voltage that a diode takes while the switch of a converter is open goes with the duty, which
    else multiplies voltages and currents.

    Attributes:
        signals: one input of the plant.
    """

    name = "input_action"
    sentence = "an action of an input that its equation does not have"
    depends_on = "t"
    rarity = 1.0  # an input that hardly moves does what an offset does

    def fits(self, plant: Plant, output: int) -> bool:
        """Where neither the equation of the output has such a term, nor that of a state."""
        (signal,) = self.signals
        place = output, signal.column
        if not super().fits(plant, output):
            return False
        if not used_inputs(plant)[place]:
            return True
        return plant.internal is None and bool(product_inputs(plant)[place])


# Both name no cause.
PRODUCTS = (Product, InputProduct)


def input_products(plant: Plant) -> tuple[InputProduct, ...]:
    """Products of a plant's inputs: of the second and further ones with outputs, and of pairs.

    Args:
        plant: a model; one of a single input has none.

    Returns:
        One object of each form; `InputProduct.fits` tells at which outputs it may act.
    """
    outputs, inputs = signals_of(plant)
    driven = itertools.product(inputs[1:], outputs)
    return tuple(map(InputProduct, (*driven, *itertools.combinations(inputs, 2))))


def input_actions(plant: Plant) -> tuple[InputAction, ...]:
    """Actions of the inputs of a plant, for each that the equation of some output does not have.

    Args:
        plant: a model; where each of its equations has all inputs there are none.

    Returns:
        One object for each input; `InputAction.fits` tells at which outputs it may act.
    """
    _, inputs = signals_of(plant)
    actions = (InputAction((signal,)) for signal in inputs)
    outputs = range(len(plant.outputs))
    return tuple(action for action in actions if any(action.fits(plant, j) for j in outputs))


@dataclass(frozen=True)
class ModulatedSinusoid(AbstractTerm):
    """(a sin(ω t) + b cos(ω t)) w with w = y, ẏ or u: a parameter that varies with time."""

    by: str

    name = "modulated_sinusoid"
    sentence = "a sinusoid whose amplitude follows the plant"
    gains = (Parameter("sine", ""), Parameter("cosine", ""))
    shapes = (Parameter("frequency", "rad/s", lower=0.0),)

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        phase = shape[0] * at.t
        return (gain[0] * jnp.sin(phase) + gain[1] * jnp.cos(phase)) * getattr(at, self.by)
