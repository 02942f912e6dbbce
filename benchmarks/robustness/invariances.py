r"""What must not change an estimate: order of records and of parameters, units, origin of time.

Each plant is drawn from one of ten families (first and second order, several outputs, mixed
relative degrees, dry friction, internal states, parameters that enter nonlinearly, a delay), with
two or three records of unequal length, noise, and gaps. It is identified and refined as it is, and
again after each of five changes:

- **order**: the records the other way round;
- **units**: every output, input, the time and the parameters in other units, and the model with
  them: $y' = s_y y$, $u' = s_u u$, $t' = s_t t$, $\theta' = s_\theta \theta$;
- **origin**: all clocks start a day later;
- **parameters**: declared the other way round;
- **split**: the longest record as two.

The first four change nothing but rounding: estimates must agree within `CLOSE` of their standard
errors, errors and index within `CLOSE` of themselves, and the status must be the same. Without
noise these are themselves little more than rounding: `ROUNDING` of parameters and outputs is free.

A record in two parts is no longer the same data: the start of the second part costs a transient,
and a start that is estimated. Of an efficient estimate, what it moves when a share q of the
information is left out has the variance Var θ̂ q/(1 - q) (J. Hausman, Econometrica 46 (1978) 1251),
where 1/(1 - q) is the ratio of the diagonals of I⁻¹ with the split and without it. With q at least
`LEAST_LOST`, each estimate must move by less than four times the root of that; of a variance that
is itself an estimate, of ν degrees of freedom, by less than the quantile of Student's t that is
exceeded as rarely as four standard deviations (7.1 of ν = 9). Both limits were set with violations
in view: of 0.02, estimates that moved by 0.6 to 0.9 of their errors, so that what 0.02 would find
is said too; and of four alone plant 83, by 1.6 of its error with nine degrees of freedom, where
four allows 0.9 and Student 1.62. Where it is larger, the error of the estimate, whose truth is
known, stands for its standard error: what differences of a sampled signal leave is systematic.
Filter, gains, transient and instruments are those of the whole record; *split, chosen anew*, which
may be another estimator, is shown beside. The standard errors, with ν degrees of freedom each, must
agree within four standard deviations of the logarithm of their ratio, √(1/2ν) for each of them. A
model with internal states declares where they start in each record, and a delayed input is what it
was at the start of its record: there the second part would be another experiment, and is not tried.

On some plants `discover` looks, from a model that lacks an effect, for what is missing: the
effects that it names, and its status, must be the same after each change.

    python benchmarks/robustness/invariances.py [--quick] [--write]
"""

# ruff: noqa: ARG001 - a model's function takes what the interface gives it

import functools
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy import stats

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks.common import Report, arguments, table
from eoi_jax import excitation
from eoi_jax.estimation.defaults import default_transient
from eoi_jax.estimation.preparation import prepare_records
from eoi_jax.models.effects import InputDelay

PLANTS = 200
DISCOVERED = 15  # every so many plants also by `discover`
CLOSE = 1e-3  # of what only rounding changes: of a standard error, or relative
ROUNDING = 1e-9  # of a parameter, or of the spread of an output
LEAST_LOST = 0.05  # share of the information that a split costs at least
SIGMAS = 4.0
LENGTHS = (900, 600, 300)
DAY = 86_400.0  # [s]
CHANGES = ("order", "units", "origin", "parameters", "split")
ANEW, STRICTER = "split, chosen anew", "split, 0.02"  # said, and not counted
STRICTLY_LOST = 0.02
FACTORS = (1e-6, 1e-3, 1.0 / 60.0, np.pi / 180.0, 1.0, 3.6, 25.4, 1e3, 1e6)  # of units
TIMES = (1e-3, 1.0 / 60.0, 1.0, 1e3)


# -- plants -----------------------------------------------------------------------------------

Signals = Sequence[Any]


