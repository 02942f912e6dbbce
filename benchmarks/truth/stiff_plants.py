"""Plants with time constants from a hundredth of a sample on: is the free run of the truth right?

    python benchmarks/truth/stiff_plants.py [--quick] [--write]

A hundred random plants, half of them linear, with held inputs. The true parameters are judged by
`eoi.validate`: its error over the noise is one, unless the simulation itself is wrong. SciPy makes
the data: exactly (matrix exponential) where the plant is linear, else by LSODA, which is implicit
where a plant is stiff, to a relative tolerance of 1e-9, restarted wherever the input jumps.
"""

import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks.common import Report, arguments, table

PLANTS = 100
NOISE = 1e-3  # of the standard deviation of each output
SAMPLES = 1500
HELD = (1, 16)  # samples for which the input keeps its level, at least and below
FASTEST, MIDDLE, SLOWEST = 0.01, 10.0, 300.0  # time constants [samples]
HEAD = 50  # samples from which the library estimates the start; not scored
ASKED = 1.05  # error over the noise


@dataclass(frozen=True)
class StiffPlant:
    """A random plant.

    Attributes:
        name: kind and number.
        linear: whether it is.
        rates: dx/dt of all states; ``rates(m, x, u)`` with m NumPy or JAX.
        degree: relative degree of the outputs, which are the first states.
        outputs, states: numbers of them.
        start: of the states.
        period: of the samples [s].
        fastest: time constant [samples].
    """

    name: str
    linear: bool
    rates: Callable[[Any, Any, Any], list]
    degree: int
    outputs: int
    states: int
    start: np.ndarray
    period: float
    fastest: float


