"""The grey-box model: a chain of integrators for each measured output.

    y^(r) = f(t, y, ẏ, …, y^(r−1), z, u; θ)        ż = g(t, y, …, z, u; θ)

The paper's eq. (1)–(3) in chain form; z are internal states, which are not measured. With r = 0 an
output is an algebraic function of the states: y = f(t, …, z, u; θ).
"""

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from eoi_jax._checks import check, check_choice, check_kind, counted, is_whole, real
from eoi_jax._display import text
from eoi_jax._types import WHERE_SET, Input, Output, Regressor, Scalar
from eoi_jax.compiler.jax_private import Tracer, inputs_read
from eoi_jax.compiler.pointwise import along
from eoi_jax.models.actuators import keeps_steps
from eoi_jax.models.algebraic_outputs import apart, check_algebraic
from eoi_jax.models.kinds import checked_kinds, kind_of
from eoi_jax.models.known_starts import StartItems, checked_starts, internal_start_of, start_table
from eoi_jax.models.parameters import check_names, limits_of, parameter_type, replaced
from eoi_jax.models.plant_functions import read_functions
from eoi_jax.models.sampled_states import SampledStates
from eoi_jax.models.start_weights import free_starts, open_starts
from eoi_jax.models.state_names import names_state
from eoi_jax.models.traced_equations import evaluated
from eoi_jax.models.velocities import velocity_rows

# Velocity just above or just below rest at which f is evaluated: in any unit so small that f
# differs between the two only by a jump; its square is representable in single precision.
REST_SPEED = 1e-18


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)  # made in a tenth of the time that a module takes
class State:
    """The state of a model: outputs with their derivatives, and internal states.

    Attributes:
        y: row i is the i-th derivative of the outputs, shape (r, ny), one row at least. An output
            of lower relative degree than the plant's highest has zeros in the remaining rows, one
            of relative degree 0 in all: it is no state.
        z: internal states, shape (nz,).

    Several states stand side by side on leading axes.
    """

    y: Any
    z: Any


Dynamics = Callable[[Any, State, Any, Any], Any]
Actuator = Callable[[Any, Any, Any], Any]


