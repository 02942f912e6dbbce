"""What happens to an input between the recorded value and the plant."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from eoi_jax.effects.effect import AbstractInputEffect, At, Grid, Parameter, Seen, quantiles

_ENTERED = 0.02  # share of the samples that must lie in a dead zone


class InputDeadZone(AbstractInputEffect):
    """sign(u) max(|u| - g, 0)."""

    name = "input_dead_zone"
    sentence = "a dead zone of the input"
    shapes = (Parameter("", "{u}", lower=0.0),)
    depends_on = "u"
    form = (
        "{u} → sign({u})·max(|{u}| - {0}, 0)",
        r"{u} \to \operatorname{{sign}}({u})\max(|{u}| - {0}, 0)",
    )

    def grid(self, seen: Seen) -> Grid:
        # Where the input never enters the zone, it is an offset.
        size = np.abs(seen.u)
        low, high = max(0.005 * np.max(size), np.quantile(size, _ENTERED)), 0.8 * np.max(size)
        return np.geomspace(low, high, 12)[:, None] if 0 < low < high else np.zeros((0, 1))

    def changed(self, at: At, shape: Any) -> Any:
        return at.u - jnp.clip(at.u, -shape[0], shape[0])


class InputSaturation(AbstractInputEffect):
    """clip(u, -L, L)."""

    name = "input_saturation"
    sentence = "a saturation of the input"
    shapes = (Parameter("", "{u}", lower=0.0),)
    depends_on = "u"
    form = ("{u} → clip({u}, -{0}, {0})", r"{u} \to \operatorname{{clip}}({u}, -{0}, {0})")

    def grid(self, seen: Seen) -> Grid:
        shares = [0.3, 0.4, 0.5, 0.6, 0.7, 0.78, 0.85, 0.9, 0.94, 0.97, 0.99]
        grid = quantiles(np.abs(seen.u), shares)
        return grid[grid[:, 0] > 0] if np.any(grid > 0) else np.ones((1, 1))

    def changed(self, at: At, shape: Any) -> Any:
        return jnp.clip(at.u, -shape[0], shape[0])


@dataclass(frozen=True)
class InputQuadratic(AbstractInputEffect):
    """u + q u|u| (an actuator whose gain grows), or u + q u² (one that differs between the signs).

    Attributes:
        odd: the first of the two.
    """

    name = "input_quadratic"
    sentence = "an actuator with a quadratic characteristic"
    shapes = (Parameter("", "1/({u})"),)
    depends_on = "u"

    odd: bool = True

    @property
    def form(self) -> tuple[str, str]:
        """The changed input as text and LaTeX."""
        text, latex = ("{u}·|{u}|", r"{u}\,|{u}|") if self.odd else ("{u}²", "{u}^2")
        return "{u} → {u} + {0}·" + text, r"{u} \to {u} + {0}\," + latex

    def grid(self, seen: Seen) -> Grid:
        size = np.array([0.003, 0.012, 0.05, 0.15, 0.4, 1.0, 4.0]) / (np.max(np.abs(seen.u)) or 1.0)
        return np.concatenate([-size[4::-1], size])[:, None]

    def changed(self, at: At, shape: Any) -> Any:
        return at.u + shape[0] * at.u * (jnp.abs(at.u) if self.odd else at.u)


class ActuatorLag(AbstractInputEffect):
    """T dz/dt = u - z; the plant gets z."""

    name = "actuator_lag"
    sentence = "a first-order lag of the actuator"
    shapes = (Parameter("", "s", lower=0.0),)
    states = 1
    depends_on = "t"
    form = ("{u} → u/({0} s + 1)", r"{u} \to \frac{{1}}{{{0}\,s + 1}}\,{u}")

    def grid(self, seen: Seen) -> Grid:
        return _times(seen)

    def rate(self, at: At, shape: Any) -> Any:
        return (at.u - at.z) / shape[0]

    def changed(self, at: At, shape: Any) -> Any:
        return at.z[0]

    def along(self, time: Any, u: Any, shape: Any) -> Any:
        # Exact for a staircase: z decays towards u in each step, and the mean over it is taken.
        ratio = (time[1] - time[0]) / shape[0]
        decay = jnp.exp(-ratio)

        def step(z: Any, u: Any) -> tuple[Any, Any]:
            return u + (z - u) * decay, u + (z - u) * (1.0 - decay) / ratio

        return jax.lax.scan(step, jnp.zeros_like(u[0]), u)[1]


# Padé approximant of order 4 of exp(-s τ), written as four states in real time scaled by τ:
# the denominator is s⁴ + 20 s³ + 180 s² + 840 s + 1680, the numerator has alternating signs.
# Phase error below 1e-3 rad up to ω τ = 3. The all-pass is u - 2 (odd part)/denominator.
_A = np.array([20.0, 180.0, 840.0, 1680.0])
_SCALE = 1680.0**0.25  # balances the states


class InputDelay(AbstractInputEffect):
    """u(t - τ).

    In a plant it is the Padé approximant of order 4, so that τ is a parameter like any other; along
    a record it is exact.
    """

    name = "input_delay"
    sentence = "a delay of the input"
    shapes = (Parameter("", "s", lower=0.0),)
    states = 4
    depends_on = "t"
    form = ("{u} → {u}(t - {0})", r"{u} \to {u}(t - {0})")

    def grid(self, seen: Seen) -> Grid:
        return _times(seen)

    def rate(self, at: At, shape: Any) -> Any:
        # Companion form of time scaled by τ/scale: z' = [z₂, z₃, z₄, u - Σ a z].
        a = _A / _SCALE ** np.arange(1, 5)
        last = at.u - (a[0] * at.z[3] + a[1] * at.z[2] + a[2] * at.z[1] + a[3] * at.z[0])
        moved = jnp.stack([at.z[1], at.z[2], at.z[3], last])
        return moved * (_SCALE / shape[0])

    def changed(self, at: At, shape: Any) -> Any:
        # (even - odd)/(even + odd) = 1 - 2 odd/(even + odd), odd = 20 s³ + 840 s.
        a = _A / _SCALE ** np.arange(1, 5)
        return at.u - 2.0 * (a[0] * at.z[3] + a[2] * at.z[1])

    def along(self, time: Any, u: Any, shape: Any) -> Any:
        # Means over steps: of a shifted staircase they are interpolated linearly.
        return jnp.interp(time - shape[0], time, u)


def _times(seen: Seen) -> Grid:
    """Times that shift the phase at the edge of the band by a hundredth to a few radians.

    Half a sample is a matter of how the record was read, not of the plant.
    """
    least = 0.5 * seen.sample_period
    times = np.geomspace(0.01, 4.0, 11) / seen.band
    return np.unique(np.maximum(times, least))[:, None]
