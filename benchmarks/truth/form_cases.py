"""Cases for the law that the form of an equation does not matter: plants, records, and their forms.

A plant is a sum of coefficients times signals, y^(r) = ± c₁ s₁ ± c₂ s₂ …; a form writes these
coefficients in other parameters. Plants are simulated by SciPy and share no code with the library.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.independent import body

NOISE = 1e-3  # of the rms of each output about its mean
SAMPLES = 4000
Values = dict[str, float]


@dataclass(frozen=True)
class Term:
    """One term of an equation: sign, coefficient, and the signal as text in y, v and u."""

    sign: int
    coefficient: str
    signal: str


@dataclass(frozen=True)
class Kind:
    """A kind of plant.

    Attributes:
        name: of the kind.
        degree: relative degree of its outputs.
        outputs: names.
        equations: terms of each output.
        ranges: of the true coefficients.
        hidden: effects it may hide, by the library's name.
    """

    name: str
    degree: int
    outputs: tuple[str, ...]
    equations: tuple[tuple[Term, ...], ...]
    ranges: dict[str, tuple[float, float]]
    hidden: tuple[str, ...]


KINDS = (
    Kind(
        "mass", 2, ("y",),
        ((Term(-1, "a", "y"), Term(-1, "b", "v"), Term(1, "c", "u")),),
        {"a": (10.0, 200.0), "b": (0.5, 5.0), "c": (1.0, 30.0)},
        ("coulomb_friction", "cubic_stiffness", "quadratic_drag"),
    ),
    Kind(
        "pendulum", 2, ("y",),
        ((Term(-1, "a", "sin(y)"), Term(-1, "b", "v"), Term(1, "c", "u")),),
        {"a": (10.0, 100.0), "b": (0.3, 3.0), "c": (5.0, 50.0)},
        ("coulomb_friction", "quadratic_drag", "constant_offset"),
    ),
    Kind(
        "stage", 2, ("y",),
        ((Term(-1, "f", "sign(v)"), Term(-1, "b", "v"), Term(1, "c", "u")),),
        {"f": (0.3, 1.0), "b": (1.0, 6.0), "c": (5.0, 20.0)},
        ("quadratic_drag", "constant_offset", "linear_stiffness"),
    ),
    Kind(
        "tank", 1, ("level",),
        ((Term(-1, "a", "sqrt(y)"), Term(1, "b", "u")),),
        {"a": (0.02, 0.1), "b": (0.02, 0.1)},
        ("leak", "constant_offset", "input_quadratic"),
    ),
    Kind(
        "lag", 1, ("y",),
        ((Term(-1, "a", "y"), Term(1, "b", "u")),),
        {"a": (0.1, 2.0), "b": (0.1, 5.0)},
        ("constant_offset", "input_quadratic", "input_dead_zone"),
    ),
    Kind(
        "two nodes", 1, ("hot", "cold"),
        (
            (Term(-1, "a", "(hot - cold)"), Term(1, "b", "u")),
            (Term(1, "c", "(hot - cold)"), Term(-1, "d", "cold")),
        ),
        {"a": (0.2, 1.0), "b": (0.5, 2.0), "c": (0.2, 1.0), "d": (0.1, 0.5)},
        ("constant_offset", "input_quadratic"),
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A plant with its record.

    Attributes:
        kind: of the plant.
        truth, nominal: true coefficients, and those that a user starts from.
        hidden: name of the effect that the declared model lacks, or "".
        bounded: whether the user declares that parameters are positive.
        time, inputs, outputs: the record, (N,), (N,), (N, ny), with noise.
    """

    kind: Kind
    truth: Values
    nominal: Values
    hidden: str
    bounded: bool
    time: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray


