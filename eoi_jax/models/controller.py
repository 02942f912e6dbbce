r"""A digital controller: what drives some inputs of a plant, sample by sample.

At the instant $t_k$ of a sample it reads references and measured outputs, and sets its inputs,
which are held until the next sample:

$u_k = c(t_k, r_k, y_{k-d}, s_{k-d}), \qquad s_{k+1} = g(t_k, r_k, y_k, s_k),$

with a state s (an integrator, a filtered derivative) and a delay of d samples for its computation.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from eoi_jax._checks import check, check_choice, check_count, check_positive, counted, real
from eoi_jax._types import Scalar

Law = Callable[[Any, Any, Any, Any], Any]


@dataclass(frozen=True, init=False)
class Controller:
    """A digital controller at the sampling of the records.

    Args:
        law: ``law(t, r, y, s)`` → u, or (u, s of the next sample) if it has a state: a pure
            function for JAX. Time [s]; references (nr,), in the order of `reference`; outputs
            (ny,), in that of the plant; state (states,). u: a value for each of `inputs`, a scalar
            if it is one.
        reference: inputs of the records that the controller reads, and the plant does not: a name
            or several, or none.
        inputs: of the plant that it drives, a name or several; None: all. The others stay as they
            were recorded.
        states: number of its states.
        initial: its state at the start of each record, (states,). None: the one with which it comes
            nearest to the recorded input.
        delay: samples that pass from the reading of the outputs to what the plant gets of it.
        tolerance: rms of what the law does not reproduce of a recorded input, over the standard
            deviation of that input, above which the controller is refused. What is below is added
            to the law, as it was recorded.

    Raises:
        ValueError: a law that is no function, names twice, a number of states or samples that is
            none, initial values of another number, a tolerance outside (0, 1).
    """

    law: Law
    reference: tuple[str, ...]
    inputs: tuple[str, ...] | None
    states: int
    initial: tuple[float, ...] | None
    delay: int
    tolerance: float

    def __init__(
        self,
        law: Law,
        reference: str | Sequence[str] = (),
        *,
        inputs: str | Sequence[str] | None = None,
        states: int = 0,
        initial: Sequence[float] | float | None = None,
        delay: int = 0,
        tolerance: float = 0.02,
    ):
        check(callable(law), "law", "must be a function law(t, r, y, s)", law)
        tolerance = real(tolerance)
        check(0 < tolerance < 1, "tolerance", "must lie in (0, 1)", tolerance)
        states = check_count("states", states, 0)
        values = None if initial is None else tuple(np.atleast_1d(initial).astype(float).tolist())
        if values is not None:
            rule = f"must hold {counted(states, 'finite value')}, as many as `states`"
            good = len(values) == states and bool(np.all(np.isfinite(values)))
            check(good, "initial", rule, values)
        fields = {
            "law": law,
            "reference": _names("reference", reference),
            "inputs": None if inputs is None else _names("inputs", inputs),
            "states": states,
            "initial": values,
            "delay": check_count("delay", delay, 0),
            "tolerance": tolerance,
        }
        for key, value in fields.items():
            object.__setattr__(self, key, value)

    @classmethod
    def pid(
        cls,
        proportional: float,
        integral: float = 0.0,
        derivative: float = 0.0,
        *,
        period: float,
        reference: str | float = "r",
        filter_time: float = 0.0,
        offset: float = 0.0,
        limits: tuple[float, float] = (-np.inf, np.inf),
        output: int = 0,
        inputs: str | None = None,
        initial: Sequence[float] | None = None,
        delay: int = 0,
        tolerance: float = 0.02,
    ) -> "Controller":
        r"""A PID controller in parallel form.

        $u = u_0 + K_P e + K_I I + K_D D$ with the error $e = r - y$, the sum
        $I_{k+1} = I_k + T e_k$, and the filtered difference
        $D_k = (T_f D_{k-1} + e_k - e_{k-1}) / (T_f + T)$. At a limit the sum stands still while the
        error pushes further beyond it.

        Args:
            proportional: K_P [unit of u / unit of y].
            integral: K_I [that per second].
            derivative: K_D [that times seconds].
            period: T, the sample period of the records [s].
            reference: the input of the records that is the reference, or a constant set point.
            filter_time: T_f [s].
            offset: u₀ [unit of u].
            limits: of u.
            output: number of the output that is controlled.
            inputs: as of `Controller`, one.
            initial: I, e of the sample before, D of the sample before; as of `Controller`.
            delay: as of `Controller`.
            tolerance: as of `Controller`.

        Returns:
            The controller, with three states.

        Raises:
            ValueError: gains that are not finite, a period that is not positive, limits that are
                none.
        """
        check_positive("period", period, "It is the time between samples in seconds.")
        gains = real(proportional), real(integral), real(derivative)
        times = real(filter_time), real(offset)
        rule = "must be finite numbers, the filter time not negative"
        good = bool(np.all(np.isfinite((*gains, *times)))) and times[0] >= 0
        names = "proportional, integral, derivative, filter_time, offset"
        check(good, names, rule, (*gains, *times))
        low, high = map(real, limits)
        check(low < high, "limits", "must be (lower, upper) with lower < upper", (low, high))
        set_point = None if isinstance(reference, str) else real(reference)
        output = check_count("output", output, 0)
        law = _Pid(*gains, *times, float(period), (low, high), output, set_point)
        inputs_read = reference if isinstance(reference, str) else ()
        return cls(law, inputs_read, inputs=inputs, states=3, initial=initial, delay=delay,
                   tolerance=tolerance)  # fmt: skip

    def driven(self, inputs: Sequence[str]) -> tuple[int, ...]:
        """Numbers of a plant's inputs that it drives.

        Args:
            inputs: names of the plant's inputs.

        Raises:
            ValueError: a name that is none of them.
        """
        names = tuple(inputs) if self.inputs is None else self.inputs
        for name in names:
            check_choice("controller.inputs", name, inputs)
        return tuple(list(inputs).index(name) for name in names)

    def size(self, count: int) -> int:
        """Number of values that it keeps from sample to sample, of `count` driven inputs.

        The state, and the inputs that wait for their time.
        """
        return self.states + self.delay * count

    def step(
        self, t: Scalar, r: Any, y: Any, s: Any, count: int
    ) -> tuple[Float[Array, " count"], Float[Array, " memory"]]:
        """Inputs of a sample, and what is kept for the next one.

        Args:
            t: its instant [s].
            r: references.
            y: outputs.
            s: what was kept.
            count: number of driven inputs.
        """
        result = self.law(t, r, y, s[: self.states])
        u, state = result if self.states else (result, s[: self.states])
        u = jnp.reshape(jnp.asarray(u), (count,))
        state = jnp.reshape(jnp.asarray(state), (self.states,))
        if self.delay == 0:
            return u, state
        waiting = jnp.concatenate([s[self.states :], u])
        return waiting[:count], jnp.concatenate([state, waiting[count:]])

    def check_shapes(self, outputs: int, count: int) -> None:
        """Check what the law returns, before it is simulated.

        Args:
            outputs: number of the plant's outputs.
            count: number of driven inputs.

        Raises:
            ValueError: a law that fails, not as many inputs or states as declared.
        """
        dtype = jnp.result_type(float)
        shapes = ((), (len(self.reference),), (outputs,), (self.states,))
        structures = (jax.ShapeDtypeStruct(size, dtype) for size in shapes)
        try:
            result: Any = jax.eval_shape(self.law, *structures)
        except Exception as error:  # of any class, as the function is the user's
            sizes = zip("trys", shapes, strict=True)
            rule = f"must run with {', '.join(f'{name} {size}' for name, size in sizes)} in shape"
            check(False, "controller.law", rule, f"{type(error).__name__}: {error}")
            raise
        pair = isinstance(result, tuple) and len(result) == 2
        rule = "must return u alone, as `states` is 0"
        if self.states:
            rule = "must return (u, next state), as `states` is positive"
        check(pair == (self.states > 0), "controller.law", rule, type(result).__name__)
        parts: Any = result if pair else (result,)
        sizes = ("u", count), ("state", self.states)
        for value, (name, size) in zip(parts, sizes, strict=False):
            shape = jnp.shape(value)
            good = shape == (size,) or (size == 1 and shape == ())
            check(good, "controller.law", f"must return {name} of shape ({size},)", shape)


def _names(field: str, names: str | Sequence[str]) -> tuple[str, ...]:
    listed = (names,) if isinstance(names, str) else tuple(names)
    check(all(isinstance(name, str) for name in listed), field, "must be a name or several", listed)
    check(len(set(listed)) == len(listed), field, "must have different names", listed)
    return listed


@dataclass(frozen=True)
class _Pid:
    """The law of `Controller.pid`; equal for equal settings."""

    proportional: float
    integral: float
    derivative: float
    filter_time: float
    offset: float
    period: float
    limits: tuple[float, float]
    output: int
    set_point: float | None

    def __call__(self, t: Any, r: Any, y: Any, s: Any) -> tuple[Any, Any]:
        del t
        total, previous, slope = s
        error = (r[0] if self.set_point is None else self.set_point) - y[self.output]
        slope = (self.filter_time * slope + error - previous) / (self.filter_time + self.period)
        u = self.offset + self.proportional * error + self.derivative * slope
        u += self.integral * total
        low, high = self.limits
        pushed = self.integral * error
        stands = ((u > high) & (pushed > 0)) | ((u < low) & (pushed < 0))
        total = jnp.where(stands, total, total + self.period * error)
        return jnp.clip(u, low, high), jnp.stack([total, error, slope])