@dataclass(frozen=True)
class Family:
    """One model, with the range that its parameters are drawn from.

    Attributes:
        function: highest derivatives, from rows of outputs (r, ny), z, u and parameters by name.
        parameters: middle of the range; drawn within a factor of 1.5.
        degrees: of the outputs.
        period: between samples [s].
        levels: between which the input is drawn. dwell: for how long [s].
        start: outputs at the start of a record.
        internal: derivative of z, in the same form, with the number of internal states.
        delayed: whether the parameter `delay` delays the input.
        lacks: parameter that a model without the effect has at zero, for `discover`.
    """

    function: Callable[..., Signals]
    parameters: Mapping[str, float]
    degrees: tuple[int, ...]
    period: float
    levels: tuple[float, float]
    dwell: float
    start: tuple[float, ...]
    internal: Callable[..., Signals] | None = None
    states: int = 0
    delayed: bool = False
    lacks: str = ""


def _first_order(y: Any, z: Any, u: Any, p: Any) -> Signals:
    return (-p.a * y[0, 0] + p.b * u[0] + p.c,)


def _tank(y: Any, z: Any, u: Any, p: Any) -> Signals:
    return (-p.a * jnp.sqrt(jnp.maximum(y[0, 0], 0.0)) + p.b * u[0],)


def _spring(y: Any, z: Any, u: Any, p: Any) -> Signals:
    return (-p.k * y[0, 0] - p.d * y[1, 0] + p.b * u[0] + p.c,)


def _pendulum(y: Any, z: Any, u: Any, p: Any) -> Signals:
    return (-p.a * jnp.sin(y[0, 0]) - p.d * y[1, 0] - p.c * jnp.sign(y[1, 0]) + p.b * u[0],)


def _duffing(y: Any, z: Any, u: Any, p: Any) -> Signals:
    return (-p.k * y[0, 0] - p.c * y[0, 0] ** 3 - p.d * y[1, 0] + p.b * u[0],)


def _two_masses(y: Any, z: Any, u: Any, p: Any) -> Signals:
    pull = p.k * (y[0, 0] - y[0, 1]) + p.d * (y[1, 0] - y[1, 1])
    return -pull - p.e * y[1, 0] + p.b * u[0], p.m * pull - p.g * y[0, 1]


def _behind(y: Any, z: Any, u: Any, p: Any) -> Signals:
    return (-p.a * y[0, 0] + p.b * z[0],)


def _lag(y: Any, z: Any, u: Any, p: Any) -> Signals:
    return ((u[0] - z[0]) / p.tau,)


def _saturating(y: Any, z: Any, u: Any, p: Any) -> Signals:
    return (-p.k * jnp.tanh(p.w * y[0, 0]) - p.d * y[1, 0] + p.b * u[0],)


def _motor(y: Any, z: Any, u: Any, p: Any) -> Signals:
    return (
        -p.r * y[0, 0] - p.e * y[1, 1] + p.b * u[0],
        p.g * y[0, 0] - p.d * y[1, 1] - p.k * y[0, 1],
    )