class Plant(eqx.Module):
    r"""A model with named parameters: of the system behind the data, or to be fitted to them.

    $y^{(r)} = f(t, x, u; \theta)$, $\dot z = g(t, x, u; \theta)$, `x.y` of shape (r, ny) and
    `x.z` of shape (nz,). Parameters are accessed by name, ``p.a``; the regressor
    $\varphi = \partial f/\partial\theta$ of eq. (2) is computed by automatic differentiation, so
    parameters may be shared between outputs and may enter nonlinearly.

    Dry friction is written ``p.c * jnp.sign(rate)`` (for a measured speed, r = 1: of the output
    itself). The jump at rest is found by evaluating f just above and just below zero velocity:
    simulation sticks, and estimation omits samples at which the plant sticks.

    What the functions read outside their arguments (a global constant, a table, the weights of a
    network) is read when the plant is made, and every call uses these values. After a change make
    the plant anew.

    Args:
        dynamics: ``f(t, x, u, p)`` → y^(r), shape (ny,), or a scalar for a single output. Where
            r = 0, y itself at the instant t, with the input that holds from t on: what a logger
            records if the input changes at the instant of a sample.
        parameters: names and nominal values θ_0, in the order of every array of parameters.
        relative_degree: r ≥ 0, a number or a sequence with a number for each output. 0: the output
            is a function of the internal states, of the other outputs and of the inputs.
        inputs, outputs: names.
        internal: ``g(t, x, u, p)`` → dz/dt, shape (nz,), or None.
        internal_initial: z at the start of a record, shape (nz,), or a function of p, so that
            initial values may be parameters. None in place of a number: that start is free, and
            estimated of each record by itself, from zero on.
        bounds: ``{name: (lower, upper)}``; estimates stay within them.
        fixed: names of the parameters that keep their nominal values.
        units: ``{name: unit}`` of parameters, inputs and outputs, for tables and figures (of
            internal states: z, or z1, z2, …; internal_z, … if anything else is called z or z1).
        kinds: ``{output: kind}``: ``"position"``, ``"speed"``, ``"level"``, ``"temperature"``, …
            (`kinds.py`): which effects fit it. By default from unit, name and relative degree.
        name: name of the plant; default: the name of `dynamics`, or ``model`` if it has none.
        actuator: ``a(t, u, p)``, maps the means of the inputs over the steps of a record, (S, nu),
            at the middles of the steps, (S,), to the inputs of f and g. For delays and lags, which
            depend only on past inputs.
        sampled: of the last internal states, if they change at samples only. Simulations follow
            them (`validate`, `refine`), passes and effects do not.
        initial: ``{output: (value, rate, …)}``: what is known of the outputs and their derivatives
            at the start of a record, None for what is not: ``{"angle": (None, 0.0)}`` is released
            from rest. A number alone is the output's own. What is not known is estimated, of each
            record by itself. It holds where a run begins with its record, not in later windows,
            behind gaps of inputs, or in the second part of `Record.split`.

    Raises:
        ValueError: a name that is no identifier or unknown, a nominal value outside its bounds,
            r < 0, a kind that contradicts the unit, an `internal` without `internal_initial`, a
            known start that is no finite number or of no state of its output, a function that reads
            an output of relative degree 0, or such an output that depends on no state and no
            parameter.
    """

    dynamics: Dynamics = eqx.field(static=True)
    internal: Dynamics | None = eqx.field(static=True)
    internal_initial: Any = eqx.field(static=True)
    actuator: Actuator | None = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    theta: Float[np.ndarray | Array, " np"]
    lower: Float[np.ndarray | Array, " np"]
    upper: Float[np.ndarray | Array, " np"]
    degrees: tuple[int, ...] = eqx.field(static=True)
    inputs: tuple[str, ...] = eqx.field(static=True)
    outputs: tuple[str, ...] = eqx.field(static=True)
    fixed: tuple[str, ...] = eqx.field(static=True)
    unit_items: tuple[tuple[str, str], ...] = eqx.field(static=True)
    name: str = eqx.field(static=True)
    kind_items: tuple[tuple[str, str], ...] = eqx.field(static=True, default=())
    sampled: SampledStates | None = eqx.field(static=True, default=None, metadata=WHERE_SET)
    start_items: StartItems = eqx.field(static=True, default=())

    def __init__(
        self,
        dynamics: Dynamics,
        parameters: Mapping[str, float],
        relative_degree: int | Sequence[int] = 1,
        inputs: Sequence[str] = ("u",),
        outputs: Sequence[str] = ("y",),
        internal: Dynamics | None = None,
        internal_initial: Sequence[float | None] | Callable[[Any], Any] | None = None,
        bounds: Mapping[str, tuple[float, float]] | None = None,
        fixed: Sequence[str] = (),
        units: Mapping[str, str] | None = None,
        name: str | None = None,
        actuator: Actuator | None = None,
        kinds: Mapping[str, str] | None = None,
        sampled: SampledStates | None = None,
        initial: Mapping[str, Any] | None = None,
    ):
        check(callable(dynamics), "dynamics", "must be a function f(t, x, u, p)", dynamics)
        check_kind("parameters", parameters, Mapping, "a dict by name")
        for field, mapping in (("bounds", bounds), ("units", units), ("kinds", kinds)):
            check_kind(field, mapping or {}, Mapping, "a dict by name")
        self.dynamics, self.internal, self.actuator = dynamics, internal, actuator
        self.sampled = sampled
        self.names = tuple(parameters)
        self.inputs, self.outputs = _name_tuple("inputs", inputs), _name_tuple("outputs", outputs)
        self.fixed = _name_tuple("fixed", fixed)
        function_name = getattr(dynamics, "__name__", "<lambda>")
        self.name = name or ("model" if function_name == "<lambda>" else function_name)
        check_names(self.names, self.fixed, bounds or {})
        for kind, channels in (("inputs", self.inputs), ("outputs", self.outputs)):
            check(len(set(channels)) == len(channels), kind, "must have different names", channels)
        for key in self.names:
            number = np.ndim(parameters[key]) == 0
            rule, advice = "must be a number", "Give each element a name of its own."
            check(number, f"parameters[{key}]", rule, f"shape {np.shape(parameters[key])}", advice)
        self.theta = np.asarray([real(parameters[key]) for key in self.names])
        self.theta.flags.writeable = False
        finite = bool(np.all(np.isfinite(self.theta)))
        check(finite, "parameters", "must be finite numbers", parameters)
        limits = [limits_of(key, (bounds or {}).get(key, (-np.inf, np.inf))) for key in self.names]
        self.lower, self.upper = np.asarray(limits, dtype=float).T.copy()
        for key, low, value, high in zip(
            self.names, self.lower, self.theta, self.upper, strict=True
        ):
            rule, pair = "must be (lower, upper) with lower < upper", (float(low), float(high))
            check(bool(low < high), f"bounds[{key}]", rule, pair)
            rule = f"must lie in its bounds [{low:g}, {high:g}]"
            advice = "Move the nominal value or widen the bounds."
            check(bool(low <= value <= high), f"parameters[{key}]", rule, float(value), advice)
        self.degrees = _degrees(relative_degree, len(self.outputs))
        self.start_items = checked_starts(initial, self.outputs, self.degrees)
        self.internal_initial = internal_start_of(internal, internal_initial)
        self.unit_items = tuple((units or {}).items())
        self._check_units()
        self.kind_items = checked_kinds(kinds or {}, self.outputs, self.units)
        functions = read_functions(self, State)
        self.dynamics, self.internal, self.internal_initial, self.actuator = functions
        if self.has_algebraic:
            self._check_algebraic()

    # -- parameters -----------------------------------------------------------------------

    @property
    def parameters(self) -> dict[str, float]:
        """Parameter values by name."""
        return {key: float(value) for key, value in zip(self.names, self.theta, strict=True)}

    @property
    def units(self) -> dict[str, str]:
        """Units by name."""
        return dict(self.unit_items)

    @property
    def kinds(self) -> dict[str, str]:
        """What each output is, as declared or as unit, name and degree tell; "" if unknown."""
        declared = dict(self.kind_items)
        return {
            name: declared.get(name) or kind_of(name, self.units.get(name, ""), degree)
            for name, degree in zip(self.outputs, self.degrees, strict=True)
        }

    @property
    def initial(self) -> dict[str, tuple[float | None, ...]]:
        """Known starts by output: its value, its rate, …; None for what is not known."""
        return dict(self.start_items)

    @property
    def known_start(self) -> Float[np.ndarray, "r ny"]:
        """Known starts as in `State.y`; NaN where a start is not known."""
        return start_table(self.start_items, self.outputs, self.rows)

    @property
    def relative_degree(self) -> int:
        """The highest relative degree r of the outputs."""
        return max(self.degrees)

    @property
    def rows(self) -> int:
        """Number of rows of `State.y`."""
        return max(self.relative_degree, 1)

    @property
    def algebraic(self) -> Bool[np.ndarray, " ny"]:
        """Which outputs are algebraic functions of the states (relative degree 0)."""
        return np.asarray(self.degrees) == 0

    @property
    def has_algebraic(self) -> bool:
        """Whether any output is an algebraic function of the states."""
        return 0 in self.degrees

    @property
    def free(self) -> Float[np.ndarray, " np"]:
        """1.0 where a parameter is estimated, 0.0 where it is fixed."""
        return np.asarray([float(key not in self.fixed) for key in self.names])

    def with_parameters(self, values: Mapping[str, float] | Any) -> "Plant":
        """The plant with different parameter values.

        Args:
            values: ``{name: value}`` for some or all names, or an array (np,); also numbers that
                JAX traces.

        Raises:
            ValueError: an unknown name, a value that is no number, an array of a wrong length.
        """
        if isinstance(values, Mapping):
            theta = replaced(self.names, self.theta, values)
        else:
            theta, shape = values, np.shape(values)
            rule = f"must be {counted(len(self.names), 'value')} ({', '.join(self.names)})"
            check(shape == (len(self.names),), "parameters", rule, f"shape {shape}")
            if not isinstance(theta, jax.Array):
                theta = np.array(theta)
                theta.flags.writeable = False
        return eqx.tree_at(lambda plant: plant.theta, self, theta)

    def declared_anew(
        self,
        parameters: Mapping[str, float] | None = None,
        bounds: Mapping[str, tuple[float, float]] | None = None,
        fixed: Sequence[str] = (),
        initial: Mapping[str, Any] | None = None,
    ) -> "Plant":
        """The plant with some values and bounds replaced, and more parameters fixed.

        Args:
            parameters: values that are replaced, by name.
            bounds: those that are replaced, by name.
            fixed: parameters that are fixed besides those that are.
            initial: known starts in place of all of the plant's; None: these.

        Raises:
            ValueError: as for a new plant.
        """
        limits = zip(self.names, self.lower, self.upper, strict=True)
        declared_bounds = {key: (float(low), float(high)) for key, low, high in limits}
        return Plant(
            self.dynamics,
            {**self.parameters, **(parameters or {})},
            relative_degree=self.degrees,
            inputs=self.inputs,
            outputs=self.outputs,
            internal=self.internal,
            internal_initial=self.internal_initial if self.internal else None,
            bounds={**declared_bounds, **(bounds or {})},
            fixed=(*self.fixed, *(key for key in fixed if key not in self.fixed)),
            units=self.units,
            name=self.name,
            actuator=self.actuator,
            kinds=dict(self.kind_items),
            sampled=self.sampled,
            initial=self.initial if initial is None else initial,
        )

    def __repr__(self) -> str:
        return text(self)

    # -- equations ------------------------------------------------------------------------

    def named(self, theta: Float[Array | np.ndarray, " np"]) -> Any:
        """θ by name, the `p` of the model functions (``p.a``, ``p.b``)."""
        return parameter_type(self.names)(*theta)

    def derivative(self, t: Scalar, x: State, u: Input, theta: Float[Array, " np"]) -> Output:
        """f(t, x, u; θ): the highest derivative of each output [its unit / s^r]."""
        value = evaluated(self.dynamics, self.names, t, x, u, theta)
        return jnp.reshape(value, (len(self.outputs),))

    def output(self, t: Scalar, x: State, u: Input | None, theta: Float[Array, " np"]) -> Output:
        """The outputs at an instant: y of the state, or f where the relative degree is 0.

        Args:
            t: the instant [s].
            x: state there.
            u: inputs that hold from `t` on; None where no output depends on them.
            theta: parameter values.
        """
        if not self.has_algebraic:
            return x.y[0]
        assert u is not None
        return jnp.where(self.algebraic, self.derivative(t, x, u, theta), x.y[0])

    def internal_rate(
        self, t: Scalar, x: State, u: Input, theta: Float[Array, " np"]
    ) -> Float[Array, " nz"]:
        """g(t, x, u; θ): the rate of the internal states [their unit / s]."""
        if self.internal is None:
            return jnp.zeros_like(x.z)
        value = evaluated(self.internal, self.names, t, x, u, theta)
        return jnp.reshape(value, x.z.shape)

    def driven(
        self, t: Float[Array, " S"], u: Float[Array, "S nu"], theta: Float[Array, " np"]
    ) -> Float[Array, "S nu"]:
        """The inputs of f and g along a record, behind the actuators."""
        return u if self.actuator is None else self.actuator(t, u, self.named(theta))

    def driven_at_starts(
        self,
        t: Float[Array, " S"],
        u: Float[Array, "S nu"],
        u_start: Float[Array, "S nu"],
        theta: Float[Array, " np"],
    ) -> Float[Array, "S nu"]:
        """The inputs that f gets at the start of each step of a record, behind the actuators.

        A held input stays held behind a delay, and is continuous behind a lag: there it is the mean
        of those over both steps around the instant.

        Args:
            t: middles of the steps [s].
            u: means of the inputs over the steps.
            u_start: inputs at the starts of the steps; of a held input equal to `u`.
            theta: parameter values.
        """
        if self.actuator is None:
            return u_start
        values = self.driven(t, u, theta)
        if not all(keeps_steps(self.actuator, len(self.inputs))):
            before = jnp.concatenate([values[:1], values[:-1]])
            kept = np.asarray(keeps_steps(self.actuator, len(self.inputs)))
            values = jnp.where(kept, values, 0.5 * (before + values))
        moving = self.driven(t - 0.5 * (t[1] - t[0]), u_start, theta)
        return jnp.where(jnp.all(u == u_start, axis=0), values, moving)

    def internal_start(self, theta: Float[Array, " np"]) -> Float[Array, " nz"]:
        """z at the start of a record."""
        start = self.internal_initial
        value = start(self.named(theta)) if callable(start) else start
        return jnp.reshape(jnp.asarray(value, dtype=jnp.result_type(theta)), (-1,))

    @property
    def open_internal(self) -> Bool[np.ndarray, " nz"]:
        """Which internal states a run may start with at any value, if it begins within a record."""
        sampled = self.sampled.size if self.sampled else 0
        return open_starts(self.internal_initial, len(self.initial_internal), sampled)

    @property
    def free_internal(self) -> Bool[np.ndarray, " nz"]:
        """Which internal states are declared as free at the start of a record."""
        return free_starts(self.internal_initial, len(self.initial_internal))

    @property
    def initial_internal(self) -> Float[np.ndarray, " nz"]:
        """z at the start of a record at the plant's own parameters; of a free one a first guess."""
        if not callable(self.internal_initial):
            return np.asarray(self.internal_initial, dtype=float)
        theta = np.asarray(self.theta, dtype=float)[None]
        return along(Plant.internal_start, ("fixed", "rows"), self, theta)[0]

    def regressor(self, t: Scalar, x: State, u: Input, theta: Float[Array, " np"]) -> Regressor:
        r"""$\varphi = \partial f/\partial\theta$ at θ, eq. (2), shape (ny, np)."""
        return jax.jacfwd(lambda value: self.derivative(t, x, u, value))(theta)

    def input_slopes(
        self, t: Scalar, x: State, u: Input, theta: Float[Array, " np"]
    ) -> Float[Array, "ny nu"]:
        """∂f/∂u: derivative of the highest derivative of each output by each input."""
        return jax.jacfwd(lambda value: self.derivative(t, x, value, theta))(u)

    def at_rest(
        self, t: Scalar, x: State, u: Input, theta: Float[Array, " np"]
    ) -> tuple[Output, Output]:
        """f with each output's velocity just above and just below zero, each (ny,).

        A dissipative jump has f⁺ < f⁻; the plant sticks while f⁺ ≤ 0 ≤ f⁻.
        """
        above_rest = jnp.diagonal(self._with_velocities(t, x, u, theta, REST_SPEED))
        return above_rest, jnp.diagonal(self._with_velocities(t, x, u, theta, -REST_SPEED))

    def _with_velocities(
        self, t: Scalar, x: State, u: Input, theta: Float[Array, " np"], velocity: float
    ) -> Float[Array, "ny ny"]:
        """f of every output; in row j the velocity of output j is set to `velocity`."""
        moved = [
            State(x.y.at[row, j].set(velocity), x.z)
            for j, row in enumerate(velocity_rows(self.degrees))
        ]
        return jnp.stack([self.derivative(t, state, u, theta) for state in moved])

    # -- structure, found by probing ------------------------------------------------------

    @property
    def is_affine(self) -> bool:
        """Whether f is affine in the free parameters, so that a single least squares suffices.

        The traced ∂f/∂θ must not depend on them: the result depends only on the equations, not on
        a state or a unit. Equations that JAX cannot recognise as affine count as nonlinear.
        """
        if self.internal is not None or self.actuator is not None:
            return False
        shape = self.rows, len(self.outputs)
        return _affine(self.dynamics, self.names, self.fixed, shape, len(self.inputs))

    @property
    def dry_friction(self) -> tuple[bool, ...]:
        """For each output, whether f jumps where its velocity changes sign."""
        return tuple(np.diagonal(self.jumps).tolist())

    @property
    def jumps(self) -> Bool[np.ndarray, "ny ny"]:
        """Whether f of output i jumps where the velocity of output j changes sign, at [i, j].

        Elements off the diagonal belong to masses coupled by inertia, on which the friction of
        another mass acts. Traced parameters are probed around one, within their bounds.
        """
        values = self.theta
        if isinstance(values, Tracer):
            values = np.ones(len(self.names))
            if not isinstance(self.lower, Tracer):
                values = np.clip(values, self.lower, self.upper)
        theta = tuple(np.asarray(values, float).tolist())
        return _jumps(jax.tree.structure(self), theta, jnp.result_type(float))

    @property
    def coupled(self) -> Bool[np.ndarray, "ny nu"]:
        """Positions that an input pushes if it pushes several, as inertia couples the masses."""
        positions = np.asarray(self.degrees) >= 2
        if np.sum(positions) < 2:
            return np.zeros((len(self.outputs), len(self.inputs)), dtype=bool)
        slopes, size = along(_pushed, ("fixed", "rows"), self, _probes(self))
        pushes = slopes > 1e2 * np.finfo(size.dtype).eps * size
        pushes = np.any(pushes, axis=0) & positions[:, None]
        return pushes & (np.sum(pushes, axis=0) > 1)

    def _check_units(self) -> None:
        """Check that units belong to parameters, channels or internal states, named or numbered."""
        states = tuple(getattr(self.internal, "states", None) or ())
        names = (*self.names, *self.inputs, *self.outputs, *states)
        for key in self.units:
            if self.internal is None or not names_state(key, names):
                check_choice("units", key, names)

    def _check_algebraic(self) -> None:
        """Check what outputs of relative degree 0 depend on, at some of the probes."""

        def evaluate(t: Any, y: Any, z: Any, u: Any, theta: Any) -> tuple[Array, Array]:
            x = State(y, z)
            return self.derivative(t, x, u, theta), self.internal_rate(t, x, u, theta)

        t, y, u, theta = (jnp.asarray(part[::8]) for part in _probes(self))
        z = jax.vmap(self.internal_start)(theta)
        check_algebraic(self.outputs, self.algebraic, jax.vmap(evaluate), (t, y, z, u, theta))


