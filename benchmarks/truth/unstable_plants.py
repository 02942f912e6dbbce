r"""Unstable plants under feedback: does `refine` reach what windows of the record tell?

    python benchmarks/truth/unstable_plants.py [--quick] [--write]

Each rig is simulated with SciPy (DOP853, relative tolerance 1e-10) under a digital controller that
has the true state and a reference with steps; the record has the input of a converter, which holds
it over a sample, and outputs with white noise. `identify` starts from a model that is 10 to 50 %
wrong, `refine` from its answer; nothing else is set, the hold of the input neither.

The bound is the standard error of least squares of free runs in windows of three time constants of
the unstable mode, each with a start of its own, at the true parameters:
$\sigma^2 (J^\top J)^{-1}$, $J$ by differences of a Runge-Kutta rule of four steps a sample that
shares no code with the library. *Least squares*: `scipy.optimize.least_squares` of the same
runs from the truth, to tell an error of the library from what the records do not tell.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
import eoi_jax as eoi
from benchmarks.common import Report, arguments, table

NOISES = (1e-3, 1e-2)  # of the rms of each output about its mean
SEEDS = 12
TIME_CONSTANTS = 3.0  # of the unstable mode in a window of the bound
SUBSTEPS = 4  # of the Runge-Kutta rule of the bound

Values = dict[str, float]
Rate = Callable[[np.ndarray, np.ndarray, Any], np.ndarray]  # of states (n, ...), input, parameters


@dataclass(frozen=True)
class Rig:
    """A plant and its controller.

    Attributes:
        name: what it is.
        model: declared, with the wrong parameters.
        truth: the true ones, in the order of the model's.
        rate: dx/dt; the outputs, then their derivatives, are the states.
        control: input from the reference and the states.
        high: largest size of the reference.
        each: samples between its steps.
        period: of the samples [s]. samples: of a record.
        window: of the bound [s].
    """

    name: str
    model: eoi.Plant
    truth: Values
    rate: Rate
    control: Callable[[np.ndarray, np.ndarray], np.ndarray]
    high: float
    each: int
    period: float
    samples: int
    window: float

    @property
    def states(self) -> int:
        """Number of states."""
        return self.model.relative_degree * len(self.model.outputs)


# -- models -----------------------------------------------------------------------------------


def _levitation(t: Any, x: Any, u: Any, p: Any) -> Any:
    del t
    return 9.81 - p.k * (u / (x.y[0] + p.offset)) ** 2 - p.d * x.y[1]


def _levitation_rate(x: np.ndarray, u: np.ndarray, p: Any) -> np.ndarray:
    k, offset, d = p
    return np.stack([x[1], 9.81 - k * (u / (x[0] + offset)) ** 2 - d * x[1]])


def _cart_pole(t: Any, x: Any, u: Any, p: Any) -> Any:
    del t
    (_, angle), (v, w) = x.y
    s, c = jnp.sin(angle), jnp.cos(angle)
    push = (u[0] - p.friction * v + 0.2 * p.length * w**2 * s) / (p.cart + 0.2)
    turn = (9.81 * s - c * push) / (p.length * (4.0 / 3.0 - 0.2 * c**2 / (p.cart + 0.2)))
    return jnp.stack([push - 0.2 * p.length * turn * c / (p.cart + 0.2), turn])


def _cart_pole_rate(x: np.ndarray, u: np.ndarray, p: Any) -> np.ndarray:
    cart, length, friction = p
    _, angle, v, w = x
    s, c = np.sin(angle), np.cos(angle)
    total = cart + 0.2
    push = (u - friction * v + 0.2 * length * w**2 * s) / total
    turn = (9.81 * s - c * push) / (length * (4.0 / 3.0 - 0.2 * c**2 / total))
    return np.stack([v, w, push - 0.2 * length * turn * c / total, turn])


def _second_order(t: Any, x: Any, u: Any, p: Any) -> Any:
    del t
    return p.a * x.y[0] - p.b * x.y[1] + p.c * u


def _second_order_rate(x: np.ndarray, u: np.ndarray, p: Any) -> np.ndarray:
    a, b, c = p
    return np.stack([x[1], a * x[0] - b * x[1] + c * u])


def _roll(t: Any, x: Any, u: Any, p: Any) -> Any:
    del t
    return p.gain * u - p.drag * x.y[1] + p.wind


def _roll_rate(x: np.ndarray, u: np.ndarray, p: Any) -> np.ndarray:
    gain, drag, wind = p
    return np.stack([x[1], gain * u - drag * x[1] + wind])


def _reactor(t: Any, x: Any, u: Any, p: Any) -> Any:
    del t
    return p.heat * (jnp.exp(0.25 * x.y[0]) - 1.0) - p.loss * x.y[0] - p.cooling * u


def _reactor_rate(x: np.ndarray, u: np.ndarray, p: Any) -> np.ndarray:
    heat, loss, cooling = p
    return (heat * (np.exp(0.25 * x[0]) - 1.0) - loss * x[0] - cooling * u)[None]


def rigs() -> list[Rig]:
    """All of them."""
    return [
        Rig("magnetic levitation",
            eoi.Plant(_levitation, {"k": 1.1e-3, "offset": 0.0015, "d": 2.0}, 2,
                      outputs=("gap",)),
            {"k": 1.4e-3, "offset": 0.002, "d": 1.0}, _levitation_rate,
            lambda r, x: 1.0037 + 180.0 * (x[0] - 0.01 - r) + 4.0 * x[1],
            1.5e-3, 80, 1e-3, 3000, TIME_CONSTANTS / 40.0),
        Rig("cart-pole",
            eoi.Plant(_cart_pole, {"cart": 0.8, "length": 0.6, "friction": 0.5}, 2,
                      outputs=("cart_position", "angle")),
            {"cart": 1.0, "length": 0.5, "friction": 0.3}, _cart_pole_rate,
            lambda r, x: 4.0 * (x[0] - r) + 55.0 * x[1] + 7.0 * x[2] + 13.0 * x[3],
            0.5, 150, 0.01, 2000, TIME_CONSTANTS / 4.1),
        Rig("second order, linear",
            eoi.Plant(_second_order, {"a": 20.0, "b": 0.6, "c": 5.0}, 2),
            {"a": 25.0, "b": 1.0, "c": 4.0}, _second_order_rate,
            lambda r, x: -18.0 * (x[0] - r) - 2.5 * x[1],
            1.0, 60, 0.01, 2000, TIME_CONSTANTS / 4.5),
        Rig("roll of a drone",
            eoi.Plant(_roll, {"gain": 9.0, "drag": 0.8, "wind": 0.0}, 2, outputs=("roll",)),
            {"gain": 12.0, "drag": 0.4, "wind": 0.5}, _roll_rate,
            lambda r, x: -3.0 * (x[0] - r) - 0.7 * x[1],
            0.4, 75, 0.01, 2000, 2.0),
        Rig("reactor",
            eoi.Plant(_reactor, {"heat": 0.5, "loss": 0.05, "cooling": 0.15}, 1,
                      outputs=("temperature",)),
            {"heat": 0.6, "loss": 0.07, "cooling": 0.1}, _reactor_rate,
            lambda r, x: 8.0 * (x[0] - r),
            2.0, 60, 1.0, 1500, TIME_CONSTANTS / 0.08),
    ]  # fmt: skip


# -- records ----------------------------------------------------------------------------------


def simulated(rig: Rig, seeds: range, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Inputs (seeds, samples) and states (seeds, samples, n), all side by side."""
    truth, shape = list(rig.truth.values()), (rig.states, len(seeds))
    draws = [np.random.default_rng(seed) for seed in seeds]
    steps = -(-samples // rig.each)
    levels = np.stack([rig.high * draw.uniform(-1.0, 1.0, steps) for draw in draws])
    reference = np.repeat(levels, rig.each, axis=1)[:, :samples]
    x = np.zeros(shape)
    x[0] = 0.01 if rig.name == "magnetic levitation" else 0.0
    inputs, states = np.empty((len(seeds), samples)), np.empty((len(seeds), samples, rig.states))
    for k in range(samples):
        u = rig.control(reference[:, k], x)
        inputs[:, k], states[:, k] = u, x.T

        def right(_: float, flat: np.ndarray, u: np.ndarray = u) -> np.ndarray:
            return rig.rate(flat.reshape(shape), u, truth).ravel()

        x = solve_ivp(right, (0.0, rig.period), x.ravel(), method="DOP853",
                      rtol=1e-10, atol=1e-12).y[:, -1].reshape(shape)  # fmt: skip
    return inputs, states


def record(rig: Rig, seed: int, noise: float, u: np.ndarray, y: np.ndarray) -> eoi.Record:
    """With noise on the outputs."""
    draw = np.random.default_rng([seed, round(1e6 * noise)])
    noisy = y + noise * np.std(y, axis=0) * draw.standard_normal(y.shape)
    return eoi.Record(rig.period * np.arange(len(u)), u[:, None], noisy, f"seed {seed}")


# -- the bound --------------------------------------------------------------------------------


class Windows:
    """Free runs in windows by a Runge-Kutta rule: errors over σ and their derivatives."""

    def __init__(self, rig: Rig, u: np.ndarray, y: np.ndarray, sigma: np.ndarray):
        self.rig, self.sigma = rig, sigma
        count = round(rig.window / rig.period)
        runs = len(u) // count
        self.u = u[: runs * count].reshape(runs, count)
        self.y = y[: runs * count].reshape(runs, count, -1)

    def starts(self, states: np.ndarray) -> np.ndarray:
        """States at the first sample of each window out of all, (samples, n); (runs, n)."""
        return states[: self.u.size : self.u.shape[1]]

    def errors(self, theta: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """(..., runs, samples, ny), for θ (np, ...) and starts (runs, n) or (..., runs, n)."""
        ny, h = self.y.shape[2], self.rig.period / SUBSTEPS
        p = np.asarray(theta)[..., None]
        x = np.moveaxis(np.broadcast_to(starts, (*p.shape[1:-1], *starts.shape[-2:])), -1, 0)
        y_hat = []
        for u in self.u.T:
            y_hat.append(x[:ny])
            for _ in range(SUBSTEPS):
                k1 = self.rig.rate(x, u, p)
                k2 = self.rig.rate(x + 0.5 * h * k1, u, p)
                k3 = self.rig.rate(x + 0.5 * h * k2, u, p)
                x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + self.rig.rate(x + h * k3, u, p))
        y_hat = np.moveaxis(np.stack(y_hat), (0, 1), (-2, -1))
        return (self.y - y_hat) / self.sigma

    def jacobian(self, theta: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives with θ, (rows, np), and with the starts, (runs, rows a run, n)."""
        runs, n = starts.shape
        sizes = 1e-6 * np.concatenate([np.abs(theta), np.std(starts, axis=0) + 1e-9])
        moved = np.eye(len(sizes)) * sizes
        change = self.errors(
            theta[:, None] + moved[: len(theta)], starts + moved.T[:, None, len(theta) :]
        ) - self.errors(
            theta[:, None] - moved[: len(theta)], starts - moved.T[:, None, len(theta) :]
        )
        slopes = change.reshape(len(sizes), runs, -1) / (2.0 * sizes[:, None, None])
        return slopes[: len(theta)].reshape(len(theta), -1).T, np.moveaxis(slopes[-n:], 0, -1)

    def bound(self, theta: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Standard errors of θ with the starts unknown."""
        shared, blocks = self.jacobian(theta, starts)
        left = []
        for rows, block in zip(np.split(shared, len(blocks)), blocks, strict=True):
            basis, _ = np.linalg.qr(block / np.linalg.norm(block, axis=0))
            left.append(rows - basis @ (basis.T @ rows))
        left = np.concatenate(left)
        size = np.linalg.norm(left, axis=0)
        return np.sqrt(np.diag(np.linalg.inv((left / size).T @ (left / size)))) / size

    def estimate(self, theta: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Least squares by SciPy over θ and all starts."""
        begin = np.concatenate([theta, starts.ravel()])

        def split(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return values[: len(theta)], values[len(theta) :].reshape(starts.shape)

        def jacobian(values: np.ndarray) -> np.ndarray:
            shared, blocks = self.jacobian(*split(values))
            runs, rows, n = blocks.shape
            full = np.zeros((runs, rows, runs, n))
            full[np.arange(runs), :, np.arange(runs)] = blocks
            return np.concatenate([shared, full.reshape(runs * rows, runs * n)], axis=1)

        def errors(values: np.ndarray) -> np.ndarray:
            return self.errors(*split(values)).ravel()

        slopes: Any = jacobian  # SciPy's stub knows strings only
        fit = least_squares(errors, begin, slopes, method="lm", x_scale="jac")
        return fit.x[: len(theta)]


# -- the table --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """Errors of one record over the bound, each (np,), and the seconds of `refine`."""

    before: np.ndarray
    after: np.ndarray
    independent: np.ndarray
    seconds: float
    window: float | None
    status: str


def outcome(rig: Rig, seed: int, noise: float, u: np.ndarray, states: np.ndarray) -> Outcome:
    """One record, of these inputs and states."""
    y = states[:, : len(rig.model.outputs)]
    measured = record(rig, seed, noise, u, y)
    truth, names = np.asarray(list(rig.truth.values())), list(rig.truth)
    runs = Windows(rig, u, measured.outputs, noise * np.std(y, axis=0))
    starts = runs.starts(states)
    bound = runs.bound(truth, starts)
    passes = eoi.identify(rig.model, measured)
    started = time.perf_counter()
    refined = eoi.refine(passes, measured)
    seconds = time.perf_counter() - started

    def over(values: Values) -> np.ndarray:
        return (np.asarray([values[name] for name in names]) - truth) / bound

    independent = (runs.estimate(truth, starts) - truth) / bound
    return Outcome(over(passes.parameters), over(refined.parameters), independent, seconds,
                   refined.window, refined.status.code)  # fmt: skip


def rms(values: list[np.ndarray]) -> float:
    """Over all."""
    return float(np.sqrt(np.mean(np.square(values))))


def main() -> None:
    """One row for each rig and noise."""
    options = arguments(__doc__)
    seeds = range(700, 700 + (2 if options.quick else SEEDS))
    report = Report("Unstable plants under feedback")
    report.add(
        f"{len(seeds)} records a row, seeds from {seeds[0]}. Errors of the parameters over the "
        "bound, rms over parameters and records; by chance one of so many lies within about "
        f"±{100 / np.sqrt(2 * 3 * len(seeds)):.0f} %. *Never worse*: records after whose "
        "refinement the rms over the parameters is at most that before, or below 1. *Least "
        "squares*: of SciPy from the truth, in the windows of the bound. Times: median of "
        "`refine`; the hold of the input is left out, so that all three are tried."
    )
    rows, all_after, all_independent = [], {noise: [] for noise in NOISES}, {n: [] for n in NOISES}
    for rig in rigs():
        samples = rig.samples // 2 if options.quick else rig.samples
        inputs, states = simulated(rig, seeds, samples)
        for noise in NOISES:
            results = [outcome(rig, seed, noise, u, x)
                       for seed, u, x in zip(seeds, inputs, states, strict=True)]  # fmt: skip
            kept = sum(rms([r.after]) <= max(rms([r.before]), 1.0) for r in results)
            all_after[noise] += [r.after for r in results]
            all_independent[noise] += [r.independent for r in results]
            windows = [r.window for r in results if r.window is not None]
            used = f"{np.median(windows):.3g} s, {len(windows)} times" if windows else "whole"
            statuses = ", ".join(sorted({r.status for r in results}))
            rows.append([rig.name, f"{noise:g}", f"{rms([r.before for r in results]):.3g}",
                         f"{rms([r.after for r in results]):.3g}",
                         f"{rms([r.independent for r in results]):.3g}",
                         f"{kept} of {len(results)}", f"{rig.window:.3g} s", used, statuses,
                         f"{np.median([r.seconds for r in results]):.1f} s"])  # fmt: skip
            print(rows[-1], flush=True)
    for noise in NOISES:
        rows.append(["all", f"{noise:g}", "", f"{rms(all_after[noise]):.3g}",
                     f"{rms(all_independent[noise]):.3g}", "", "", "", "", ""])  # fmt: skip
    report.add(table(["rig", "noise", "passes", "refined", "least squares", "never worse",
                      "window of the bound", "of `refine`", "status", "time"], rows))  # fmt: skip
    report.close(__file__, options.write)


if __name__ == "__main__":
    main()
