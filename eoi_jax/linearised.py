r"""What a small force does to the free runs of a refined model, beside its own unknowns.

A small force $w$ added to $y^{(r)}$ moves the free run by $\hat y_w$, the solution of the equation
linearised along it, $\delta^{(r)} = \partial_x f\,\delta + w$: one more column of the sensitivities
of `sensitivity.py`, that of the gain of $w$ at zero. With $w$ the term of an effect along the
simulated states, at unit gain, and all that the parameters and the initial states can do taken out
of $\hat y_w$ and of the residual $r$, least squares of $r$ on $\hat y_w$ gives the gain and the
share of the residual that it explains. With a share s, $-n \log(1 - s)$ is χ², n the number of
independent samples: all of them over the correlation time Σ ρ² of what is left (M. S. Bartlett).

**Source.** C. R. Rao, Proc. Cambridge Phil. Soc. 44 (1948) 50 (score test).
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from eoi_jax.augment import Placed
from eoi_jax.data.record import Record
from eoi_jax.effects.effect import AbstractActuator, AbstractInputEffect, AbstractTerm, At, Seen
from eoi_jax.output_error import (
    Problem,
    Span,
    Unknowns,
    kernel_of,
    problem_of,
    signals,
    weighed,
)
from eoi_jax.plants.plant import Plant, State, parameter_type
from eoi_jax.refinement import Refinement
from eoi_jax.regression.long_run import correlation_time
from eoi_jax.simulate import free_run
from eoi_jax.trajectory import Drive

_PUSH = "push"  # name of the input and of the parameter that carry a force
_PEAKS = 5  # frequencies of the residual at which a sinusoid is tried
_NOVEL = 1e-6  # share of a column's power that the parameters must leave, else it is one of them

Columns = Float[np.ndarray, "rows columns"]


@dataclass(frozen=True)
class Candidate:
    """One effect or two, each at its best shape.

    Attributes:
        placed: the effects and their channels.
        values: of their parameters, by their names in an augmented plant.
        share: of the residual's power that they explain beside the model's own parameters.
        significance: probability of as much by chance, times the number of tries; at most 1.
    """

    placed: tuple[Placed, ...]
    values: dict[str, float]
    share: float
    significance: float

    @property
    def names(self) -> tuple[str, ...]:
        """Canonical names of the effects."""
        return tuple(one.effect.name for one in self.placed)


@dataclass(frozen=True)
class _Pushed:
    """f of a plant with a force at one of its outputs."""

    base: Any
    names: tuple[str, ...]
    output: int

    def __call__(self, t: Any, x: State, u: Any, p: Any) -> Any:
        own = parameter_type(self.names)(*(getattr(p, name) for name in self.names))
        f = jnp.reshape(jnp.asarray(self.base(t, x, u[:-1], own)), (x.y.shape[1],))
        return f.at[self.output].add(getattr(p, _PUSH) * u[-1])


@dataclass(frozen=True)
class _Inner:
    """g of a plant, which does not see the force."""

    base: Any
    names: tuple[str, ...]

    def __call__(self, t: Any, x: State, u: Any, p: Any) -> Any:
        own = parameter_type(self.names)(*(getattr(p, name) for name in self.names))
        return self.base(t, x, u[:-1], own)


def _pushed(plant: Plant, output: int) -> Plant:
    limits = zip(plant.names, plant.lower, plant.upper, strict=True)
    start = plant.internal_initial
    if callable(start):
        inner, names = start, plant.names

        def start(p: Any) -> Any:
            return inner(parameter_type(names)(*(getattr(p, name) for name in names)))

    return Plant(
        _Pushed(plant.dynamics, plant.names, output),
        {**plant.parameters, _PUSH: 0.0},
        relative_degree=plant.degrees,
        inputs=(*plant.inputs, _PUSH),
        outputs=plant.outputs,
        internal=None if plant.internal is None else _Inner(plant.internal, plant.names),
        internal_initial=None if plant.internal is None else start,
        bounds={key: (float(low), float(high)) for key, low, high in limits},
        fixed=plant.fixed,
        name=plant.name,
    )


@dataclass(frozen=True)
class Along:
    """The free runs of the refined model, and what its own unknowns leave of their errors.

    Attributes:
        plant: the refined one.
        problem: its runs. unknowns: there.
        states: of each run, y (rows, 3, r, ny) and z (rows, 3, nz) at the start, the middle and
            the end of each step; times and inputs likewise.
        basis: columns of the model's own unknowns, orthonormal.
        residual: r less these.
        scored: rows of `basis` of each run.
    """

    plant: Plant
    problem: Problem
    unknowns: Unknowns
    stages: tuple[Any, ...]
    basis: Columns
    residual: Float[np.ndarray, " rows"]
    records: tuple[Record, ...]
    pushed: tuple[Problem, ...]

    @classmethod
    def of(
        cls, refinement: Refinement, records: Sequence[Record], spans: Sequence[Span], substeps: int
    ) -> "Along":
        """Of a refinement."""
        plant = refinement.plant
        problem = weighed(problem_of(plant, records, spans, substeps), refinement.rmse)
        kernel = problem.kernel
        rows, columns = list(kernel.rows), list(kernel.columns)
        starts = [np.concatenate([one.y[rows, columns], one.z]) for one in refinement.starts]
        theta = jnp.asarray(plant.theta)[np.asarray(kernel.free)]
        unknowns = Unknowns(theta, jnp.asarray(np.stack(starts)))
        shown = _flat(signals(unknowns, problem))
        basis = _orthonormal(_wide(shown[..., :-1], unknowns.starts.shape[1]))
        residual = shown[..., -1].ravel()
        residual = residual - basis @ (basis.T @ residual)
        pushed = tuple(
            replace(problem, kernel=kernel_of(_pushed(plant, j), "signals"),
                    theta=jnp.append(problem.theta, 0.0))
            for j in range(len(plant.outputs))
        )  # fmt: skip
        stages = _stages(problem, unknowns)
        return cls(plant, problem, unknowns, stages, basis, residual, tuple(records), pushed)

    def seen(self, placed: Placed) -> Seen:
        """What the grids of shapes start from."""
        _, u, y, _ = self.stages
        j = placed.output
        level, rate = y[..., 0, j].ravel(), y[..., min(1, y.shape[-2] - 1), j].ravel()
        own = u[..., placed.channel if placed.on_input else 0] if u.shape[-1] else 0.0 * level
        period = max(one.sample_period for one in self.records)
        moving = np.std(level) or 1.0
        band = float(np.std(rate) / moving) if y.shape[-2] > 1 else 1.0 / (10.0 * period)
        duration = max(float(one.time[-1] - one.time[0]) for one in self.records)
        return Seen(
            level, rate, np.ravel(own), 0.0, duration, period, band or 1.0 / duration,
            self._peaks(period),
        )  # fmt: skip

    def _peaks(self, period: float) -> Float[np.ndarray, " peaks"]:
        """Frequencies at which the residual stands out [rad/s]."""
        power = np.abs(np.fft.rfft(self.residual))[1:] ** 2
        best = np.argsort(power)[::-1][:_PEAKS]
        ny = len(self.plant.outputs)
        return 2.0 * np.pi * (best + 1) / (len(self.residual) / ny * period)

    def tries(self, placed: Placed) -> list["Try"]:
        """An effect at every shape of its grid, where it says something that is new."""
        found = []
        for shape in np.asarray(placed.effect.grid(self.seen(placed)), dtype=float):
            forces = self._forces(placed, shape)
            columns = np.stack([self._column(placed, force) for force in forces], axis=1)
            power = np.sum(columns**2, axis=0)
            columns = columns - self.basis @ (self.basis.T @ columns)
            left = np.sum(columns**2, axis=0)
            if np.all(np.isfinite(left)) and np.all(left > _NOVEL * power):
                found.append(Try(placed, shape, columns))
        return found

    def pair_shares(self, tries: Sequence["Try"]) -> Float[np.ndarray, "tries tries"]:
        """Share of the residual's power that each two of them explain; 0 below the diagonal."""
        whole = (
            np.concatenate([one.columns for one in tries], axis=1) if tries else np.zeros((0, 0))
        )
        edges = np.cumsum([0, *(one.columns.shape[1] for one in tries)])
        square, along = whole.T @ whole, whole.T @ self.residual
        shares = np.zeros((len(tries), len(tries)))
        for i, j in itertools.combinations(range(len(tries)), 2):
            if tries[i].placed == tries[j].placed:
                continue
            own = np.r_[edges[i] : edges[i + 1], edges[j] : edges[j + 1]]
            part = square[np.ix_(own, own)]
            size = np.sqrt(np.diagonal(part))
            inverse = np.linalg.pinv(part / np.outer(size, size), rcond=1e-6, hermitian=True)
            shares[i, j] = (along[own] / size) @ inverse @ (along[own] / size)
        return shares / float(self.residual @ self.residual)

    def candidate(self, several: Sequence["Try"], tries: int) -> Candidate | None:
        """Least squares of the residual on some effects; None where they are not physical then."""
        columns = np.concatenate([one.columns for one in several], axis=1)
        inverse = np.linalg.pinv(columns.T @ columns, rcond=1e-12, hermitian=True)
        gains = inverse @ (columns.T @ self.residual)
        after = self.residual - columns @ gains
        share = 1.0 - float(after @ after) / float(self.residual @ self.residual)
        count = sum(len(one.placed.effect.parameters) for one in several)
        chance = _chance(share, after, len(self.plant.outputs), count)
        values: dict[str, float] = {}
        for one in several:
            own, gains = gains[: one.columns.shape[1]], gains[one.columns.shape[1] :]
            if not one.physical(own):
                return None
            values |= one.named(own)
        placed = tuple(one.placed for one in several)
        return Candidate(placed, values, share, min(tries * chance, 1.0))

    def _forces(self, placed: Placed, shape: np.ndarray) -> list[np.ndarray]:
        """What the effect adds to y^(r) along the runs, one for each gain, (runs, rows, 3)."""
        t, u, y, _ = self.stages
        effect, j = placed.effect, placed.output
        if isinstance(effect, AbstractTerm):
            rate = y[..., min(1, y.shape[-2] - 1), j] if y.shape[-2] > 1 else 0.0 * t
            own = u[..., 0] if u.shape[-1] else 0.0 * t
            at = At(*(jnp.asarray(one) for one in (t, y[..., 0, j], rate, own)), z=None)
            units = np.eye(len(effect.gains))
            return [np.broadcast_to(effect.term(at, list(gain), list(shape)), t.shape)
                    for gain in units]  # fmt: skip
        return [self._changed(placed, shape)]

    def _changed(self, placed: Placed, shape: np.ndarray) -> np.ndarray:
        """f with the changed input less f, at the first output."""
        t, u, y, z = self.stages
        effect, i = placed.effect, placed.channel
        new = np.array(u)
        if isinstance(effect, AbstractActuator):
            mean = (u[..., 0, i] + 4.0 * u[..., 1, i] + u[..., 2, i]) / 6.0
            for run in range(len(u)):
                late = np.asarray(
                    effect.along(jnp.asarray(t[run, :, 1]), jnp.asarray(mean[run]), shape)
                )
                new[run, ..., i] += (late - mean[run])[:, None]
        else:
            assert isinstance(effect, AbstractInputEffect)
            at = At(t, y[..., 0, 0], y[..., min(1, y.shape[-2] - 1), 0], u[..., i], None)
            new[..., i] = np.asarray(effect.changed(at, shape))
        before, after = (_drift(self.plant, t, y, z, one) for one in (u, new))
        return np.asarray(after - before)[..., 0]

    def _column(self, placed: Placed, force: np.ndarray) -> Float[np.ndarray, " rows"]:
        """Weighed slope of all outputs with the gain of a force."""
        problem = self.pushed[placed.output]
        tables, nu = np.asarray(self.problem.tables), len(self.plant.inputs)
        last = np.concatenate([force, force[:, -1:]], axis=1)  # the last row is scored, not run
        inputs = tables[..., 1 : 1 + 3 * nu].reshape(*tables.shape[:2], 3, nu)
        wide = np.concatenate([inputs, last[..., None]], axis=3).reshape(*tables.shape[:2], -1)
        parts = [tables[..., :1], wide, tables[..., 1 + 3 * nu :]]
        problem = replace(problem, tables=jnp.asarray(np.concatenate(parts, axis=2)))
        unknowns = Unknowns(jnp.append(self.unknowns.theta, 0.0), self.unknowns.starts)
        return -_flat(signals(unknowns, problem))[..., -2].ravel()