def _name_tuple(kind: str, names: Any) -> tuple[str, ...]:
    """The names as a tuple; a single name may be a string."""
    name_list = (names,) if isinstance(names, str) else names
    check_kind(kind, name_list, Iterable, "a name or several")
    for element in name_list:
        check_kind(kind, element, str, "a name or several")
    return tuple(name_list)


def _degrees(relative_degree: int | Sequence[int], ny: int) -> tuple[int, ...]:
    is_sequence = isinstance(relative_degree, Sequence)
    degrees = tuple(relative_degree) if is_sequence else (relative_degree,) * ny  # type: ignore[arg-type]
    good = len(degrees) == ny and all(is_whole(r) and r >= 0 for r in degrees)
    check(
        good,
        "relative_degree",
        f"must be an integer ≥ 0, or {ny} of them, one an output",
        relative_degree,
        "0 is an output that is a function of the states.",
    )
    return tuple(int(degree) for degree in degrees)


# Magnitudes of each coordinate at which the structure is probed, on both sides of zero. The range
# covers effects that occur only beyond some state, in any usual unit.
_MAGNITUDES = np.geomspace(1e-4, 1e3, 64)


def _probes(plant: Plant) -> tuple[Any, ...]:
    """Fixed pseudo-random points (seed 0) at which the structure is probed: t, y, u, θ."""
    r, ny, nu = plant.rows, len(plant.outputs), len(plant.inputs)
    points, factors = _points(r * ny + nu, len(plant.names))
    # Shifted from the nominal values, so that friction with the nominal level 0 shows its jump.
    theta = np.asarray(plant.theta) * factors + 0.1
    return np.full(len(points), 0.3), points[:, nu:].reshape(-1, r, ny), points[:, :nu], theta


