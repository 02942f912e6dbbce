"""What stands in front of the highest derivative: a capacity, or a rate of its own each way."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from eoi_jax._checks import check_choice
from eoi_jax.models.effects.effect import AbstractCascade, Grid, Parameter, Seen, sticks, turns
from eoi_jax.models.plant import Plant

_FORMS = ("linear", "even", "power")


@dataclass(frozen=True)
class VaryingCapacity(AbstractCascade):
    r"""C(y) y^(r) = C(0) f(x, u): a capacity or an inertia that changes with the output.

    The cross-section of a tank, the heat capacity of a body, the inductance of a coil, the inertia
    of a linkage. All that acts on the output is divided by it, the effects beside it too:

    | form | C(y)/C(0) | for |
    |---|---|---|
    | linear | 1 + a y | a heat capacity, walls that lean |
    | even | 1 + a y² | inertia and inductance, alike in both directions |
    | power | \|y\|^n | a cone (n = 2), a trough (n = 1); over C(1), of a level that is never zero |

    Attributes:
        law: "linear", "even" or "power".
        smallest: of C(y)/C(0); a fit that tries less is on its way elsewhere.

    Raises:
        ValueError: another law.
    """

    law: str = "linear"
    smallest: ClassVar[float] = 0.02

    name = "varying_capacity"
    sentence = "a capacity or an inertia that changes with the output"
    rarity = 2.0  # it bends all that acts, and may stand in for a law of one of these
    depends_on = "y"
    only_in_free_runs = True
    needs = "an output that is stored (no force, flow or acceleration), without dry friction"

    def __post_init__(self) -> None:
        check_choice("law", self.law, _FORMS)

    @property
    def form(self) -> str:
        return self.law

    @property
    def shapes(self) -> tuple[Parameter, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        unit = {"linear": "1/({y})", "even": "1/({y})²", "power": "1"}[self.law]
        return (Parameter("exponent" if self.law == "power" else "", unit),)

    def fits(self, plant: Plant, output: int) -> bool:
        stored = plant.kinds[plant.outputs[output]] not in ("force", "flow", "acceleration")
        return plant.degrees[output] > 0 and stored and not sticks(plant, output)

    def shows(self, seen: Seen) -> bool:
        """A power of a positive output, an even law of one that takes both signs."""
        if self.law == "linear":
            return bool(np.any(seen.y))
        return turns(seen.y) if self.law == "even" else bool(np.min(seen.y) > 0.0)

    def limit(self, kind: str = "") -> "VaryingCapacity | None":
        """Where 1 + q y runs off to q y, a power of the output."""
        del kind
        return replace(self, law="power") if self.law == "linear" else None

    def grid(self, seen: Seen) -> Grid:
        if self.law == "power":
            return np.array([-2.0, -1.0, -0.3, 0.3, 1.0, 2.0])[:, None]
        size = float(np.max(np.abs(seen.y)))
        steps = np.array([-0.6, -0.3, -0.1, 0.1, 0.3, 1.0, 3.0])[:, None]
        return steps / (size if self.law == "linear" else size**2)

    def slope(self, model: Callable[[Any, bool], Any], y: Any, z: Any, shape: Any) -> Any:
        del z
        return model(y, True) / self.capacity(y[0], shape)

    def capacity(self, y: Any, shape: Any) -> Any:
        """C(y)/C(0) [1]."""
        if self.law == "power":
            return jnp.maximum(jnp.abs(y), np.finfo(float).tiny) ** shape[0]
        return jnp.maximum(1.0 + shape[0] * (y if self.law == "linear" else y**2), self.smallest)


class RateAsymmetry(AbstractCascade):
    """y' = f + a |f|: what rises at another rate than it falls, by the factor (1 + a)/(1 - a).

    A heater with a fan that blows as it cools, a cell that is charged and discharged, muscles.
    """

    name = "rate_asymmetry"
    sentence = "a rate that differs between rising and falling"
    rarity = 2.0
    shapes = (Parameter("", "1", lower=-0.99, upper=0.99),)
    depends_on = "y"
    only_in_free_runs = True
    needs = "an output of relative degree one, without dry friction"

    def fits(self, plant: Plant, output: int) -> bool:
        return plant.degrees[output] == 1 and VaryingCapacity().fits(plant, output)

    def grid(self, seen: Seen) -> Grid:
        return np.array([-0.6, -0.3, -0.1, 0.1, 0.3, 0.6])[:, None]

    def slope(self, model: Callable[[Any, bool], Any], y: Any, z: Any, shape: Any) -> Any:
        del z
        rate = model(y, True)
        return rate + shape[0] * jnp.abs(rate)