@dataclass(frozen=True)
class Try:
    """An effect at one shape: what its gains do to the errors beside the model's own unknowns."""

    placed: Placed
    shape: Float[np.ndarray, " shapes"]
    columns: Columns

    def named(self, gains: np.ndarray) -> dict[str, float]:
        """Its parameters."""
        values = [*(gains if self.placed.effect.gains else ()), *self.shape]
        return dict(zip(self.placed.names, (float(value) for value in values), strict=True))

    def physical(self, gains: np.ndarray) -> bool:
        """Whether all parameters may be; a change of the input about as large as it says."""
        effect = self.placed.effect
        values = self.named(gains).values()
        pairs = zip(values, effect.parameters, strict=True)
        inside = all(one.lower <= value <= one.upper for value, one in pairs)
        return inside and (bool(effect.gains) or bool(0.5 < gains[0] < 2.0))


def _stages(problem: Problem, unknowns: Unknowns) -> tuple[Any, ...]:
    """Times, inputs and states of all runs at the start, the middle and the end of their steps."""
    plant, tables = problem.kernel.plant, np.asarray(problem.tables)
    nu, h = len(plant.inputs), np.asarray(problem.steps)
    inputs = tables[:, :-1, 1 : 1 + 3 * nu].reshape(len(tables), -1, 3, nu)
    time = tables[:, :-1, 0, None] + h[:, None, None] * np.array([0.0, 0.5, 1.0])
    theta, parts = jnp.asarray(problem.theta), []
    for i in range(len(tables)):
        start = problem.kernel.start(unknowns.starts[i], theta, problem.declared[i])
        one = Drive(tables[i, :-1, 0], np.asarray(h[i]), inputs[i], 1)
        parts.append(free_run(plant, theta, one, start, problem.kernel.friction))
    y, z = (np.stack([np.asarray(part[k]) for part in parts]) for k in range(2))
    y, z = (np.stack([x[:, :-1], 0.5 * (x[:, :-1] + x[:, 1:]), x[:, 1:]], 2) for x in (y, z))
    return time, inputs, y, z


