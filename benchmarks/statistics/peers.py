"""Outside peers for `eoi_jax.compare`: the same plants in other tools, from nominal values.

Each is a comparator; one that is not installed is a row that says so. The equations are written
once more here, in plain arithmetic that Numba, CasADi and NumPy all take.

- `scipy`: `least_squares` (trust region, finite differences) over a Runge-Kutta loop compiled by
  Numba; initial states fitted too; dry friction sticks.
- `casadi`: single shooting over Runge-Kutta steps, exact derivatives, Gauss-Newton in IPOPT, as
  CasADi's own example of system identification; dry friction as tanh(v / 0.01).
- `jax_sysid`: its continuous-time model (diffrax, Heun's rule) with L-BFGS, gradients by reverse
  mode, no regularisation; parameters scaled to one.
- `pysindy`: its smoothed differentiation and its optimiser on the declared terms alone (nothing to
  select), all sides smoothed alike, the window as wide as the record's band allows.
"""

# ruff: noqa: ARG001 (equations of one kind share one signature)

import contextlib
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

import eoi_jax as eoi
from eoi_jax import comparators
from eoi_jax._status import Status
from eoi_jax.comparison.methods import Estimate
from eoi_jax.estimation.defaults import default_lowpass

GRAVITY = 9.81
SUBSTEPS = 4  # steps a sample, as `eoi.refine` takes (CasADi and jax-sysid: on coarse records)
SOFT = 1e-2  # velocity over which CasADi's friction turns round [rad/s]


def equations(name: str, sin: Callable, root: Callable) -> Callable:
    """f(y, v, u, p, s) → y^(r) of each output, as a tuple; s is the direction of motion."""

    def level_tank(y, v, u, p, s):
        return (-p[0] * root(2.0 * GRAVITY * y[0]) + p[1] * u,)

    def one_mass(y, v, u, p, s):
        return (-p[0] * y[0] - p[1] * v[0] + p[2] * u,)

    def three_masses(y, v, u, p, s):
        return (
            p[0] * u - p[1] * y[0] + p[2] * y[1] - p[3] * v[0],
            p[4] * y[0] - p[5] * y[1] + p[6] * y[2] - p[7] * v[1],
            p[8] * y[1] - p[9] * y[2] - p[10] * v[2],
        )

    def pendulum(y, v, u, p, s):
        return (-p[0] * sin(y[0]) - p[1] * v[0] - p[2] * s + p[3] * u,)

    def duffing(y, v, u, p, s):
        return (p[0] * u - p[1] * v[0] - p[2] * y[0] - p[3] * y[0] * y[0] * y[0] + p[4],)

    return {
        "level tank": level_tank,
        "mass, spring and damper": one_mass,
        "three masses": three_masses,
        "pendulum": pendulum,
        "Duffing oscillator": duffing,
    }[name]


def scales(plant: eoi.Plant) -> np.ndarray:
    """Size of each parameter: its nominal value, or the largest of them where that is zero."""
    nominal = np.abs(np.asarray(plant.theta))
    return np.where(nominal > 0, nominal, np.max(nominal))


def start(plant: eoi.Plant, record: eoi.Record) -> np.ndarray:
    """Outputs at the first samples, at rest."""
    rates = np.zeros((plant.relative_degree - 1) * len(plant.outputs))
    return np.concatenate([np.mean(record.outputs[:5], axis=0), rates])


def coarse(plant: eoi.Plant, record: eoi.Record) -> bool:
    """Whether a record has few samples to a period of its motion, so that runs need sub-steps."""
    return default_lowpass(plant, [record])[0].cutoff * record.sample_period > 0.2


def answered(plant: eoi.Plant, theta: np.ndarray, code: str, text: str) -> Estimate:
    values = dict(zip(plant.names, map(float, theta), strict=True))
    return Estimate(values, None, Status(code, text))


# -- scipy over Numba ---------------------------------------------------------------------------


