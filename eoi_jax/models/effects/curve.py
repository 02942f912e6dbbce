r"""Curves: what depends on a single signal, and has no law in the library.

A natural cubic spline s through values at knots $k_0 < \dots < k_n$,
$s(x) = \sum_j \gamma_j |x - k_j|^3 + a + b x$ with $\sum_j \gamma_j = \sum_j \gamma_j k_j = 0$, is
linear beyond the ends and linear in its values; of all curves through them it has the smallest
∫ s''². It is zero at two of its knots: a straight line is the model's own (k y, c y', b u), or has
parameters of its own.

Source: P. J. Green, B. W. Silverman, *Nonparametric Regression and Generalized Linear Models*,
Chapman & Hall 1994, sections 2.1 and 7.3.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from eoi_jax._checks import check, check_choice
from eoi_jax.models.effects.effect import AbstractInputEffect, AbstractTerm, At, Parameter
from eoi_jax.models.plant import Plant

_PINNED = (0.25, 0.75)  # where on the range of its knots a curve is zero


@dataclass(frozen=True)
class Curve(AbstractTerm):
    """(offset + slope (x - k₀) + s(x)) w, added to y^(r): x = y, ẏ or u; w = 1, ẏ, sign ẏ or u.

    Attributes:
        over: x, "y", "v" or "u".
        knots: k, rising [unit of x]; none for a straight line.
        times: w, "", "v", "sign" (of ẏ: dry friction whose level follows x) or "u".
        offset, slope: whether these are parameters.

    Raises:
        ValueError: signals of other names, fewer than four knots, or knots that do not rise.
    """

    over: str
    knots: tuple[float, ...]
    times: str = ""
    offset: bool = True
    slope: bool = False

    name = "curve"
    only_in_free_runs = True

    def __post_init__(self) -> None:
        check_choice("over", self.over, ("y", "v", "u"))
        check_choice("times", self.times, ("", "v", "sign", "u"))
        _check_knots(self.knots)

    @property
    def sentence(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Completes "the model lacks …"."""
        factors = {"": "a", "v": "the velocity times a", "u": "the input times a"}
        factor = {**factors, "sign": "dry friction whose level is a"}[self.times]
        signal = {"y": "output", "v": "velocity", "u": "input"}[self.over]
        return f"{factor} function of the {signal} (a curve, no law of the library)"

    @property
    def depends_on(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """x."""
        return self.over

    @property
    def kind(self) -> str:
        """A model contains at most one curve of each signal and factor."""
        return f"{self.name} {self.over} {self.times}".rstrip()

    @property
    def form(self) -> str:
        """Its signal, and the factor if it has one."""
        names = {"v": "y'", "sign": "sign(y')"}
        factor = f", times {names.get(self.times, self.times)}" if self.times else ""
        return f"of {names.get(self.over, self.over)}{factor}"

    @property
    def gains(self) -> tuple[Parameter, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Offset and slope, where they are parameters, then values at the knots."""
        unit = {"": "{f}", "v": "{f/v}", "sign": "{f}", "u": ""}[self.times]
        rise = "" if self.times else "{f/" + self.over + "}"
        line = [Parameter(f"{self.over}_offset", unit)] if self.offset else []
        line += [Parameter(f"{self.over}_slope", rise)] if self.slope else []
        return (*line, *(Parameter(f"{self.over}_{i}", unit) for i in _free(len(self.knots))))

    def fits(self, plant: Plant, output: int) -> bool:
        """Whether the output has the states that the curve depends on, the plant an input."""
        signals = {self.over, self.times}
        least = 1 if signals.isdisjoint({"v", "sign"}) else 2
        return plant.degrees[output] >= least and ("u" not in signals or bool(plant.inputs))

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        """What it adds to y^(r), linear in `gain`."""
        del shape
        curve = value(getattr(at, self.over), self.knots, gain, self.offset, self.slope)
        if self.times == "sign":
            return curve * jnp.sign(at.v)
        return curve * getattr(at, self.times) if self.times else curve

    def curve(
        self, x: Float[np.ndarray, " points"], values: Sequence[float] | np.ndarray
    ) -> Float[np.ndarray, " points"]:
        """The curve at these x, without the factor, for these parameters."""
        return np.asarray(value(x, self.knots, list(values), self.offset, self.slope))


@dataclass(frozen=True)
class InputCurve(AbstractInputEffect):
    """u + offset + s(u): a characteristic of an actuator.

    Attributes:
        knots: k, rising [unit of u].
        offset: whether it is a parameter.

    Raises:
        ValueError: fewer than four knots, or knots that do not rise.
    """

    knots: tuple[float, ...]
    offset: bool = True

    name = "input_curve"
    sentence = "an actuator whose characteristic is a curve, no law of the library"
    depends_on = "u"
    only_in_free_runs = True

    def __post_init__(self) -> None:
        _check_knots(self.knots)

    @property
    def shapes(self) -> tuple[Parameter, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The offset, where it is a parameter, then values at the knots."""
        line = [Parameter("offset", "{u}")] if self.offset else []
        return (*line, *(Parameter(f"{i}", "{u}") for i in _free(len(self.knots))))

    def changed(self, at: At, shape: Any) -> Any:
        """The input of the model."""
        return at.u + value(at.u, self.knots, shape, self.offset)

    def curve(
        self, x: Float[np.ndarray, " points"], values: Sequence[float] | np.ndarray
    ) -> Float[np.ndarray, " points"]:
        """What is added to the input at these x, for these parameters."""
        return np.asarray(value(x, self.knots, list(values), self.offset))


def varies(values: Float[np.ndarray, " samples"]) -> bool:
    """Whether a signal varies by more than rounding: behind a lag a constant one does so."""
    return bool(np.ptp(values) > 1e-9 * np.max(np.abs(values)))


def knots_of(values: Float[np.ndarray, " samples"], count: int) -> tuple[float, ...]:
    """Knots for a curve of a signal: half way between equal distances and equal shares of samples.

    Args:
        values: of the signal, which varies.
        count: of the knots, at least 4.
    """
    shares = np.linspace(0.0, 1.0, count)
    low, high = np.min(values), np.max(values)
    places = 0.5 * (np.quantile(values, shares) + low + shares * (high - low))
    return tuple(places.tolist())


def value(
    x: Any, knots: Sequence[float], values: Sequence[Any], offset: bool, slope: bool = False
) -> Any:
    """The curve at x.

    Args:
        x: signal.
        knots: of the spline; none for a straight line.
        values: offset and slope, where they are parameters, then values at the knots where the
            spline is not zero.
        offset: whether there is one.
        slope: likewise.
    """
    first = knots[0] if knots else 0.0
    values, total = list(values), 0.0 * x
    if offset:
        total += values.pop(0)
    if slope:
        total += values.pop(0) * (x - first)
    if not values:
        return total
    weights = _weights(tuple(knots)) @ jnp.stack([jnp.asarray(part) for part in values])
    width = knots[-1] - first
    place = (x - first) / width
    for j, knot in enumerate(knots):
        distance = jnp.abs(place - (knot - first) / width)
        total += weights[j] * distance**3
    return total + weights[-2] + weights[-1] * place


def _free(count: int) -> tuple[int, ...]:
    """Numbers of the knots, from 1, at which the spline is not zero."""
    pinned = [round(share * (count - 1)) + 1 for share in _PINNED]
    return tuple(i for i in range(1, count + 1) if i not in pinned)


@lru_cache(maxsize=64)
def _weights(knots: tuple[float, ...]) -> Float[np.ndarray, "coefficients values"]:
    """γ, a and b of the curves that are 1 at one of the free knots, on knots from 0 to 1."""
    count = len(knots)
    places = (np.asarray(knots) - knots[0]) / (knots[-1] - knots[0])
    line = np.stack([np.ones(count), places], axis=1)
    cubes = np.abs(places[:, None] - places) ** 3
    matrix = np.block([[cubes, line], [line.T, np.zeros((2, 2))]])
    return np.linalg.solve(matrix, np.eye(count + 2)[:, np.asarray(_free(count)) - 1])


def _check_knots(knots: Sequence[float]) -> None:
    rule = "must be none, or 4 or more that rise"
    good = not knots or (len(knots) >= 4 and bool(np.all(np.diff(knots) > 0)))
    check(good, "knots", rule, knots)
