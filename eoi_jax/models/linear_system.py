r"""Linear systems in state space or as a transfer function, converted to chain form.

Without zeros the state consists of the outputs and their derivatives,
$\xi = (y_1, \dot y_1, \dots, y_2, \dots) = T x$ with rows $C_j A^i$ of T, so that
$y_j^{(r_j)} = C_j A^{r_j} T^{-1} \xi + C_j A^{r_j - 1} B u$.

With zeros, one input and one output, $y = k\,q(s)/d(s)\,u$: division $d = q m + \rho$ gives
$m(s)\,y = k u - \rho(s)/q(s)\,y$, where $\rho/q$ is the zero dynamics, driven by the output
(the normal form of Isidori, Nonlinear Control Systems, 1995, section 4.3).

Where the output follows its input at once, or zeros in the right half plane would make that zero
dynamics grow, all states are internal, in the controllable canonical form
$z_n' = u + a_0 z_1 + a_1 z_2 + \dots$, and the output is a function of them:
$y = d\,u + c_0 z_1 + \dots$
"""

import re
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from eoi_jax._checks import check, counted, is_or_are
from eoi_jax.models.plant import Plant

_TINY = 1e-9  # relative to a row's largest entry: a smaller coefficient is rounding

Terms = tuple[tuple[str, int, int], ...]  # parameter, row of x.y (or -1: an input), column


@dataclass(frozen=True)
class _Chains:
    """y^(r) of each output as a sum of parameters times states and inputs."""

    terms: tuple[Terms, ...]
    tail: tuple[str, ...] = ()  # coefficients ρ of the zero dynamics

    def __call__(self, t: Any, x: Any, u: Any, p: Any) -> Any:
        del t
        sums = [
            sum(getattr(p, name) * (u[j] if i < 0 else x.y[i, j]) for name, i, j in term)
            for term in self.terms
        ]
        if self.tail:
            sums[0] = sums[0] + sum(getattr(p, name) * x.z[i] for i, name in enumerate(self.tail))
        return jnp.stack([jnp.asarray(value) for value in sums])


@dataclass(frozen=True)
class _ZeroDynamics:
    """ż = companion of q, driven by the output."""

    names: tuple[str, ...]

    def __call__(self, t: Any, x: Any, u: Any, p: Any) -> Any:
        del t, u
        last = x.y[0, 0] - sum(getattr(p, name) * x.z[i] for i, name in enumerate(self.names))
        return jnp.concatenate([x.z[1:], jnp.reshape(last, (1,))])


@dataclass(frozen=True)
class _Readout:
    """y = d u + Σ c z, a function of internal states."""

    names: tuple[str, ...]
    feed: str  # name of d; empty without

    def __call__(self, t: Any, x: Any, u: Any, p: Any) -> Any:
        del t
        value = sum(getattr(p, name) * x.z[i] for i, name in enumerate(self.names))
        value = value + getattr(p, self.feed) * u[0] if self.feed else value
        return jnp.reshape(jnp.asarray(value), (1,))


@dataclass(frozen=True)
class _Companion:
    """ż = companion of the denominator, driven by the input."""

    names: tuple[str, ...]

    def __call__(self, t: Any, x: Any, u: Any, p: Any) -> Any:
        del t
        last = u[0] + sum(getattr(p, name) * x.z[i] for i, name in enumerate(self.names))
        return jnp.concatenate([x.z[1:], jnp.reshape(last, (1,))])


def plant_from_control(system: Any, *, name: str = "linear system") -> Plant:
    r"""A plant from a continuous linear system, such as those of python-control.

    Each coefficient of the highest derivatives that is not zero becomes a parameter: `a0`, `a1`, …
    of the output and its derivatives and `b` of the input, with the names of outputs and inputs
    where there are several. With zeros, `q0`, … are the coefficients of the (monic) numerator, and
    `c0`, … those of the zero dynamics. Signs are those of the sum: $y'' = a_0 y + a_1 y' + b u$.
    Of one input and one output, feed-through and zeros in the right half plane (a dead time by
    Padé) are admitted where all poles are stable: the output is then a function of internal states
    that start from rest, `a0`, … are the negative coefficients of the denominator, `c0`, … those of
    what remains of the numerator, and `d` is the feed-through.

    Args:
        system: a state-space system (`A`, `B`, `C`, `D`) or a transfer function of one input and
            one output (`num`, `den`), in seconds; its channels have the names of `input_labels`
            and `output_labels`, if present.
        name: of the plant.

    Returns:
        Plant in chain form with the nominal values of the system.

    Raises:
        ValueError: a system that is discrete, has more zeros than poles, states that are not
            observable, feed-through or zeros and several inputs or outputs, or unstable poles and
            feed-through or zeros in the right half plane.

    Source: python-control, https://python-control.readthedocs.io
    """
    a, b, c, d = _matrices(system)
    u_names = _labels(system, "input_labels", b.shape[1], "u")
    y_names = _labels(system, "output_labels", c.shape[0], "y")
    if np.any(d):
        return _readout_plant(*_fraction(a, b, c, d), u_names, y_names, name)
    degrees = _relative_degrees(a, b, c, y_names)
    zeros = len(a) - sum(degrees)
    if zeros == 0:
        return _chain_plant(a, b, c, degrees, u_names, y_names, name)
    check(
        b.shape[1] == 1 and c.shape[0] == 1,
        "system",
        "must have no zeros where it has several inputs or outputs",
        f"{counted(len(a), 'state')}, of which {sum(degrees)} {is_or_are(sum(degrees))} outputs "
        "and their derivatives",
        "Measure more outputs, leave out unobservable states, or take one channel.",
    )
    return _zero_dynamics_plant(a, b, c, degrees[0], u_names, y_names, name)