@cache
def simulator(name: str, ny: int, degree: int, friction: int) -> Callable:
    """Runge-Kutta over samples of a held input; `friction` is the index of its level, or -1."""
    import math

    from numba import njit

    f = njit(equations(name, math.sin, njit(lambda x: math.sqrt(max(x, 0.0)))))

    @njit
    def rate(x, u, p, s, out):
        highest = f(x[:ny], x[-ny:], u, p, s)
        for j in range(ny):
            if degree == 2:
                out[j] = x[ny + j]
            out[(degree - 1) * ny + j] = highest[j]

    @njit
    def run(x0, u, p, h):
        n, x = len(x0), x0.copy()
        k, out = np.zeros((4, n)), np.zeros((len(u), ny))
        for step in range(SUBSTEPS * len(u)):
            now = u[step // SUBSTEPS]
            if step % SUBSTEPS == 0:
                out[step // SUBSTEPS] = x[:ny]
            s = 0.0
            if friction >= 0:
                s = np.sign(x[1])
                if s == 0.0:
                    push = f(x[:ny], x[-ny:], now, p, 0.0)[0]
                    if abs(push) <= p[friction]:
                        continue
                    s = np.sign(push)
            rate(x, now, p, s, k[0])
            rate(x + 0.5 * h * k[0], now, p, s, k[1])
            rate(x + 0.5 * h * k[1], now, p, s, k[2])
            rate(x + h * k[2], now, p, s, k[3])
            x = x + h / 6.0 * (k[0] + 2.0 * k[1] + 2.0 * k[2] + k[3])
            if friction >= 0 and s * x[1] < 0.0:
                x[1] = 0.0
        return out

    return run


class Scipy(comparators.AbstractComparator):
    """`scipy.optimize.least_squares` over a Numba simulator, from the nominal values."""

    name = "scipy"
    description = "scipy least_squares over a Numba simulator, from the nominal values"

    def estimate(self, plant: eoi.Plant, records: Sequence[eoi.Record]) -> Estimate:
        from scipy.optimize import least_squares

        (record,) = records
        friction = plant.names.index("c") if any(plant.dry_friction) else -1
        run = simulator(plant.name, len(plant.outputs), plant.relative_degree, friction)
        scale, x0, h = scales(plant), start(plant, record), record.sample_period / SUBSTEPS
        spread, u = np.std(record.outputs, axis=0), record.inputs[:, 0].copy()
        count = len(scale)

        def errors(values: np.ndarray) -> np.ndarray:
            y = run(values[count:], u, values[:count] * scale, h)
            y = np.nan_to_num(y, nan=1e6, posinf=1e6, neginf=-1e6)
            return ((np.clip(y, -1e6, 1e6) - record.outputs) / spread).ravel()

        first = np.concatenate([np.asarray(plant.theta) / scale, x0])
        found = least_squares(errors, first, x_scale="jac", max_nfev=100)
        code = "converged" if found.status > 0 else "passes_exhausted"
        return answered(plant, found.x[:count] * scale, code, found.message)


# -- CasADi -------------------------------------------------------------------------------------


class Casadi(comparators.AbstractComparator):
    """Single shooting and Gauss-Newton in IPOPT."""

    name = "casadi"
    description = "CasADi: single shooting, exact derivatives, Gauss-Newton in IPOPT"

    def estimate(self, plant: eoi.Plant, records: Sequence[eoi.Record]) -> Estimate:
        import casadi as ca  # pyright: ignore[reportMissingImports]

        (record,) = records
        count, ny, scale = len(plant.names), len(plant.outputs), scales(plant)
        parts = SUBSTEPS if coarse(plant, record) else 1
        step = self._step(ca, plant, record.sample_period / parts, parts)
        first = np.concatenate([np.asarray(plant.theta) / scale, start(plant, record)])
        unknowns = ca.MX.sym("w", len(first))
        steps = len(record) - 1
        x = step.mapaccum(steps)(
            unknowns[count:],
            ca.DM(record.inputs[:-1, 0]).T,
            ca.repmat(unknowns[:count] * scale, 1, steps),
        )
        whole = ca.horzcat(unknowns[count : count + ny], x[:ny, :])
        error = ca.vec((whole - ca.DM(record.outputs.T)) / np.std(record.outputs, axis=0))
        # Gauss-Newton: IPOPT gets JᵀJ in place of the Hessian.
        jacobian = ca.jacobian(error, unknowns)
        weight = ca.MX.sym("weight")
        multiplier = ca.MX.sym("multiplier", 0)
        hessian = weight * ca.triu(jacobian.T @ jacobian)
        nlp = {"x": unknowns, "f": 0.5 * ca.dot(error, error)}
        hessian_function = ca.Function(
            "nlp_hess_l", {"x": unknowns, "lam_f": weight, "lam_g": multiplier,
                           "hess_gamma_x_x": hessian},
            ["x", "p", "lam_f", "lam_g"], ["hess_gamma_x_x"],
        )  # fmt: skip
        options = {"ipopt": {"print_level": 0, "max_iter": 50}, "print_time": False}
        solver = ca.nlpsol("solver", "ipopt", nlp, {**options, "hess_lag": hessian_function})
        found = solver(x0=first)
        theta = np.asarray(found["x"]).ravel()[:count] * scale
        status = solver.stats()
        code = "converged" if status["success"] else "stalled"
        return answered(plant, theta, code, str(status["return_status"]))

    def _step(self, ca: Any, plant: eoi.Plant, h: float, parts: int) -> Any:
        """The Runge-Kutta steps of a sample as a function (x, u, p) → x."""
        f = equations(plant.name, ca.sin, lambda x: ca.sqrt(ca.fmax(x, 1e-12)))
        ny, degree = len(plant.outputs), plant.relative_degree
        x, u, p = ca.SX.sym("x", ny * degree), ca.SX.sym("u"), ca.SX.sym("p", len(plant.names))

        def rate(x: Any) -> Any:
            highest = f(x[:ny], x[-ny:], u, p, ca.tanh(x[-1] / SOFT))
            return ca.vertcat(*([x[ny:]] if degree == 2 else []), *highest)

        end = x
        for _ in range(parts):
            k1 = rate(end)
            k2 = rate(end + 0.5 * h * k1)
            k3 = rate(end + 0.5 * h * k2)
            k4 = rate(end + h * k3)
            end = end + h / 6.0 * (k1 + 2 * k2 + 2 * k3 + k4)
        return ca.Function("step", [x, u, p], [end])


# -- jax-sysid ----------------------------------------------------------------------------------


class JaxSysid(comparators.AbstractComparator):
    """The continuous-time model of jax-sysid, fitted by L-BFGS."""

    name = "jax_sysid"
    description = "jax-sysid: continuous-time model over diffrax, L-BFGS"

    def __init__(self, evaluations: int):
        self.evaluations = evaluations

    def estimate(self, plant: eoi.Plant, records: Sequence[eoi.Record]) -> Estimate:
        import jax.numpy as jnp
        from jax_sysid.models import CTModel  # pyright: ignore[reportMissingImports]

        (record,) = records
        ny, degree, scale = len(plant.outputs), plant.relative_degree, jnp.asarray(scales(plant))
        spread = np.std(record.outputs, axis=0)

        def field(x: Any, u: Any, t: Any, params: Any) -> Any:
            state = eoi.State(jnp.reshape(x, (degree, ny)), jnp.zeros(0))
            highest = plant.derivative(t, state, u, params[0] * scale)
            return jnp.concatenate([x[ny:], highest])

        def output(x: Any, u: Any, t: Any, params: Any) -> Any:
            return x[:ny] / spread

        model = CTModel(degree * ny, ny, 1, field, output, x0=start(plant, record))
        model.init(params=[jnp.asarray(plant.theta) / scale])
        h = record.sample_period
        parts = SUBSTEPS if coarse(plant, record) else 1
        model.integration_options(dt0=h / parts, max_steps=2 * parts * len(record))
        model.loss(rho_x0=0.0, rho_th=0.0, xsat=1e12)
        model.optimization(adam_epochs=0, lbfgs_epochs=self.evaluations, iprint=-1)
        with contextlib.redirect_stdout(None):  # it reports its iterations whatever `iprint` says
            model.fit(record.outputs / spread, record.inputs, record.time)
        text = f"at most {self.evaluations} evaluations"
        return answered(plant, np.asarray(model.params[0] * scale), "passes_exhausted", text)


# -- PySINDy ------------------------------------------------------------------------------------


class PySindy(comparators.AbstractComparator):
    """PySINDy's differentiation and optimiser on the declared terms."""

    name = "pysindy"
    description = "PySINDy: smoothed differentiation, regression on the declared terms"

    def estimate(self, plant: eoi.Plant, records: Sequence[eoi.Record]) -> Estimate:
        import pysindy as ps  # pyright: ignore[reportMissingImports]
        from scipy.signal import savgol_filter

        (record,) = records
        time, degree = record.time, plant.relative_degree
        # A Savitzky-Golay filter of order three and w samples is flat to about 4/(3.2 w) Nyquist.
        share = 5.0 * default_lowpass(plant, records)[0].cutoff * record.sample_period / np.pi
        window = max(2 * int(4.0 / (3.2 * min(share, 0.5)) / 2.0) + 1, 5)
        fine = window > 5  # five samples leave a parabola of order three nothing to average
        derivative = (
            ps.SmoothedFiniteDifference(
                order=4, smoother_kws={"window_length": window, "polyorder": 3}
            )
            if fine
            else ps.FiniteDifference(order=4)
        )

        def smooth(values: Any, times: int) -> np.ndarray:
            for _ in range(times if fine else 0):
                values = savgol_filter(values, window, 3, axis=0)
            return np.asarray(values)

        # All sides smoothed alike; a held input is centred on its sample.
        u = record.inputs[:, 0]
        u = smooth(0.5 * (u + np.concatenate([u[:1], u[:-1]])), degree)
        rates = [record.outputs]
        for _ in range(degree):
            rates.append(np.array(derivative(rates[-1], t=time)))  # type: ignore[arg-type]
        y, v = smooth(record.outputs, degree), smooth(rates[1], degree - 1)
        f = equations(plant.name, np.sin, lambda x: np.sqrt(np.maximum(x, 0.0)))
        inside = slice(2 * window, -2 * window)

        def highest(p: np.ndarray) -> np.ndarray:
            parts = f(y.T, v.T, u, p, np.sign(v[:, 0]))
            return np.stack([part * np.ones(len(time)) for part in parts], axis=1)[inside]

        none = highest(np.zeros(len(plant.names)))
        columns = np.stack([highest(one) - none for one in np.eye(len(plant.names))], axis=2)
        target, weight = rates[degree][inside] - none, 1.0 / np.std(rates[degree], axis=0)
        rows = (columns * weight[:, None]).reshape(-1, len(plant.names))
        size = np.linalg.norm(rows, axis=0)
        optimiser = ps.STLSQ(threshold=0.0, alpha=0.0)
        optimiser.fit(rows / size, (target * weight).reshape(-1, 1))
        theta = np.asarray(optimiser.coef_).ravel() / size
        text = f"window of {window} samples" if fine else "no smoothing: too coarse a record"
        return answered(plant, theta, "converged", text)
