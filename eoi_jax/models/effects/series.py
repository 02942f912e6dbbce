"""Models in series: the cells that a stream passes, and a sensor behind the output."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from eoi_jax._checks import check, is_whole
from eoi_jax.data.recursion import states
from eoi_jax.models.effects.effect import AbstractCascade, Grid, Parameter, Seen, sticks
from eoi_jax.models.effects.inputs import lag_times
from eoi_jax.models.plant import Plant
from eoi_jax.models.streams import stream_inputs

_NO_STREAM = ("position", "speed", "acceleration", "level", "voltage", "current", "force")
_COUNTS = (2, 3, 6, 12)  # of cells, that a fit tries


@dataclass(frozen=True)
class CellsInSeries(AbstractCascade):
    r"""n well mixed cells in a row, in place of one of the same volume, passed by a stream.

    Transport with mixing: heat exchangers, pipes, ducts and columns, whose inputs are flows. With
    f(x, u) the declared model, u the stream, and q(u) = -∂/∂x [f(x, u) - f(x, 0)] the rate at which
    it renews the volume (it must not turn back),

        ẋ₁ = f(x₁, 0) + n [f(x₁, u) - f(x₁, 0)]
        ẋᵢ = f(xᵢ, 0) + n q(u) (xᵢ₋₁ - xᵢ),  i = 2 … n,  y = xₙ

    Each cell is heated alike, and gets what the one before it gives. There is no further parameter.
    The states are zᵢ = xᵢ - y, i < n; at the start of a run they lie on a straight line from the
    first one, which may be anywhere, to the output. Many cells are close to plug flow.

    Source: O. Levenspiel, Chemical Reaction Engineering, chapter 14 (tanks in series); the form for
    any f is our own.

    Attributes:
        cells: their number n, 2 or more.

    Raises:
        ValueError: a number of cells below 2.
    """

    name = "cells_in_series"
    depends_on = "t"
    only_in_free_runs = True
    needs = (
        "an output of relative degree one that an input carries as a stream does, with a term "
        "-u·y (nominal parameters count), and that is no position, speed, level, force, voltage or "
        "current"
    )

    cells: int = 2

    def __post_init__(self) -> None:
        good = is_whole(self.cells) and self.cells >= 2
        check(good, "cells", "must be a whole number, 2 or more", self.cells)

    @property
    def sentence(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """With their number."""
        return f"{self.cells} cells in series: a stream that is mixed in each, and not in the whole"

    @property
    def states(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """All cells but the last one, which is measured."""
        return self.cells - 1

    @property
    def start_weights(self) -> tuple[float, ...]:
        """A straight line: the samples that see the cells one by one are too few for more."""
        return tuple(np.linspace(1.0, 0.0, self.cells)[:-1].tolist())

    def streams(self, plant: Plant, output: int) -> tuple[int, ...]:
        if plant.degrees[output] != 1 or plant.kinds[plant.outputs[output]] in _NO_STREAM:
            return ()
        return stream_inputs(plant, output)

    def fits(self, plant: Plant, output: int) -> bool:
        return bool(self.streams(plant, output)) and not plant.dry_friction[output]

    def next_form(self) -> "CellsInSeries | None":
        counts = [count for count in _COUNTS if count > self.cells]
        return CellsInSeries(counts[0]) if counts else None

    def slope(self, model: Callable[[Any, bool], Any], y: Any, z: Any, shape: Any) -> Any:
        del shape
        flowing, standing = _cell(model, y, -z[-1:])
        return standing[0] + self.cells * (flowing[1] - standing[1])

    def rates(self, model: Callable[[Any, bool], Any], y: Any, z: Any, shape: Any) -> Any:
        del shape
        offsets = jnp.append(z, 0.0)[:, None]
        steps = -jnp.concatenate([jnp.zeros_like(offsets[:1]), offsets[:-1] - offsets[1:]])
        # Side by side: as many copies would take long to trace.
        flowing, standing = jax.vmap(lambda x, step: _cell(model, x, step))(y + offsets, steps)
        gained = (flowing[1] - standing[1]).at[0].set(flowing[0][0] - standing[0][0])
        rates = standing[0] + self.cells * gained
        return rates[:-1] - rates[-1]


def _cell(model: Callable[[Any, bool], Any], x: Any, step: Any) -> tuple[Any, Any]:
    """The model of a cell with the stream and without it, each with its change by a small step."""
    (flowing, standing), changes = jax.jvp(
        lambda x: (model(x, True), model(x, False)), (x,), (step,)
    )
    return (flowing, changes[0]), (standing, changes[1])


class SensorLag(AbstractCascade):
    r"""τ dy/dt = x - y: the record shows a first-order lag of what the model describes.

    How the record was made, and no part of the plant: a thermometer in its well, a filter of a
    transmitter. The state is z = x^(r-1) - y^(r-1), so that

        y^(r) = z/τ,   ż = f(x, ẋ, …; u) - z/τ,   x^(k) = y^(k) + τ y^(k+1),  k < r - 1.

    It may be anywhere at the start of a run. In free motion it is but one more mode e^(-t/τ) of the
    plant, and bends the beginning of a short record as well as many laws do: what swings has a lag
    only where an input, or another output, shows what it is late of. Of a first-order output it
    stands for a second store as well, whose content nobody knows.
    """

    name = "sensor_lag"
    sentence = "a first-order lag of the sensor: how the record was made, not the plant"
    rarity = 1.0  # in a linear plant with one input a lag of the actuator does the same
    shapes = (Parameter("", "s", lower=0.0),)
    depends_on = "t"
    only_in_free_runs = True
    states = 1
    behind_output = True
    needs = (
        "an output that is a state, without dry friction, and beyond the first order "
        "with an input or another output that it can lag behind"
    )

    def fits(self, plant: Plant, output: int) -> bool:
        # Dry friction sticks at a measured velocity only.
        if plant.degrees[output] == 0 or sticks(plant, output):
            return False
        return plant.degrees[output] == 1 or bool(plant.inputs) or len(plant.outputs) > 1

    def grid(self, seen: Seen) -> Grid:
        return lag_times(seen)

    def outputs_along(
        self, y: Float[np.ndarray, "runs time"], period: float, shape: np.ndarray
    ) -> Float[np.ndarray, "runs time"]:
        # Exact for y that is straight between its samples, from steady state on.
        steps = period / shape[0]
        decay, rise = np.exp(-steps), -np.expm1(-steps) / steps
        change = np.stack([rise - decay, 1.0 - rise])  # of the old and of the new sample
        driven = change[0] * y[:, :-1] + change[1] * y[:, 1:]
        late = states(np.full((1, 1), decay), np.ones(1), driven.T, y[:, 0][None])
        return np.concatenate([y[:, :1], late[:, 0].T], axis=1)

    def model_output(self, y: Any, z: Any, shape: Any) -> Any:
        return y + jnp.concatenate([shape[0] * y[1:], z])

    def slope(self, model: Callable[[Any, bool], Any], y: Any, z: Any, shape: Any) -> Any:
        del model, y
        return z[0] / shape[0]

    def rates(self, model: Callable[[Any, bool], Any], y: Any, z: Any, shape: Any) -> Any:
        return jnp.reshape(model(self.model_output(y, z, shape), True) - z[0] / shape[0], (1,))


class SensorCurve(AbstractCascade):
    r"""y = x + c x²: the record shows a bent image of what the model describes.

    How the record was made, and no part of the plant: a thermistor, a potentiometer, the pressure
    below a gas. Slope and zero of the sensor are those of the declared model. From
    x = g(y) = 2 y/(1 + s), s = √(1 + 4 c y),

        ẋ = ẏ/s,   y^(r) = s [f(x, ẋ; u) + 2 c ẏ²/s³],  ẏ² for r = 2 alone.

    Attributes:
        flattest: smallest slope s of it over that at zero: it still tells values apart.
    """

    flattest: ClassVar[float] = 0.02

    name = "sensor_curve"
    sentence = "a sensor whose characteristic is bent: how the record was made, not the plant"
    rarity = 5.0  # most sensors are straight; behind a lag the actuator's square does much the same
    shapes = (Parameter("", "1/({y})"),)
    depends_on = "y"
    only_in_free_runs = True
    behind_output = True
    needs = "an output of relative degree one or two, without dry friction"

    def fits(self, plant: Plant, output: int) -> bool:
        return plant.degrees[output] in (1, 2) and not sticks(plant, output)

    def grid(self, seen: Seen) -> Grid:
        size = float(np.max(np.abs(seen.y))) or 1.0
        return np.array([-0.2, -0.05, 0.05, 0.2, 0.6])[:, None] / size

    def outputs_along(
        self, y: Float[np.ndarray, "runs time"], period: float, shape: np.ndarray
    ) -> Float[np.ndarray, "runs time"]:
        return y + shape[0] * y**2

    def model_output(self, y: Any, z: Any, shape: Any) -> Any:
        root = self._root(y, shape)
        return jnp.concatenate([(2.0 * y[0] / (1.0 + root))[None], y[1:] / root])

    def slope(self, model: Callable[[Any, bool], Any], y: Any, z: Any, shape: Any) -> Any:
        root = self._root(y, shape)
        bend = 2.0 * shape[0] * y[1] ** 2 / root**3 if len(y) > 1 else 0.0
        return root * (model(self.model_output(y, z, shape), True) + bend)

    def _root(self, y: Any, shape: Any) -> Any:
        return jnp.sqrt(jnp.maximum(1.0 + 4.0 * shape[0] * y[0], self.flattest**2))