def cases(count: int, seed: int) -> list[Case]:
    """Kinds in turn; every other plant of a kind hides an effect."""
    return [_case(KINDS[i % len(KINDS)], i // len(KINDS), [seed, i]) for i in range(count)]


def _case(kind: Kind, turn: int, seed: Sequence[int]) -> Case:
    draw = np.random.default_rng(seed)
    truth = {
        name: float(np.exp(draw.uniform(*np.log(limits)))) for name, limits in kind.ranges.items()
    }
    nominal = {name: value * float(2.0 ** draw.uniform(-1, 1)) for name, value in truth.items()}
    # Half of the plants hide something; bounds are declared by half of either.
    hidden = str(draw.choice(kind.hidden)) if (turn + KINDS.index(kind)) % 2 else ""
    bounded = bool(draw.integers(2))
    time, inputs, clean = _record(kind, truth, hidden, draw)
    noise = NOISE * np.std(clean, axis=0) * draw.standard_normal(clean.shape)
    return Case(kind, truth, nominal, hidden, bounded, time, inputs, clean + noise)


# -- simulation -------------------------------------------------------------------------------


def _record(
    kind: Kind, p: Values, hidden: str, draw: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, held input and outputs; the effect's size follows from a run without it."""
    slowest = {"mass": 0.02 * 2 * math.pi / math.sqrt(p.get("a", 1.0)), "stage": 0.01}
    slowest["pendulum"] = slowest["mass"]
    slowest |= {"tank": 2.0, "lag": 0.02 / p.get("a", 1.0), "two nodes": 0.1}
    h = slowest[kind.name]
    time = h * np.arange(SAMPLES)
    lengths = draw.integers(15, 90, SAMPLES)
    low = {"tank": 0.3, "two nodes": 0.0}.get(kind.name, -1.0)
    size = 0.5 if kind.name == "pendulum" else 1.0
    u = size * np.repeat(draw.uniform(low, 1.0, SAMPLES), lengths)[:SAMPLES]
    run = _bodies if kind.degree == 2 else _stores
    if not hidden:
        return time, u, run(kind, p, "", 0.0, time, u)
    plain = run(kind, p, "", 0.0, time, u)
    size = draw.uniform(0.08, 0.2)
    if hidden != "input_dead_zone":
        size *= _size(kind, p, _shape(hidden, time, u, plain), time, u, plain)
    return time, u, run(kind, p, hidden, size, time, u)


def _shape(hidden: str, time: np.ndarray, u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """What the effect takes from the highest derivative of the first output, per parameter."""
    position, rate = y[:, 0], np.gradient(y[:, 0], time)
    shapes = {
        "coulomb_friction": np.sign(rate), "quadratic_drag": rate * np.abs(rate),
        "cubic_stiffness": position**3, "linear_stiffness": position,
        "constant_offset": np.ones_like(rate), "leak": position, "input_quadratic": -(u**2),
    }  # fmt: skip
    return shapes[hidden]


def _size(
    kind: Kind, p: Values, shape: np.ndarray, time: np.ndarray, u: np.ndarray, y: np.ndarray
) -> float:
    """Parameter with which the effect is as large as the highest derivative (rms).

    Smaller if the declared model, fitted without the effect, would then have a coefficient below a
    third of its value: of another sign, half of the forms could not say it, nor a bound.
    """
    rate = np.gradient(y[:, 0], time)
    highest = np.gradient(rate, time) if kind.degree == 2 else rate
    size = float(np.sqrt(np.mean(highest**2) / np.mean(shape**2)))
    names = {"y": y[:, 0], "v": rate, "u": u, "sin": np.sin, "sqrt": np.sqrt, "sign": np.sign}
    names |= dict(zip(kind.outputs, y.T, strict=True))
    terms = kind.equations[0]
    columns = [term.sign * eval(term.signal, names | {"level": y[:, 0]}) for term in terms]
    moved = np.linalg.lstsq(np.stack(columns, axis=1), -shape, rcond=None)[0]
    lost = [
        -change / p[term.coefficient] for term, change in zip(terms, moved.tolist(), strict=True)
    ]
    strongest = 0.2  # of the sizes that are drawn
    return min(size, (2.0 / 3.0) / (strongest * max(*lost, 1e-12)))


def _bodies(
    kind: Kind, p: Values, hidden: str, size: float, time: np.ndarray, u: np.ndarray
) -> np.ndarray:
    stiffness, dry = p.get("a", 0.0), p.get("f", 0.0)
    spring = math.sin if kind.name == "pendulum" else float

    def lost(y: float, v: float) -> float:
        effects = {
            "quadratic_drag": v * abs(v),
            "cubic_stiffness": y**3,
            "linear_stiffness": y,
            "constant_offset": 1.0,
        }
        return size * effects.get(hidden, 0.0)

    def smooth(y: float, v: float, push: float) -> float:
        return p["c"] * push - stiffness * spring(y) - p["b"] * v - lost(y, v)

    return body(smooth, dry + (size if hidden == "coulomb_friction" else 0.0), time, u)


def _stores(
    kind: Kind, p: Values, hidden: str, size: float, time: np.ndarray, u: np.ndarray
) -> np.ndarray:
    def rate(x: np.ndarray, push: float) -> list[float]:
        if hidden == "input_dead_zone":
            push = math.copysign(max(abs(push) - size, 0.0), push)
        extra = {"constant_offset": -size, "leak": -size * x[0], "input_quadratic": size * push**2}
        more = extra.get(hidden, 0.0)
        if kind.name == "tank":
            return [-p["a"] * math.sqrt(max(x[0], 0.0)) + p["b"] * push + more]
        if kind.name == "lag":
            return [-p["a"] * x[0] + p["b"] * push + more]
        flow = x[0] - x[1]
        return [-p["a"] * flow + p["b"] * push + more, p["c"] * flow - p["d"] * x[1]]

    start = 0.65 * p["b"] / p["a"] if kind.name == "tank" else 0.0
    y = np.full((len(time), len(kind.outputs)), start**2)
    edges = [0, *(np.flatnonzero(np.diff(u)) + 1).tolist(), len(time) - 1]
    for first, last in pairwise(edges):
        stamps, push = time[first : last + 1], float(u[first])
        leg = solve_ivp(
            lambda _, x, push=push: rate(x, push), (stamps[0], stamps[-1]), y[first], "DOP853",
            t_eval=stamps, rtol=1e-9, atol=1e-11,
        )  # fmt: skip
        y[first : last + 1] = leg.y.T
    return y


# -- forms ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Form:
    """One way to write the equations of a plant.

    Attributes:
        name: of the form.
        equations: right-hand side of each output, with parameters as ``{name}``.
        parameters: nominal values.
        fixed: parameters that the user knows.
        coefficients: of the affine form, as functions of the parameters: ``to_affine(values)``.
        signed: parameters that may have either sign.
    """

    name: str
    equations: tuple[str, ...]
    parameters: Values
    fixed: tuple[str, ...]
    to_affine: Callable[[Mapping[str, float]], Values]
    signed: tuple[str, ...] = field(default=())


def forms(case: Case, seed: Sequence[int]) -> list[Form]:
    """All forms of a plant: the affine one first, then five others."""
    draw = np.random.default_rng(seed)
    makers = (_affine, _scaled, _inverted, _sums, _products, _reciprocal)
    return [make(case, draw) for make in makers]


def _written(case: Case, expressions: Mapping[str, str], draw: np.random.Generator) -> tuple:
    """The equations with these expressions in the place of coefficients, terms in random order."""
    lines = []
    for terms in case.kind.equations:
        order = draw.permutation(len(terms))
        parts = [
            f"{'-' if terms[i].sign < 0 else '+'} {expressions[terms[i].coefficient]}"
            f"*{terms[i].signal}"
            for i in order
        ]
        lines.append(" ".join(parts).removeprefix("+ "))
    return tuple(lines)


def _affine(case: Case, draw: np.random.Generator) -> Form:
    names = {name: f"{{{name}}}" for name in case.nominal}
    lines = _written(case, names, draw)
    return Form("affine", lines, case.nominal, (), dict)


def _scaled(case: Case, draw: np.random.Generator) -> Form:
    scale = {name: float(10.0 ** draw.uniform(-3, 3)) for name in case.nominal}
    lines = _written(case, {name: f"{scale[name]!r}*{{{name}}}" for name in scale}, draw)
    nominal = {name: value / scale[name] for name, value in case.nominal.items()}
    return Form(
        "scaled", lines, nominal, (), lambda p: {name: scale[name] * p[name] for name in scale}
    )


def _inverted(case: Case, draw: np.random.Generator) -> Form:
    """Every equation as a sum of forces over a mass; one of them is known."""
    lines, nominal, fixed, owner = [], {}, [], {}
    for i, terms in enumerate(case.kind.equations):
        mass = f"m{i}"
        nominal[mass] = float(10.0 ** draw.uniform(-2, 1))
        parts = []
        for j in draw.permutation(len(terms)):
            term = terms[j]
            owner[term.coefficient] = mass
            nominal[f"n{term.coefficient}"] = case.nominal[term.coefficient] * nominal[mass]
            sign = "-" if term.sign < 0 else "+"
            parts.append(f"{sign} {{n{term.coefficient}}}*{term.signal}")
        lines.append(f"({' '.join(parts).removeprefix('+ ')})/{{{mass}}}")
        known = [mass, *(f"n{term.coefficient}" for term in terms)]
        fixed.append(str(draw.choice(known)))
    return Form(
        "inverted", tuple(lines), nominal, tuple(fixed),
        lambda p: {name: p[f"n{name}"] / p[mass] for name, mass in owner.items()},
    )  # fmt: skip


def _sums(case: Case, draw: np.random.Generator) -> Form:
    """The first two coefficients as sum and difference of two parameters, others as they are."""
    first, second, *others = case.nominal
    expressions = {first: "({p} + {q})", second: "({p} - {q})"}
    expressions |= {name: f"{{{name}}}" for name in others}
    a, b = case.nominal[first], case.nominal[second]
    nominal = {"p": 0.5 * (a + b), "q": 0.5 * (a - b), **{k: case.nominal[k] for k in others}}
    return Form(
        "sums", _written(case, expressions, draw), nominal, (),
        lambda p: {first: p["p"] + p["q"], second: p["p"] - p["q"], **{k: p[k] for k in others}},
        ("q",),
    )  # fmt: skip


def _products(case: Case, draw: np.random.Generator) -> Form:
    """w², 2 ζ w and K w² of a second-order plant; 1/τ and K/τ of a first-order one."""
    names, value = list(case.nominal), case.nominal
    if case.kind.degree == 2 and case.kind.name != "stage":
        a, b, c = names
        w = math.sqrt(value[a])
        nominal = {"w": w, "zeta": value[b] / (2 * w), "K": value[c] / w**2}
        expressions = {a: "{w}**2", b: "2*{zeta}*{w}", c: "{K}*{w}**2"}
        return Form(
            "products", _written(case, expressions, draw), nominal, (),
            lambda p: {a: p["w"] ** 2, b: 2 * p["zeta"] * p["w"], c: p["K"] * p["w"] ** 2},
        )  # fmt: skip
    lead = names[1] if case.kind.name == "stage" else names[0]  # of the damping, or the outflow
    others = [name for name in names if name != lead]
    expressions = {lead: "1/{tau}", **{name: f"{{K{name}}}/{{tau}}" for name in others}}
    nominal = {
        "tau": 1.0 / value[lead],
        **{f"K{name}": value[name] / value[lead] for name in others},
    }
    return Form(
        "products", _written(case, expressions, draw), nominal, (),
        lambda p: {lead: 1 / p["tau"], **{name: p[f"K{name}"] / p["tau"] for name in others}},
    )  # fmt: skip


def _reciprocal(case: Case, draw: np.random.Generator) -> Form:
    names = list(case.nominal)
    expressions = {name: f"1/{{r{name}}}" for name in names}
    nominal = {f"r{name}": 1.0 / value for name, value in case.nominal.items()}
    return Form(
        "reciprocal", _written(case, expressions, draw), nominal, (),
        lambda p: {name: 1.0 / p[f"r{name}"] for name in names},
    )  # fmt: skip