FAMILIES: Mapping[str, Family] = {
    "first order": Family(
        _first_order, {"a": 1.0, "b": 2.0, "c": 0.4}, (1,), 0.02, (-1, 1), 0.6, (0.0,), lacks="c"
    ),
    "tank": Family(_tank, {"a": 0.6, "b": 0.4}, (1,), 0.05, (1, 5), 1.5, (4.0,)),
    "spring": Family(
        _spring, {"k": 30.0, "d": 1.5, "b": 20.0, "c": 2.0}, (2,), 0.01, (-1, 1), 0.3, (0.1,),
        lacks="c",
    ),
    "pendulum": Family(
        _pendulum, {"a": 60.0, "d": 2.0, "c": 1.0, "b": 60.0}, (2,), 0.01, (-0.6, 0.6), 0.4, (0.3,),
        lacks="c",
    ),
    "duffing": Family(
        _duffing, {"k": 40.0, "c": 30.0, "d": 2.0, "b": 40.0}, (2,), 0.01, (-1, 1), 0.3, (0.1,),
        lacks="c",
    ),
    "two masses": Family(
        _two_masses, {"k": 40.0, "d": 0.6, "e": 1.0, "b": 30.0, "m": 0.7, "g": 20.0}, (2, 2), 0.01,
        (-1, 1), 0.3, (0.1, 0.0),
    ),
    "internal state": Family(
        _behind, {"a": 1.0, "b": 2.0, "tau": 0.5}, (1,), 0.02, (-1, 1), 0.8, (0.0,), _lag, 1
    ),
    "non-affine": Family(
        _saturating, {"k": 25.0, "w": 1.5, "d": 2.0, "b": 30.0}, (2,), 0.01, (-1, 1), 0.4, (0.2,)
    ),
    "motor": Family(
        _motor, {"r": 8.0, "e": 3.0, "b": 10.0, "g": 20.0, "d": 2.0, "k": 15.0}, (1, 2), 0.01,
        (-1, 1), 0.3, (0.0, 0.1),
    ),
    "delay": Family(
        _first_order, {"a": 1.0, "b": 2.0, "c": 0.4, "delay": 0.13}, (1,), 0.02, (-1, 1), 0.6,
        (0.0,), delayed=True,
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Units:
    """Numbers that values in SI are multiplied with."""

    outputs: tuple[float, ...]
    input: float = 1.0
    time: float = 1.0
    parameters: float = 1.0


class _SI:
    """Parameters by name, back in the units of the family."""

    def __init__(self, p: Any):
        self._p = p

    def __getattr__(self, name: str) -> Any:
        return getattr(self._p, name) / self._p.unit_parameters


@functools.cache
def functions(name: str) -> tuple[Callable, Callable | None, Callable | None]:
    """Dynamics, internal states and actuator of a family in any units, made once.

    The units are fixed parameters: what is compiled serves them all.
    """
    one = FAMILIES[name]
    r = max(one.degrees)

    def state(x: Any, p: Any) -> Any:
        units = jnp.stack([getattr(p, f"unit_y{j}") for j in range(len(one.degrees))])
        # The i-th derivative is one with the time in its unit.
        return x.y * p.unit_time ** jnp.arange(r)[:, None] / units, units

    def dynamics(t: Any, x: Any, u: Any, p: Any) -> Any:
        y, units = state(x, p)
        values = jnp.stack(one.function(y, x.z, u / p.unit_input, _SI(p)))
        return values * units / p.unit_time ** jnp.asarray(one.degrees)

    def internal(t: Any, x: Any, u: Any, p: Any) -> Any:
        y, _ = state(x, p)
        assert one.internal is not None
        return jnp.stack(one.internal(y, x.z, u / p.unit_input, _SI(p))) / p.unit_time

    def actuator(t: Any, u: Any, p: Any) -> Any:
        late = p.delay / p.unit_parameters
        return InputDelay().along(t / p.unit_time, u, jnp.stack([late]))

    return dynamics, internal if one.internal else None, actuator if one.delayed else None


def plant(
    name: str, values: Mapping[str, float], units: Units, backwards: bool = False
) -> eoi.Plant:
    """A plant of a family.

    Args:
        name: of the family.
        values: of its parameters, in SI; those left out are zero and fixed.
        units: of all that it deals with.
        backwards: whether parameters are declared the other way round.
    """
    one = FAMILIES[name]
    dynamics, internal, actuator = functions(name)
    factors = {
        **{f"unit_y{j}": factor for j, factor in enumerate(units.outputs)},
        "unit_input": units.input, "unit_time": units.time, "unit_parameters": units.parameters,
    }  # fmt: skip
    nominal = {key: values.get(key, 0.0) * units.parameters for key in one.parameters}
    order = {**nominal, **factors}
    if backwards:
        order = dict(reversed(order.items()))
    bounds = {"delay": (0.0, 10.0 * units.parameters)} if one.delayed else {}
    bounds |= {"tau": (0.01 * units.parameters, np.inf)} if "tau" in nominal else {}
    return eoi.Plant(
        dynamics, order, one.degrees, ("u",), tuple(f"y{j}" for j in range(len(one.degrees))),
        internal=internal, internal_initial=(0.0,) * one.states if internal else None,
        actuator=actuator, bounds=bounds, name=name,
        fixed=(*factors, *(key for key in nominal if key not in values)),
    )  # fmt: skip


# -- records ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Experiment:
    """One plant with its records, in some units.

    Attributes:
        name: of the family.
        truth, nominal: parameters in SI.
        records: with time, inputs and outputs as arrays in these units.
        units: of them.
        backwards: whether parameters are declared the other way round.
    """

    name: str
    truth: Mapping[str, float]
    nominal: Mapping[str, float]
    records: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]
    units: Units
    backwards: bool = False

    @property
    def model(self) -> eoi.Plant:
        """With the nominal parameters."""
        return plant(self.name, self.nominal, self.units, self.backwards)

    def made(self) -> list[eoi.Record]:
        """The records, as the library reads them."""
        names = tuple(f"y{j}" for j in range(len(self.units.outputs)))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return [
                eoi.Record(
                    t, u, y, f"run of {len(t)}", input_names=("u",), output_names=names, hold="zero"
                )
                for t, u, y in self.records
            ]


def experiment(seed: int, lacking: bool = False) -> Experiment:
    """Plant number `seed`.

    Args:
        seed: of all that is drawn; the family by turns.
        lacking: whether the model is without the effect that its family names.
    """
    draw = np.random.default_rng(seed)
    name = list(FAMILIES)[seed % len(FAMILIES)]
    one = FAMILIES[name]
    truth = {key: value * 1.5 ** draw.uniform(-1, 1) for key, value in one.parameters.items()}
    neutral = Units((1.0,) * len(one.degrees))
    true = plant(name, truth, neutral)
    level = draw.choice([0.0, 1e-4, 1e-3, 1e-2])
    runs = []
    for length in LENGTHS[: 2 + seed // len(FAMILIES) % 2]:
        time = np.arange(length) * one.period
        u = excitation.random_steps(time, *one.levels, one.dwell, seed=int(draw.integers(10**6)))
        start = np.zeros((max(one.degrees), len(one.degrees)))
        start[0] = one.start
        y = eoi.simulate(true, time, u, start, hold="zero", substeps=4).outputs.copy()
        y += level * np.std(y, axis=0) * draw.standard_normal(y.shape)
        if draw.uniform() < 0.3:
            first = int(draw.integers(length // 3, length // 2))
            y[first : first + int(draw.integers(1, 30))] = np.nan
        runs.append((time, u[:, None], y))
    nominal = {key: value * 1.2 ** draw.uniform(-1, 1) for key, value in truth.items()}
    if lacking:
        del nominal[one.lacks]
    return Experiment(name, truth, nominal, tuple(runs), neutral)


def changed(one: Experiment, change: str, seed: int) -> Experiment:
    """The same experiment told in another way.

    Args:
        one: in SI.
        change: of `CHANGES`.
        seed: of what is drawn for it.
    """
    draw = np.random.default_rng([seed, CHANGES.index(change)])
    runs = one.records
    if change == "order":
        return replace(one, records=runs[::-1])
    if change == "parameters":
        return replace(one, backwards=True)
    if change == "origin":
        return replace(one, records=tuple((t + DAY, u, y) for t, u, y in runs))
    if change == "split":
        (t, u, y), *others = runs
        cut = int(len(t) * draw.uniform(0.35, 0.65))
        halves = (t[:cut], u[:cut], y[:cut]), (t[cut:], u[cut:], y[cut:])
        return replace(one, records=(*halves, *others))
    units = Units(
        tuple(float(draw.choice(FACTORS)) for _ in one.units.outputs), float(draw.choice(FACTORS)),
        float(draw.choice(TIMES)), float(draw.choice(FACTORS)),
    )  # fmt: skip
    scaled = tuple((t * units.time, u * units.input, y * units.outputs) for t, u, y in runs)
    return replace(one, records=scaled, units=units)


# -- estimates --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Estimate:
    """What is compared, in SI, parameters in the order of the family.

    Attributes:
        index: smallest over the passes, or cost of the refinement; by output.
        inverse: diagonal of I⁻¹.
        rounding: of the index.
    """

    status: str
    theta: np.ndarray
    errors: np.ndarray
    freedom: np.ndarray
    index: np.ndarray
    inverse: np.ndarray
    rounding: np.ndarray


def choices(one: Experiment) -> dict[str, Any]:
    """What `identify` chooses for an experiment, as its arguments."""
    records = tuple(one.made())
    found = eoi.identify(one.model, records)
    prepared = prepare_records(one.model, records)
    return {
        "observer": found.observer,
        "lowpass": found.lowpass,
        "substeps": prepared.substeps,
        "smoothing": prepared.smoothing,
        "transient": default_transient(prepared.records, found.lowpass, False),
        "instruments": bool(np.any(found.correction)),
    }


def identified(one: Experiment, **chosen: Any) -> tuple[Estimate, Estimate]:
    """By `identify`, and by `refine` from there; `chosen` are arguments of `identify`."""
    records = one.made()
    found = eoi.identify(one.model, records, **chosen)
    rate = np.asarray(one.units.outputs) / one.units.time ** np.asarray(found.plant.degrees)
    index = found.index[found.best_pass] / rate**2
    first = _estimate(one, found, index, 0.0 * index)
    refined = eoi.refine(found.plant, records, substeps=2)
    units = np.asarray(one.units.outputs)
    spread = np.nanstd(np.concatenate([y for _, _, y in one.records]), axis=0) / units
    return first, _estimate(one, refined, refined.rmse / units, ROUNDING * spread)


def _estimate(one: Experiment, result: Any, index: np.ndarray, rounding: np.ndarray) -> Estimate:
    names = list(one.nominal)
    places = [result.plant.names.index(name) for name in names]
    freedom = result.degrees_of_freedom
    freedom = np.full(len(result.plant.names), np.nan) if freedom is None else freedom
    theta, errors = (
        np.asarray([part[name] for name in names]) / one.units.parameters
        for part in (result.parameters, result.standard_errors)
    )
    known = np.asarray(freedom)[places]
    part = np.asarray(result.information)[np.ix_(places, places)]
    size = np.sqrt(np.diagonal(part))
    inverse = np.diagonal(np.linalg.pinv(part / np.outer(size, size), hermitian=True)) / size**2
    return Estimate(result.status.code, theta, errors, known, index, inverse, rounding)


def violations(
    base: Estimate, other: Estimate, change: str, truth: np.ndarray, least: float = LEAST_LOST
) -> list[str]:
    """In what two estimates that should agree do not; `least`: share lost by a split at least."""
    found = []
    if base.status != other.status:
        found.append(f"status {base.status}, {other.status}")
    if not np.all(np.isfinite(base.errors) == np.isfinite(other.errors)):
        return [*found, "errors not known of the same parameters"]
    size = np.fmax(base.errors, other.errors)
    moved = np.abs(other.theta - base.theta)
    known = size > ROUNDING * np.abs(base.theta)
    ratio = np.abs(np.log(np.where(known, other.errors / base.errors, 1.0)))
    limit, spread = CLOSE * size + ROUNDING * np.abs(base.theta), np.full(len(size), CLOSE)
    if change == "split":
        lost = np.maximum(1.0 - base.inverse / other.inverse, least)
        off = np.abs(base.theta - truth)
        limit = np.fmax(student(np.fmin(base.freedom, other.freedom)) * size, SIGMAS * off)
        limit *= np.sqrt(lost / (1.0 - lost))
        size = np.fmax(size, off)
        spread = SIGMAS * np.sqrt(0.5 / base.freedom + 0.5 / other.freedom)
    if np.any(moved > limit):
        worst = int(np.nanargmax(moved / limit))
        found.append(f"estimate {moved[worst] / size[worst]:.2g} of its error")
    if np.any(ratio > spread):
        found.append(f"error by a factor of {np.exp(np.nanmax(ratio)):.5g}")
    if change != "split":
        apart = np.abs(other.index - base.index)
        if np.any(apart > CLOSE * np.abs(base.index) + base.rounding):
            found.append(f"index by {np.max(apart / np.abs(base.index)):.2g}")
    return found


def student(freedom: np.ndarray) -> np.ndarray:
    """Quantiles of t exceeded as rarely as `SIGMAS` of a normal variable; unknown ν: `SIGMAS`."""
    known = np.where(np.isfinite(freedom), freedom, np.inf)
    return stats.t.isf(stats.norm.sf(SIGMAS), known)


def discovered(one: Experiment) -> tuple[str, tuple[str, ...]]:
    """Status and effects, sorted."""
    found = eoi.discover(one.model, one.made(), refine=False)
    return found.status.code, tuple(sorted(found.effects))


# -- the report -------------------------------------------------------------------------------


@dataclass
class Count:
    """Of one family and change: comparisons, and violations in words."""

    compared: int = 0
    violated: list[str] = field(default_factory=list)


def compared(
    seeds: Sequence[int], changes: Sequence[str] = CHANGES, said: Callable[[str], None] = print
) -> dict[tuple[str, str], Count]:
    """Identified and refined, by family and change.

    Args:
        seeds: of the plants.
        changes: that are tried.
        said: called with each violation as it is found.
    """
    counts: dict[tuple[str, str], Count] = {}
    for seed in seeds:
        one = experiment(seed)
        base = identified(one)
        truth = np.asarray(list(one.truth.values()))
        for change in changes:
            if change == "split" and (FAMILIES[one.name].internal or FAMILIES[one.name].delayed):
                continue
            split, told = change == "split", changed(one, change, seed)
            other = identified(told, **(choices(one) if split else {}))
            tried = [(change, other, LEAST_LOST)]
            if split:
                tried += [(STRICTER, other, STRICTLY_LOST), (ANEW, identified(told), LEAST_LOST)]
            for name, found, least in tried:
                count = counts.setdefault((one.name, name), Count())
                for method, a, b in zip(("identify", "refine"), base, found, strict=True):
                    count.compared += 1
                    for words in violations(a, b, change, truth, least):
                        count.violated.append(f"{seed}, {one.name}, {name}, {method}: {words}")
                        said(count.violated[-1])
    return counts


def found_alike(
    seeds: Sequence[int], changes: Sequence[str] = CHANGES, said: Callable[[str], None] = print
) -> dict[tuple[str, str], Count]:
    """By `discover`, from models that lack an effect; arguments as for `compared`."""
    counts: dict[tuple[str, str], Count] = {}
    for seed in seeds:
        one = experiment(seed, lacking=True)
        base = discovered(one)
        for change in changes:
            other = discovered(changed(one, change, seed))
            count = counts.setdefault((one.name, change), Count())
            count.compared += 1
            if other != base:
                count.violated.append(f"{seed}, {one.name}, {change}, discover: {base}, {other}")
                said(count.violated[-1])
    return counts


def lacking_seeds(count: int) -> list[int]:
    """Plants of families that name an effect."""
    named = [i for i, one in enumerate(FAMILIES.values()) if one.lacks]
    return [named[k % len(named)] + len(FAMILIES) * (k // len(named)) for k in range(count)]


def _rows(counts: Mapping[tuple[str, str], Count]) -> list[list[str]]:
    families = list(dict.fromkeys(name for name, _ in counts))
    columns = [*CHANGES, *(one for one in (STRICTER, ANEW) if any(one in key for key in counts))]

    def cell(name: str, change: str) -> str:
        one = counts.get((name, change), Count())
        return f"{len(one.violated)} of {one.compared}"

    return [[name, *(cell(name, change) for change in columns)] for name in families]


def main() -> None:
    """Every plant and change."""
    options = arguments(__doc__)
    count = 20 if options.quick else PLANTS
    report = Report("What must not change an estimate")
    header = ("family", *CHANGES)
    found: dict[tuple[str, str], Count] = {}
    for seed in range(count):
        for key, one in compared([seed]).items():
            total = found.setdefault(key, Count())
            total.compared += one.compared
            total.violated += one.violated
        print(f"{seed + 1} of {count}", file=sys.stderr, flush=True)
    report.add(
        f"{count} plants, each identified and refined as it is and after five changes: how often "
        "estimate, standard error, index or status were not the same.",
        table((*header, STRICTER, ANEW), _rows(found)),
    )
    alike = found_alike(lacking_seeds(max(count // DISCOVERED, 1)))
    report.add("The same of the answer of `discover`.", table(header, _rows(alike)))
    both = [*found.items(), *alike.items()]
    for title, kept in (
        ("Violations", lambda change: change in CHANGES),
        ("Beside these, not counted", lambda change: change not in CHANGES),
    ):
        counts = [one for (_, change), one in both if kept(change)]
        every = [words for one in counts for words in one.violated]
        report.add(f"{title}: {len(every)} of {sum(one.compared for one in counts)} comparisons.")
        if every:
            report.add("\n".join(f"- {words}" for words in every))
    report.close(__file__, options.write)


if __name__ == "__main__":
    main()