def drawn(number: int) -> StiffPlant:
    """The plant of this number: every other one is linear, of one of three kinds in turn."""
    draw = np.random.default_rng([32, number])
    linear, period = number % 2 == 0, 10.0 ** draw.uniform(-4, 2)
    kind = ("network", "motor", "mass")[number // 2 % 3]
    count = 2 if kind != "network" else int(draw.integers(2, 5))
    # One far faster than the sampling, one in real rigs' range, the others anywhere.
    constants = np.exp(draw.uniform(np.log(FASTEST), np.log(MIDDLE), count))
    constants[0] = np.exp(draw.uniform(np.log(FASTEST), np.log(0.3)))
    constants[1] = np.exp(draw.uniform(np.log(1.0), np.log(SLOWEST)))
    fastest, constants = constants[0], period * constants
    bend = 0.0 if linear else float(draw.uniform(0.3, 1.0))
    if kind == "mass":
        fast, slow = constants
        rates = _mass(fast, slow, bend)
        return StiffPlant(
            f"{kind} {number}", linear, rates, 2, 1, 2, np.array([0.5, 0.0]), period, fastest
        )
    order = draw.permutation(count)
    start = draw.uniform(-0.5, 0.5, count)
    if kind == "motor":
        electric, mechanic = constants
        rates, outputs = _motor(electric, mechanic, bend), int(draw.integers(1, 3))
        start *= outputs == 2
    else:
        rates, outputs = _network(draw, constants[order], bend), int(draw.integers(1, count))
        start[outputs:] = 0.0
    return StiffPlant(f"{kind} {number}", linear, rates, 1, outputs, count, start, period, fastest)


def _network(draw: np.random.Generator, constants: np.ndarray, bend: float) -> Callable:
    """Stores that exchange what they hold: each sees the others by less than itself."""
    count = len(constants)
    weights = draw.uniform(-1.0, 1.0, (count, count)) * (1.0 - np.eye(count))
    weights *= 0.7 / np.sum(np.abs(weights), axis=1, keepdims=True)
    gains = draw.uniform(0.5, 1.5, count)

    def rates(m: Any, x: Any, u: Any) -> list:
        others = [sum(w * m.tanh(bend * x[j]) / bend if bend else w * x[j]
                      for j, w in enumerate(row)) for row in weights]  # fmt: skip
        return [
            (gain * u - x[i] - bend * x[i] ** 3 + other) / constant
            for i, (gain, other, constant) in enumerate(zip(gains, others, constants, strict=True))
        ]

    return rates


def _motor(electric: float, mechanic: float, bend: float) -> Callable:
    """Current and speed; with friction that grows with the square of the speed if not linear."""

    def rates(m: Any, x: Any, u: Any) -> list:
        friction = 0.3 * x[1] + bend * x[1] * m.abs(x[1])
        return [(u - x[0] - 0.5 * x[1]) / electric, (x[0] - friction) / mechanic]

    return rates


def _mass(fast: float, slow: float, bend: float) -> Callable:
    """An overdamped mass on a spring, hardening if not linear."""

    def rates(m: Any, x: Any, u: Any) -> list:
        del m
        force = u - x[0] - bend * x[0] ** 3
        return [x[1], (force - (fast + slow) * x[1]) / (fast * slow)]

    return rates


def declared(plant: StiffPlant) -> eoi.Plant:
    """The true plant, as a user writes it; its time scale is the only parameter."""
    ny, nz = plant.outputs, plant.states - plant.outputs * plant.degree

    def all_rates(x: Any, u: Any, p: Any) -> list:
        states = [*jnp.ravel(x.y), *x.z]
        return [p.speed * rate for rate in plant.rates(jnp, states, u[0])]

    def dynamics(t: Any, x: Any, u: Any, p: Any) -> Any:
        del t
        first = plant.degree - 1
        return jnp.stack(all_rates(x, u, p)[first : first + ny])

    def internal(t: Any, x: Any, u: Any, p: Any) -> Any:
        del t
        return jnp.stack(all_rates(x, u, p)[ny:])

    return eoi.Plant(
        dynamics, {"speed": 1.0}, plant.degree, ("u",), tuple(f"y{j + 1}" for j in range(ny)),
        internal=internal if nz else None, internal_initial=(0.0,) * nz if nz else None,
        name=plant.name.replace(" ", "_"),
    )  # fmt: skip


# -- data -------------------------------------------------------------------------------------


def record(plant: StiffPlant, samples: int, draw: np.random.Generator) -> tuple[Any, np.ndarray]:
    """A record with noise, and the noise of the outputs."""
    lengths = draw.integers(*HELD, samples)
    inputs = np.repeat(draw.uniform(-1.0, 1.0, samples), lengths)[:samples]
    states = (_exact if plant.linear else _integrated)(plant, inputs)
    y = states[:, : plant.outputs]
    noise = NOISE * np.std(y, axis=0) * draw.standard_normal(y.shape)
    time_grid = plant.period * np.arange(samples)
    return eoi.Record(time_grid, inputs, y + noise, plant.name, hold="zero"), noise


def _exact(plant: StiffPlant, inputs: np.ndarray) -> np.ndarray:
    """States at the samples: x and the held u together are a linear system without an input."""
    count = plant.states
    system = np.zeros((count + 1, count + 1))
    for i, unit in enumerate(np.eye(count + 1)):
        system[:count, i] = plant.rates(np, unit[:count], unit[count])
    step = expm(plant.period * system)
    states = np.empty((len(inputs), count))
    states[0] = plant.start
    for k in range(len(inputs) - 1):
        states[k + 1] = step[:count] @ np.append(states[k], inputs[k])
    return states


def _integrated(plant: StiffPlant, inputs: np.ndarray) -> np.ndarray:
    states = np.empty((len(inputs), plant.states))
    states[0] = plant.start
    edges = [0, *(np.flatnonzero(np.diff(inputs)) + 1).tolist(), len(inputs) - 1]
    for first, last in pairwise(edges):
        if first == last:
            continue
        time_grid = plant.period * np.arange(first, last + 1)
        solution = solve_ivp(
            lambda _, x, level=inputs[first]: plant.rates(np, x, level),
            (time_grid[0], time_grid[-1]), states[first], t_eval=time_grid, method="LSODA",
            rtol=1e-9, atol=1e-11,
        )  # fmt: skip
        states[first : last + 1] = solution.y.T
    return states


# -- answer -----------------------------------------------------------------------------------


def main() -> None:
    """Judge all plants and write the table."""
    options = arguments(__doc__)
    count, samples = (6, 400) if options.quick else (PLANTS, SAMPLES)
    report, rows, ratios = Report("Stiff plants"), [], []
    warnings.simplefilter("ignore")
    for number in range(count):
        plant = drawn(number)
        data, noise = record(plant, samples, np.random.default_rng([33, number]))
        started = time.perf_counter()
        answer = eoi.validate(declared(plant), data)
        seconds = time.perf_counter() - started
        worst = float(np.max(answer.rmse / np.sqrt(np.mean(noise[HEAD:] ** 2, axis=0))))
        ratios.append(worst)
        rows.append((
            plant.name, "yes" if plant.linear else "no", f"{plant.fastest:.3f}", f"{worst:.4g}",
            f"{seconds:.1f} s", "; ".join(answer.notes),
        ))  # fmt: skip
        print(*rows[-1], file=sys.stderr, flush=True)
    good = sum(ratio <= ASKED for ratio in ratios)
    report.add(
        f"Error of the true parameters over the noise: at most {max(ratios):.4g}, median "
        f"{np.median(ratios):.4g}; {good} of {count} at most {ASKED}.",
        table(("plant", "linear", "fastest [samples]", "error / noise", "time", "notes"), rows),
    )
    report.close(__file__, options.write)


if __name__ == "__main__":
    main()
