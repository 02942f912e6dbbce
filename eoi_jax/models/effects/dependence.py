r"""Coefficients that depend on a signal: the parameters of a linear parameter-varying (LPV) model.

A resistance, a viscosity, a rate of a reaction or a heat loss changes with a temperature, a load, a
position, a flow, or with time. A declared parameter p is then multiplied by a law of the
*scheduling signal* z, of which there are five forms. With $z_0$ a constant in the middle of the
records and a the relative slope there, so that p stays what it was,

| form | in place of p |
|---|---|
| exponential | $p\,e^{a(z - z_0)}$: has the sign of p, as a resistance has; viscosities |
| Arrhenius | $p\,e^{a T_0^2 (1/T_0 - 1/T)}$, T the absolute temperature: rates of reactions |
| linear | $p\,(1 + a\,(z - z_0))$: metals, what wears |
| power | $p\,(z/z_0)^{a z_0}$ of a signal that is positive: heat transfer by a flow |
| even | $p\,(1 + a z^2)$ of a signal that takes both signs: a force factor, an inertia |

To first order all but the even one, which is tried beside them, are $p\,(1 + a\,(z - z_0))$. That
adds $\partial f/\partial p \cdot p\,(z - z_0)\,a$ to y^(r). Where a law of one signal does the
same (a square, a cube, a spring, a drift), that law names it.

**Source.** R. Tóth, *Modeling and Identification of Linear Parameter-Varying Systems*, Springer
2010; O. Reynolds, Phil. Trans. R. Soc. 177 (1886) 157 (viscosity); S. Arrhenius, Z. phys. Chem. 4
(1889) 226. The test for laws of one signal is our own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from eoi_jax._checks import check, check_choice
from eoi_jax.compiler.pointwise import along
from eoi_jax.data.record import Record
from eoi_jax.models.effects.effect import AbstractParameterEffect, At, Grid, Parameter, Seen
from eoi_jax.models.effects.signals import Signal, is_of, signals_of
from eoi_jax.models.plant import Plant, State
from eoi_jax.models.units import quotient_unit
from eoi_jax.models.used_inputs import used_inputs


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
    steps: tuple[float, ...] = (-0.6, -0.15, 0.15, 0.6)
    largest: float = 3.0


_SETTINGS = DependenceSettings()


_ABSOLUTE_ZERO = {"K": 0.0, "°C": -273.15}  # in units of temperatures
_FORMS = ("exponential", "Arrhenius", "linear", "power")  # the more, the less they bend upwards
_SYMMETRIC = "even"


@dataclass(frozen=True)
class ParameterDependence(AbstractParameterEffect):
    """p exp(a (z - z_0)), p (1 + a (z - z_0)), …: a coefficient that a signal changes.

    Attributes:
        parameter: name of p, a declared parameter.
        acts_on: the output in whose equation it stands.
        signals: z, an output or an input of the plant; () for time.
        center: z_0 [unit of z]; 0 of an even law.
        reach: largest |z - z_0| in the records, which bounds a [unit of z].
        unit: of z; "" for one that is not known.
        form_of_law: "exponential", "Arrhenius", "linear", "power" or "even".

    Raises:
        ValueError: another form, or one that z cannot have.
    """

    parameter: str
    acts_on: str
    signals: tuple[Signal, ...]
    center: float
    reach: float
    unit: str = ""
    form_of_law: str = "exponential"

    name = "parameter_dependence"
    depends_on = "t"

    def __post_init__(self) -> None:
        check_choice("form_of_law", self.form_of_law, (*_FORMS, _SYMMETRIC))
        rule = "must be one that its signal may have"
        check(self._may_be(self.form_of_law), "form_of_law", rule, self.form_of_law)

    @property
    def rarity(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Of products: where one of k·x and b·u changes with the other signal, b does with x."""
        driven = any(signal.row is None for signal in self.signals)
        return 1.5 if driven else 1.0

    @property
    def signal(self) -> str:
        """Name of z; ``t`` for time."""
        return self.signals[0].symbol if self.signals else "t"

    @property
    def sentence(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Completes "the model lacks …"."""
        return f"a dependence of {self.parameter} on {self.signal if self.signals else 'time'}"

    @property
    def shapes(self) -> tuple[Parameter, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """a."""
        name = f"{self.parameter}_{self.signals[0].words if self.signals else 'time'}"
        largest, unit = _SETTINGS.largest / self.reach, quotient_unit("1", self.unit)
        if self.form_of_law == _SYMMETRIC:  # down to nothing at the end of the records
            square = f"({self.unit})²" if set(self.unit) & set(" ·/") else f"{self.unit}²"
            unit = quotient_unit("1", square) if self.unit else ""
            return (Parameter(name, unit, -1.0 / self.reach**2, largest / self.reach),)
        return (Parameter(name, unit, -largest, largest),)

    @property
    def kind(self) -> str:
        law = f" {_SYMMETRIC}" if self.form_of_law == _SYMMETRIC else ""
        return f"{self.name} {self.parameter} {self.signal}{law}"

    @property
    def form(self) -> str:
        """Parameter, signal and law: ``d of temperature, linear``; the exponential one is tacit."""
        law = "" if self.form_of_law == _FORMS[0] else f", {self.form_of_law}"
        return f"{self.parameter} of {self.signal}{law}"

    @property
    def forms(self) -> "tuple[ParameterDependence, ...]":
        """The dependence in each form that its signal may have; of an even one there is one."""
        if self.form_of_law == _SYMMETRIC:
            return (self,)
        return tuple(replace(self, form_of_law=law) for law in _FORMS if self._may_be(law))

    def next_form(self) -> "ParameterDependence | None":
        later = self.forms[self.forms.index(self) + 1 :]
        return next(iter(later), None)

    def _may_be(self, law: str) -> bool:
        absolute = self.unit in _ABSOLUTE_ZERO
        if law == _SYMMETRIC:
            return self.center == 0.0 and bool(self.signals)
        if law == "Arrhenius":
            return absolute and self.center - self.reach > _ABSOLUTE_ZERO[self.unit]
        return law != "power" or (not absolute and self.center > self.reach)

    def fits(self, plant: Plant, output: int) -> bool:
        has_signal = all(is_of(plant, signal) for signal in self.signals)
        return has_signal and super().fits(plant, output)

    def has_foreign_signal(self, plant: Plant, used: Bool[np.ndarray, "ny nu"]) -> bool:
        """Whether z is not in the equation of the output: another output, or an unused input.

        Time counts as a signal of the equation. With those, products, curves and laws with a shape
        do much the same, and say it shorter.

        Args:
            plant: the model.
            used: inputs that each equation has.
        """
        output = plant.outputs.index(self.acts_on)
        return any(
            signal.column != output if signal.row is not None else not used[output, signal.column]
            for signal in self.signals
        )

    def grid(self, seen: Seen) -> Grid:
        steps = np.array(_SETTINGS.steps)[:, None] / self.reach
        return steps / self.reach if self.form_of_law == _SYMMETRIC else steps

    def law(self, value: float) -> str:
        """The law with its number: ``d·exp(-0.02·(temperature - 42.5)), which halves over 35 °C``.

        Args:
            value: a.
        """
        sign, center = "+-"[self.center >= 0.0], abs(self.center)
        signal = f"({self.signal} {sign} {center:g})" if center else self.signal
        if self.form_of_law in ("linear", _SYMMETRIC):
            change = f"{abs(value):.4g}·{signal}{'²' if self.form_of_law == _SYMMETRIC else ''}"
            return f"{self.parameter}·(1 {'-' if value < 0.0 else '+'} {change})"
        if self.form_of_law == "power":
            return f"{self.parameter}·({self.signal}/{center:g})^{value * self.center:.4g}"
        if self.form_of_law == "Arrhenius":
            zero = _ABSOLUTE_ZERO[self.unit]
            absolute = f"({self.signal} + {-zero:g})" if zero else self.signal
            rise, base = value * (self.center - zero) ** 2, self.center - zero
            return f"{self.parameter}·exp({rise:.5g} K·(1/{base:g} - 1/{absolute}))"
        law = f"{self.parameter}·exp({value:.4g}·{signal})"
        if not value:
            return law
        distance = f"{np.log(2.0) / abs(value):.3g} {'' if self.unit == '1' else self.unit}".strip()
        return f"{law}, which {'halves' if value < 0.0 else 'doubles'} over {distance}"

    def factor(self, at: At, shape: Any) -> Any:
        z, slope, center = self._scheduling(at), shape[0], self.center
        if self.form_of_law == _SYMMETRIC:
            return 1.0 + slope * z**2
        if self.form_of_law == "linear":
            return 1.0 + slope * (z - center)
        if self.form_of_law == "power":
            return (jnp.abs(z) / center) ** (slope * center)
        if self.form_of_law == "Arrhenius":
            zero = _ABSOLUTE_ZERO[self.unit]
            return jnp.exp(slope * (center - zero) * (z - center) / (z - zero))
        return jnp.exp(slope * (z - center))

    def _scheduling(self, at: At) -> Any:
        if not self.signals:
            return at.t
        (signal,) = self.signals
        levels = at.inputs if signal.row is None else at.state[signal.row]
        return levels[signal.column]


def foreign_dependences(plant: Plant, records: Sequence[Record]) -> tuple[ParameterDependence, ...]:
    """Those of `parameter_dependences` on signals that the equation does not have."""
    used = used_inputs(plant)
    laws = parameter_dependences(plant, records)
    return tuple(law for law in laws if law.has_foreign_signal(plant, used))


def parameter_dependences(
    plant: Plant, records: Sequence[Record], most: int = 24
) -> tuple[ParameterDependence, ...]:
    """Dependences of the parameters of a plant on its outputs, its inputs and time.

    Those are left out that a law of one signal does as well, and parameters that do the same as
    another one. They are of the exponential form; `ParameterDependence.forms` has the others. Of a
    signal that takes both signs also of the even one.

    Args:
        plant: a model, with parameter values.
        records: whose ranges give z_0 and the largest a.
        most: so many at most, those on signals that the equation does not have first.

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
    single, used = _laws_of_one_signal(points), used_inputs(plant)
    dependences: list[ParameterDependence] = []
    for signal in (*levels, *inputs, None):
        center, reach = _range(records, signal)
        if reach > _SETTINGS.rests * abs(center):
            values = _values(points, signal)
            signals = () if signal is None else (signal,)
            unit = "s" if signal is None else plant.units.get(signal.name, "")
            dependences += [
                ParameterDependence(plant.names[i], plant.outputs[j], signals, center, reach, unit)
                for i, j in _informative(plant, outer, inner, values - center, single)
            ]
            if signals and reach > 2.0 * abs(center):  # about as far to either side of zero
                law = signals, 0.0, reach + abs(center), unit, _SYMMETRIC
                dependences += [
                    ParameterDependence(plant.names[i], plant.outputs[j], *law)
                    for i, j in _informative(plant, outer, inner, values**2, single)
                ]
    dependences.sort(  # stable
        key=lambda law: (not law.has_foreign_signal(plant, used), law.form_of_law == _SYMMETRIC)
    )
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
            repeated = any(
                _share_left(column, earlier[:, None]) < _SETTINGS.equal for earlier in columns
            )
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
        if not values.size:  # no inputs: NumPy has no quantile of nothing
            return np.zeros((_SETTINGS.points, *values.shape[1:]))
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