def _matrices(system: Any) -> tuple[np.ndarray, ...]:
    """A, B, C, D of a continuous system; D only of one input and one output."""
    period = getattr(system, "dt", None)
    check(not period, "system", "must be continuous in time", f"a sample period of {period}")
    if all(hasattr(system, key) for key in "ABCD"):
        parts = [np.atleast_2d(np.asarray(getattr(system, key), dtype=float)) for key in "ABCD"]
    else:
        check(
            hasattr(system, "num") and hasattr(system, "den"),
            "system",
            "must have A, B, C, D or num, den",
            f"a {type(system).__name__}",
        )
        from scipy.signal import tf2ss

        num, den = (_polynomial(getattr(system, key)) for key in ("num", "den"))
        check(len(num) <= len(den), "system", "must have no more zeros than poles",
              f"{counted(len(num) - 1, 'zero')}, {counted(len(den) - 1, 'pole')}",
              "Give the rate of the input as an input of its own.")  # fmt: skip
        parts = [np.atleast_2d(matrix) for matrix in tf2ss(num, den)]
    a, b, c, d = parts
    check(len(a) > 0, "system", "must have states", "none")
    check(b.shape[1] > 0, "system", "must have an input", "none")
    single = b.shape[1] == 1 and c.shape[0] == 1
    check(single or not np.any(d), "system",
          "must have no direct feed-through where it has several inputs or outputs",
          f"D = {d.tolist()}", "Subtract D u from the outputs.")  # fmt: skip
    return a, b, c, d


def _polynomial(coefficients: Any) -> np.ndarray:
    """Coefficients of a polynomial of a single channel, without leading zeros."""
    while isinstance(coefficients, list | tuple) or (
        isinstance(coefficients, np.ndarray) and coefficients.dtype == object
    ):
        if not isinstance(coefficients[0], list | tuple | np.ndarray):
            break
        check(
            len(coefficients) == 1,
            "system",
            "must be one transfer function",
            counted(len(coefficients), "channel"),
            "Convert it to state space first.",
        )
        coefficients = coefficients[0]
    return np.trim_zeros(np.atleast_1d(np.asarray(coefficients, dtype=float)), "f")


def _labels(system: Any, field: str, count: int, letter: str) -> tuple[str, ...]:
    labels = [str(label) for label in getattr(system, field, None) or []]
    default = [letter] if count == 1 else [f"{letter}{i + 1}" for i in range(count)]
    if len(labels) != count or any(re.fullmatch(r".*\[\d+\]", label) for label in labels):
        return tuple(default)
    return tuple(labels)


def _relative_degrees(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, names: tuple[str, ...]
) -> tuple[int, ...]:
    """For each output the lowest derivative that depends on an input."""
    degrees = []
    for row, label in zip(c, names, strict=True):
        size, power, r = np.abs(row).max(), row, 1
        while r <= len(a) and np.max(np.abs(power @ b)) <= _TINY * size * np.abs(b).max():
            power, r = power @ a, r + 1
            size = max(size * max(np.abs(a).max(), 1e-300), np.abs(power).max())
        check(r <= len(a), "system", f"must have an input that reaches `{label}`", "none does")
        degrees.append(r)
    return tuple(degrees)


def _chain_plant(
    a: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
    degrees: tuple[int, ...],
    u_names: tuple[str, ...],
    y_names: tuple[str, ...],
    name: str,
    max_condition: float = 1e12,
) -> Plant:
    """The plant with state ξ = T x; coefficients that are only rounding are no parameters.

    Beyond the condition number `max_condition` of T the state does not follow from the outputs.
    """
    places = [(i, j) for j, r in enumerate(degrees) for i in range(r)]
    chain = np.stack([c[j] @ np.linalg.matrix_power(a, i) for i, j in places])
    scale = np.linalg.norm(chain, axis=1, keepdims=True)
    observable = bool(np.all(scale > 0)) and bool(np.linalg.cond(chain / scale) < max_condition)
    check(
        observable,
        "system",
        "must have states that follow from its outputs and their derivatives",
        f"{counted(len(a), 'state')} of which some do not show",
        "Take a minimal realisation (control.minreal).",
    )
    inverse = np.linalg.inv(chain)
    parameters: dict[str, float] = {}
    terms = []
    for j, (row, r) in enumerate(zip(c, degrees, strict=True)):
        states = row @ np.linalg.matrix_power(a, r) @ inverse
        drive = row @ np.linalg.matrix_power(a, r - 1) @ b
        placed_states = zip(places, states, strict=True)
        candidates = [
            (_state_name(i, k, j, y_names), i, k, value) for (i, k), value in placed_states
        ]
        candidates += [(_input_name(k, j, u_names, y_names), -1, k, v) for k, v in enumerate(drive)]
        floor = _TINY * max(np.abs([*states, *drive]).max(), 1e-300)
        chosen = [term for term in candidates if abs(term[3]) > floor]
        terms.append(tuple((key, i, k) for key, i, k, _ in chosen))
        parameters |= {key: float(value) for key, _, _, value in chosen}
    return Plant(
        _Chains(tuple(terms)),
        parameters,
        relative_degree=degrees,
        inputs=u_names,
        outputs=y_names,
        name=name,
    )


