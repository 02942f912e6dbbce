"""What a situation is: files and a config as a person brings them, and what a right answer says."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

Parameters = Mapping[str, float]
Frames = dict[str, pd.DataFrame]


def to_csv(table: pd.DataFrame) -> str:
    """Eight digits, empty cells where nothing was measured."""
    return table.to_csv(index=False, float_format="%.8g")


def dated(start: str, name: str, separator: str) -> Callable[[pd.DataFrame], str]:
    """A writer of dates, to the second, in a column `name` in the place of the time."""

    def write(table: pd.DataFrame) -> str:
        seconds = np.round(table["t"].to_numpy(float)).astype("timedelta64[s]")
        stamps = np.datetime_as_string(np.datetime64(start, "s") + seconds)
        table = table.rename(columns={"t": name})
        table[name] = [stamp.replace("T", separator) for stamp in stamps]
        return to_csv(table)

    return write


@dataclass(frozen=True)
class Situation:
    """A person's record, model and question, with the answer that is right.

    Attributes:
        name: of the situation.
        kind: what makes it difficult.
        plant: sort of plant.
        source: thread where somebody asks about such a situation.
        parameters: parameters of the simulation by name; those of the config have the same names.
        simulate: tables of all files without noise, by file name, from these parameters. Files
            whose name begins with "test" are held out.
        config: TOML, as that person would write it.
        command: of `eoi`.
        noise: standard deviation by column.
        step: quantisation by column, after the noise.
        spoil: what else is lost or changed: ``spoil(file, table, rng)``.
        write: text of a table.
        truth: values by parameter, or by expression of parameters where only that is determined.
        tolerance: largest error of these values, relative.
        effects: what must be named, each with the names of the same function; None: not asked.
        inseparable: parameters of which one sentence must say that they cannot be told apart.
        refusal: pieces of the message where the right answer is a refusal.
        held_out: bound of the held-out free-run error over the noise, by output.
        seconds: processor time of the command [s].
        fitted: names in `parameters` that the independent fit varies; default: all.
        reason: reason of a tolerance other than 5 %, or of what is asked.
    """

    name: str
    kind: str
    plant: str
    source: str
    parameters: dict[str, float]
    simulate: Callable[[Parameters], Frames]
    config: str
    command: Literal["identify", "discover", "refine"] = "identify"
    noise: dict[str, float] = field(default_factory=dict)
    step: dict[str, float] = field(default_factory=dict)
    spoil: Callable[[str, pd.DataFrame, np.random.Generator], pd.DataFrame] | None = None
    write: Callable[[pd.DataFrame], str] = to_csv
    truth: dict[str, float] = field(default_factory=dict)
    tolerance: float = 0.05
    effects: tuple[tuple[str, ...], ...] | None = None
    inseparable: tuple[str, ...] = ()
    refusal: tuple[str, ...] = ()
    held_out: dict[str, float] = field(default_factory=dict)
    seconds: float = 60.0
    fitted: tuple[str, ...] = ()
    reason: str = ""

    def tables(self, rng: np.random.Generator) -> Frames:
        """What the instruments recorded, by file name."""
        return {
            file: self._measured(file, table, rng)
            for file, table in self.simulate(self.parameters).items()
        }

    def files(self, rng: np.random.Generator) -> dict[str, str]:
        """Text of the files by name."""
        return {file: self.write(table) for file, table in self.tables(rng).items()}

    def level(self, column: str) -> float:
        """Standard deviation of the noise and the rounding of a column."""
        step = self.step.get(column, 0.0)
        return float(np.hypot(self.noise.get(column, 0.0), step / np.sqrt(12.0)))

    def _measured(self, file: str, table: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
        table = table.copy()
        for column, deviation in self.noise.items():
            if column in table:
                table[column] += deviation * rng.standard_normal(len(table))
        for column, step in self.step.items():
            table[column] = np.round(table[column] / step) * step
        return table if self.spoil is None else self.spoil(file, table, rng)


# -- simulation -------------------------------------------------------------------------------

Derivative = Callable[[float, np.ndarray, np.ndarray], object]


def solve(
    f: Derivative,
    start: object,
    time: np.ndarray,
    inputs: np.ndarray | Callable[[float], object] | None = None,
    scale: float = 1.0,
) -> np.ndarray:
    """States (N, nx) of x' = f(t, x, u) at the samples, to nine digits of `scale`.

    Args:
        f: right-hand side; u has shape (nu,).
        start: states at the first sample.
        time: samples (N,).
        inputs: functions of time, or values (N,) or (N, nu) that are held between samples.
        scale: size of the states.
    """
    start = np.atleast_1d(np.asarray(start, float))
    options = {"method": "LSODA", "rtol": 1e-9, "atol": 1e-9 * scale}
    if inputs is None or callable(inputs):
        signal: Callable[[float], Any] = inputs or (lambda _: ())
        longest = (time[-1] - time[0]) / 100
        right = lambda t, x: f(t, x, np.atleast_1d(signal(t)))  # noqa: E731
        span = (time[0], time[-1])
        return solve_ivp(right, span, start, t_eval=time, max_step=longest, **options).y.T
    u = np.asarray(inputs, float).reshape(len(time), -1)
    states = np.empty((len(time), len(start)))
    states[0] = start
    changes = np.flatnonzero(np.any(np.diff(u, axis=0) != 0, axis=1)) + 1
    for first, last in pairwise([0, *changes.tolist(), len(time) - 1]):
        right = lambda t, x, level=u[first]: f(t, x, level)  # noqa: E731
        stamps = time[first : last + 1]
        span = (stamps[0], stamps[-1])
        states[first : last + 1] = solve_ivp(
            right, span, states[first], t_eval=stamps, **options
        ).y.T
    return states


def levels(seed: int, values: object, count: int, length: int) -> np.ndarray:
    """A staircase (count · length,): levels drawn from `values`, none twice in a row."""
    rng = np.random.default_rng(seed)
    values = np.asarray(values, float)
    drawn = [rng.choice(values)]
    while len(drawn) < count:
        level = rng.choice(values)
        if level != drawn[-1]:
            drawn.append(level)
    return np.repeat(drawn, length)


def sines(seed: int, low: float, high: float, count: int, size: float) -> Callable:
    """A sum of sines between two frequencies [rad/s], each of amplitude `size`."""
    rng = np.random.default_rng(seed)
    frequency, phase = rng.uniform(low, high, count), rng.uniform(0, 2 * np.pi, count)
    return lambda t: size * np.sin(np.multiply.outer(t, frequency) + phase).sum(axis=-1)


def frame(time: np.ndarray, **columns: np.ndarray) -> pd.DataFrame:
    """A table whose first column is the time `t` [s]."""
    return pd.DataFrame({"t": time, **columns})