@functools.cache
def _points(coordinates: int, parameters: int) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates on both sides of zero, and factors of the parameters."""
    draw = np.random.default_rng(0)
    # A Latin hypercube of the logarithms: every coordinate takes all magnitudes.
    one_side = draw.permuted(np.tile(_MAGNITUDES, (coordinates, 1)), axis=1)
    one_side *= draw.choice([-1.0, 1.0], one_side.shape)
    points = np.concatenate([one_side, -one_side], axis=1).T
    return points, draw.uniform(0.8, 1.2, (len(points), parameters))


@functools.lru_cache(maxsize=64)
def _affine(
    dynamics: Dynamics,
    names: tuple[str, ...],
    fixed: tuple[str, ...],
    shape: tuple[int, int],
    inputs: int,
) -> bool:
    """Whether the jaxpr of ∂f/∂θ, of the free parameters θ, does not read θ."""
    free = tuple(name for name in names if name not in fixed)

    def slopes(values: list[Array], known: list[Array], t: Array, y: Array, u: Array) -> Any:
        x = State(y, jnp.zeros(0))

        def f(values: list[Array]) -> Array:
            named = dict(zip((*free, *fixed), [*values, *known], strict=True))
            return jnp.asarray(dynamics(t, x, u, parameter_type(names)(**named)))

        return jax.jacfwd(f)(values)

    # Scalars: of an array, what reads an element reads all of them.
    dtype = jnp.result_type(float)
    scalar, *line = (jax.ShapeDtypeStruct(axes, dtype) for axes in ((), (), shape, (inputs,)))
    traced = jax.make_jaxpr(slopes)([scalar] * len(free), [scalar] * len(fixed), *line)
    return not any(inputs_read(traced)[: len(free)])


@functools.lru_cache(maxsize=64)
def _jumps(structure: Any, theta: tuple[float, ...], dtype: Any) -> Bool[np.ndarray, "ny ny"]:
    """`Plant.jumps` of the plant of this structure; its bounds have no influence."""
    del dtype  # part of the cache key: the probes are computed in this type
    plant: Plant = jax.tree.unflatten(structure, [np.asarray(theta)] * structure.num_leaves)
    probed = along(_across_rest, ("fixed", "rows"), plant, _probes(plant))
    change, size, far_change, far_size = probed
    # A slope grows with the distance between the two velocities, a jump does not: a power of it
    # above 0.015 grows by more than a tenth. Beside a pole f has no limits between which to jump.
    rounding = 1e2 * np.finfo(change.dtype).eps * size
    jumps = (change > rounding) & (change > 0.9 * far_change)
    jumps &= ~np.any(size > 1.01 * far_size, axis=0)
    # A change of another output where one of degree one changes sign is no friction.
    moves = np.eye(len(plant.outputs), dtype=bool) | (np.asarray(plant.degrees) >= 2)
    jumps = np.any(jumps, axis=0) & moves & ~plant.algebraic
    jumps.flags.writeable = False
    return jumps


def _pushed(plant: Plant, probe: tuple[Any, ...]) -> tuple[Array, Array]:
    """|∂f/∂u|, shape (ny, nu); the size of f in units of each input, the same shape."""
    t, y, u, theta = probe
    x = State(y, apart(plant.internal_start(theta)))
    size = jnp.abs(plant.derivative(t, x, u, theta))[:, None] / jnp.abs(u)
    return jnp.abs(plant.input_slopes(t, x, u, theta)), size


def _across_rest(
    plant: Plant, probe: tuple[Any, ...], ratio: float = 1e3
) -> tuple[Array, Array, Array, Array]:
    """Change of f_i across rest of output j and its size, at `REST_SPEED` and `ratio` times it."""
    t, y, u, theta = probe
    x = State(y, apart(plant.internal_start(theta)))

    def change(distance: float) -> tuple[Array, Array]:
        rise, fall = (plant._with_velocities(t, x, u, theta, v) for v in (distance, -distance))
        return jnp.abs(rise - fall).T, (jnp.abs(rise) + jnp.abs(fall)).T

    return *change(REST_SPEED), *change(ratio * REST_SPEED)