def _state_name(i: int, k: int, j: int, names: tuple[str, ...]) -> str:
    return f"a{i}" if len(names) == 1 else f"a{i}_{_plain(names[j])}_{_plain(names[k])}"


def _input_name(k: int, j: int, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> str:
    labels = ([outputs[j]] if len(outputs) > 1 else []) + ([inputs[k]] if len(inputs) > 1 else [])
    return "_".join(["b", *(_plain(label) for label in labels)])


def _plain(name: str) -> str:
    return re.sub(r"\W", "_", name)


def _zero_dynamics_plant(
    a: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
    r: int,
    u_names: tuple[str, ...],
    y_names: tuple[str, ...],
    name: str,
) -> Plant:
    """The plant with d(s) = q(s) m(s) + ρ(s): the chain of m, and the zero dynamics ρ/q."""
    num, den = _fraction(a, b, c, np.zeros((1, 1)))
    num = num[r:]  # the leading coefficients are rounding
    gain, q = float(num[0]), num / num[0]
    if not np.all(np.roots(q).real < 0):
        return _readout_plant(num, den, u_names, y_names, name)
    m, rho = np.polydiv(den, q)
    rho = np.concatenate([np.zeros(len(q) - 1 - len(rho)), rho]) if len(rho) < len(q) else rho
    parameters = {f"a{i}": -float(value) for i, value in enumerate(m[:0:-1])}
    parameters["b"] = gain
    q_names = tuple(f"q{i}" for i in range(len(q) - 1))
    c_names = tuple(f"c{i}" for i in range(len(q) - 1))
    parameters |= dict(zip(q_names, (float(value) for value in q[:0:-1]), strict=True))
    parameters |= dict(zip(c_names, (-float(value) for value in rho[::-1]), strict=True))
    terms: Terms = (*((f"a{i}", i, 0) for i in range(r)), ("b", -1, 0))
    return Plant(
        _Chains((terms,), c_names),
        parameters,
        relative_degree=r,
        inputs=u_names,
        outputs=y_names,
        internal=_ZeroDynamics(q_names),
        internal_initial=[0.0] * len(q_names),
        name=name,
    )


def _fraction(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Numerator and denominator of one channel, without a common root."""
    from scipy.signal import ss2tf

    numerators, den = ss2tf(a, b, c, d)
    poles = np.roots(den)
    zeros = np.roots(np.where(np.abs(numerators[0]) > _TINY * np.abs(numerators).max(),
                              numerators[0], 0.0))  # fmt: skip
    common = [zero for zero in zeros if np.min(np.abs(poles - zero)) < 1e-6 * (1 + abs(zero))]
    check(
        not common,
        "system",
        "must have no pole at a zero: such a state does not show in the output",
        f"{np.round(common, 4).tolist()}",
        "Take a minimal realisation (control.minreal).",
    )
    return np.asarray(numerators[0]), np.asarray(den)


def _readout_plant(
    num: np.ndarray,
    den: np.ndarray,
    u_names: tuple[str, ...],
    y_names: tuple[str, ...],
    name: str,
) -> Plant:
    """The plant whose output is a function of its internal states."""
    poles = np.roots(den)
    check(
        bool(np.all(poles.real <= 0)),
        "system",
        "must have stable poles where it has feed-through or zeros in the right half plane, or its "
        "internal states grow",
        f"poles at {np.round(poles, 4).tolist()}",
    )
    count = len(den) - 1
    num = np.concatenate([np.zeros(count + 1 - len(num)), num])
    feed = float(num[0])
    rest = num[1:] - feed * den[1:]
    a_names = tuple(f"a{i}" for i in range(count))
    c_names = tuple(f"c{i}" for i in range(count))
    parameters = dict(zip(a_names, (-float(value) for value in den[:0:-1]), strict=True))
    parameters |= dict(zip(c_names, (float(value) for value in rest[::-1]), strict=True))
    return Plant(
        _Readout(c_names, "d" if feed else ""),
        parameters | ({"d": feed} if feed else {}),
        relative_degree=0,
        inputs=u_names,
        outputs=y_names,
        internal=_Companion(a_names),
        internal_initial=[0.0] * count,
        name=name,
    )