@eqx.filter_jit
def _rates(plant: Plant, t: Any, y: Any, z: Any, u: Any) -> Any:
    def one(t: Any, y: Any, z: Any, u: Any) -> Any:
        return plant.derivative(t, State(y, z), u, jnp.asarray(plant.theta))

    return jax.vmap(jax.vmap(jax.vmap(one)))(t, y, z, u)


def _drift(plant: Plant, t: Any, y: Any, z: Any, u: Any) -> np.ndarray:
    return np.asarray(_rates(plant, *map(jnp.asarray, (t, y, z, u))))


def _flat(shown: np.ndarray) -> Float[np.ndarray, "runs rows size"]:
    return shown.reshape(len(shown), -1, shown.shape[-1])


def _wide(columns: np.ndarray, own: int) -> Columns:
    """Columns of all unknowns over all rows: each start in the rows of its run alone."""
    runs, rows = columns.shape[:2]
    wide = np.zeros((runs * rows, runs * own + columns.shape[2] - own))
    for i, one in enumerate(columns):
        part = slice(i * rows, (i + 1) * rows)
        wide[part, i * own : (i + 1) * own] = one[:, :own]
        wide[part, runs * own :] = one[:, own:]
    return wide


def _orthonormal(columns: Columns) -> Float[np.ndarray, "rows rank"]:
    size = np.linalg.norm(columns, axis=0)
    left, values, _ = np.linalg.svd(columns / np.where(size > 0, size, 1.0), full_matrices=False)
    return left[:, values > 1e-8 * values[0]]


def _chance(share: float, after: np.ndarray, ny: int, parameters: int) -> float:
    """Probability of as large a share by chance: likelihood ratio of the independent samples."""
    from scipy.special import chdtrc

    independent = len(after) / ny / correlation_time(after.reshape(-1, ny))
    return float(chdtrc(parameters, -independent * np.log(max(1.0 - share, 1e-300))))
