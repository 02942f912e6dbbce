"""Actions of one output on another: terms of the state of the whole plant.

The effects of the other modules depend on the output at which they act. In a plant of several
outputs one may act on another: joints of an arm, species, concentrations, coupled tanks, axes of a
rotating body.
"""

import itertools

from eoi_jax.models.effects.signals import AbstractSignalProduct, signals_of
from eoi_jax.models.plant import Plant


class Coupling(AbstractSignalProduct):
    """a w, a w₁ w₂: an output acts on another one, alone or times a second signal.

    Attributes:
        signals: one or two of the plant's; at least one is of another output.
    """

    name = "coupling"
    sentence = "an action of another output"

    def fits(self, plant: Plant, output: int) -> bool:
        """Where a signal of it is of another output, of this plant."""
        remote = any(signal.column != output for signal in self.outputs)
        return remote and super().fits(plant, output)


def couplings(plant: Plant) -> tuple[Coupling, ...]:
    """Every coupling of a plant's outputs: by one of them or its rate, by products of two signals.

    Args:
        plant: a model; one of a single output has none.

    Returns:
        One object of each form; `Coupling.fits` tells at which outputs it may act.
    """
    if len(plant.outputs) < 2:
        return ()
    outputs, inputs = signals_of(plant)
    pairs = itertools.combinations_with_replacement(outputs, 2)
    driven = itertools.product(inputs, outputs)
    return tuple(Coupling(signals) for signals in (*((one,) for one in outputs), *pairs, *driven))
