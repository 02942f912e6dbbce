r"""Coefficients that depend on a signal: the parameters of a linear parameter-varying (LPV) model.

A resistance, a viscosity, a rate of a reaction or a heat loss changes with a temperature, a load, a
position, a flow, or with time. A declared parameter p then stands in the equations as
$p\,e^{a(z - z_0)}$, z the *scheduling signal*; to first order this is $p\,(1 + a\,(z - z_0))$,
which is the second form. In the neighbourhood of $z_0$ the exponential is the law of S. Arrhenius
for rates and of O. Reynolds for viscosities. It has the sign of p everywhere, as a resistance has.
$z_0$ is a constant, the middle of the records: p stays what it was there.

To first order the dependence adds $\partial f/\partial p \cdot p\,(z - z_0)\,a$ to y^(r). Where a
law of one signal does the same (a square, a cube, a spring, a drift), that law names it.

**Source.** R. Tóth, *Modeling and Identification of Linear Parameter-Varying Systems*, Springer
2010; O. Reynolds, Phil. Trans. R. Soc. 177 (1886) 157 (viscosity). The test for laws of one signal
is our own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from eoi_jax.compiler.pointwise import along
from eoi_jax.data.record import Record
from eoi_jax.models.effects.effect import AbstractParameterEffect, At, Grid, Parameter, Seen
from eoi_jax.models.effects.signals import Signal, is_of, signals_of
from eoi_jax.models.plant import Plant, State


@dataclass(frozen=True)
class DependenceSettings:
    """Which dependences are tried.

    Attributes:
        points: at which the columns of parameters are compared with laws of one signal.
        similar: share of its power that such laws may leave of a column that says nothing new.
        equal: the same of the column of another parameter.
        rests: reach of a signal over its size, up to which that is rounding.
        steps: a (z - z_0) at the end of the records, where a search begins.
        largest: of its size there: a factor of 20.
    """

    points: int = 256
    similar: float = 1e-3
    equal: float = 1e-9
    rests: float = 1e-9
    steps: tuple[float, ...] = (-0.8, -0.3, -0.1, 0.1, 0.3, 0.8)
    largest: float = 3.0


_SETTINGS = DependenceSettings()


@dataclass(frozen=True)
class ParameterDependence(AbstractParameterEffect):
    """p exp(a (z - z_0)) or p (1 + a (z - z_0)) in place of p: a coefficient that a signal changes.

    Attributes:
        parameter: name of p, a declared parameter.
        acts_on: the output in whose equation it stands.
        signals: z, an output or an input of the plant; () for time.
        center: z_0 [unit of z].
        reach: largest |z - z_0| in the records, which bounds a [unit of z].
        linear: whether it is the second form.
    """

    parameter: str
    acts_on: str
    signals: tuple[Signal, ...]
    center: float
    reach: float
    linear: bool = False

    name = "parameter_dependence"
    rarity = 1.0  # a product that names a cause beyond the two signals
    depends_on = "t"

    @property
    def signal(self) -> str:
        """Name of z; ``t`` for time."""
        return self.signals[0].symbol if self.signals else "t"

    @property
    def sentence(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Completes "the model lacks …"."""
        return f"a dependence of {self.parameter} on {'time' if not self.signals else self.signal}"

    @property
    def shapes(self) -> tuple[Parameter, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """a."""
        name = f"{self.parameter}_{self.signals[0].words if self.signals else 'time'}"
        largest = _SETTINGS.largest / self.reach
        return (Parameter(name, "{1/z}", -largest, largest),)

    @property
    def kind(self) -> str:
        return f"{self.name} {self.parameter} {self.signal}"

    @property
    def form(self) -> str:
        """Parameter and signal, and the law where it is linear: ``d of temperature, linear``."""
        return f"{self.parameter} of {self.signal}{', linear' if self.linear else ''}"

    def next_form(self) -> "ParameterDependence | None":
        return None if self.linear else replace(self, linear=True)

    def fits(self, plant: Plant, output: int) -> bool:
        has_signal = all(is_of(plant, signal) for signal in self.signals)
        return has_signal and super().fits(plant, output)

    def signal_unit(self, plant: Plant) -> str:
        """Unit of z; "" where the plant declares none."""
        return plant.units.get(self.signals[0].name, "") if self.signals else "s"

    def grid(self, seen: Seen) -> Grid:
        return np.array(_SETTINGS.steps)[:, None] / self.reach

    def scheduling(self, at: At) -> Any:
        """z."""
        if not self.signals:
            return at.t
        (signal,) = self.signals
        return (
            at.inputs[signal.column] if signal.row is None else at.state[signal.row][signal.column]
        )

    def law(self, value: float, unit: str) -> str:
        """The law with its number: ``d·exp(-0.02·(temperature - 42.5)), twice after -34.7 °C``.

        Args:
            value: a.
            unit: of z.
        """
        sign, center = "+-"[self.center >= 0.0], abs(self.center)
        signal = f"({self.signal} {sign} {center:g})" if center else self.signal
        if self.linear:
            return f"{self.parameter}·(1 {'-' if value < 0.0 else '+'} {abs(value):.4g}·{signal})"
        law = f"{self.parameter}·exp({value:.4g}·{signal})"
        if not value:
            return law
        distance = f"{np.log(2.0) / abs(value):.3g} {'' if unit == '1' else unit}".strip()
        return f"{law}, which {'halves' if value < 0.0 else 'doubles'} over {distance}"

    def factor(self, at: At, shape: Any) -> Any:
        exponent = shape[0] * (self.scheduling(at) - self.center)
        return 1.0 + exponent if self.linear else jnp.exp(exponent)


def parameter_dependences(
    plant: Plant, records: Sequence[Record], most: int = 24
) -> tuple[ParameterDependence, ...]:
    """Dependences of the parameters of a plant on its outputs, its inputs and time.

    Those are left out that a law of one signal does as well, and parameters that do the same as
    another one. They are of the exponential form; `next_form` gives the linear one.

    Args:
        plant: a model, with parameter values.
        records: whose ranges give z_0 and the largest a.
        most: so many at most, those on outputs and inputs first.

    Returns:
        One object for each pair of a parameter and a signal.
    """
    if plant.sampled is not None:
        return ()
    points = _points(plant, records)
    columns = along(_slopes, ("fixed", "rows"), plant, points)
    outer, inner = (part * np.asarray(plant.theta) for part in columns)
    if not (np.all(np.isfinite(outer)) and np.all(np.isfinite(inner))):
        return ()
    outputs, inputs = signals_of(plant)
    levels = (signal for signal in outputs if signal.row == 0)
    dependences: list[ParameterDependence] = []
    for signal in (*levels, *inputs, None):
        center, reach = _range(records, signal)
        if reach > _SETTINGS.rests * abs(center):
            centered = _values(points, signal) - center
            signals = () if signal is None else (signal,)
            dependences += [
                ParameterDependence(plant.names[i], plant.outputs[j], signals, center, reach)
                for i, j in _informative(plant, outer, inner, centered, _laws_of_one_signal(points))
            ]
    return tuple(dependences[:most])


def _informative(
    plant: Plant,
    outer: Float[np.ndarray, "points ny np"],
    inner: Float[np.ndarray, "points nz np"],
    centered: Float[np.ndarray, " points"],
    single: Float[np.ndarray, "points laws"],
) -> list[tuple[int, int]]:
    """Parameters whose dependence on a signal says something new, with the output of each.

    Args:
        plant: the model.
        outer: p ∂f/∂p.
        inner: p ∂g/∂p.
        centered: the signal less its centre.
        single: laws of one signal.
    """
    ny, free = len(plant.outputs), np.flatnonzero(plant.free).tolist()
    laws = np.einsum("pl,jk->pjlk", single, np.eye(ny)).reshape(outer.shape[0] * ny, -1)
    laws = np.concatenate([laws, outer[:, :, free].reshape(-1, len(free))], axis=1)
    pairs, columns = [], []
    for i in free:
        acts = np.flatnonzero(np.any(outer[:, :, i], axis=0)).tolist()
        if np.any(inner[:, :, i]):
            pairs.append((i, (*acts, 0)[0]))
        elif acts:
            column = (outer[:, :, i] * centered[:, None]).ravel()
            repeated = any(_share_left(column, earlier[:, None]) < _SETTINGS.equal for earlier in columns)
            if not repeated and _share_left(column, laws) >= _SETTINGS.similar:
                pairs.append((i, acts[0]))
                columns.append(column)
    return pairs


def _points(plant: Plant, records: Sequence[Record]) -> tuple[np.ndarray, ...]:
    """Independent points over the ranges of the records: t, outputs with rates, and inputs."""
    draw = np.random.default_rng(0)
    y = np.concatenate([record.outputs for record in records])
    rows = [y]
    for _ in range(1, plant.rows):
        rows.append(np.gradient(rows[-1], records[0].sample_period, axis=0))
    time = np.concatenate([record.time for record in records])
    u = np.concatenate([record.inputs for record in records])

    def drawn(values: np.ndarray) -> np.ndarray:
        """Over the middle of a range, each column apart; never a constant."""
        low, high = np.nanquantile(values, (0.01, 0.99), axis=0)
        width = np.maximum(high - low, 1e-6 + 1e-3 * np.abs(low))
        return low + width * draw.uniform(size=(_SETTINGS.points, *values.shape[1:]))

    return drawn(time), np.stack([drawn(row) for row in rows], axis=1), drawn(u)


def _slopes(plant: Plant, point: tuple[Any, ...]) -> tuple[Any, Any]:
    """∂f/∂θ, shape (ny, np), and ∂g/∂θ, shape (nz, np)."""
    t, y, u = point
    theta = jnp.asarray(plant.theta)
    x = State(y, plant.internal_start(theta))
    inner = jnp.zeros((0, len(theta)))
    if plant.internal is not None:
        inner = jax.jacfwd(lambda theta: plant.internal_rate(t, x, u, theta))(theta)
    return plant.regressor(t, x, u, theta), inner


def _values(points: tuple[np.ndarray, ...], signal: Signal | None) -> np.ndarray:
    t, y, u = points
    if signal is None:
        return t
    return u[:, signal.column] if signal.row is None else y[:, signal.row, signal.column]


def _range(records: Sequence[Record], signal: Signal | None) -> tuple[float, float]:
    """The middle of a signal in some records, rounded to what its spread tells, and its reach."""
    if signal is None:
        values = np.concatenate([record.time for record in records])
    else:
        parts = ((record.inputs if signal.row is None else record.outputs) for record in records)
        values = np.concatenate([part[:, signal.column] for part in parts])
    values = values[np.isfinite(values)]
    if not len(values) or not np.ptp(values) > 0.0:
        return 0.0, 0.0
    digits = 2 - int(np.floor(np.log10(np.ptp(values))))
    center = round(float(np.mean(values)), digits)
    return center, float(np.max(np.abs(values - center)))


def _laws_of_one_signal(points: tuple[np.ndarray, ...]) -> Float[np.ndarray, "points laws"]:
    """A constant, time, and powers of each other signal, with either sign."""
    t, y, u = points
    signals = np.concatenate([y.reshape(len(t), -1), u], axis=1)
    signals = signals / np.max(np.abs(signals), axis=0, initial=np.finfo(float).tiny)
    powers = [signals, signals**2, signals * np.abs(signals), signals**3]
    return np.concatenate([np.ones((len(t), 1)), t[:, None], *powers], axis=1)


def _share_left(column: np.ndarray, laws: np.ndarray) -> float:
    """Share of the power of a column that a regression on some laws leaves."""
    size = np.linalg.norm(laws, axis=0)
    laws = laws / np.where(size > 0.0, size, 1.0)
    column = column / max(np.max(np.abs(column)), np.finfo(float).tiny)
    power = float(column @ column)
    if not power > 0.0:
        return 0.0
    remainder = column - laws @ np.linalg.lstsq(laws, column, rcond=1e-12)[0]
    return float(remainder @ remainder) / power
