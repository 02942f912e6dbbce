r"""Closed-form cases with their derivations, and the observers as plain NumPy loops.

Nothing here uses the library, so that agreement with it means something.

**Prescribed motion.** Choose y(t) as a sum of sines, whose derivatives are known exactly, and solve
the plant's own equation for the input: u = (y^(r) - f|_{u=0})/b. The pair (u, y) is then an exact
solution for any plant that is affine in one input, nonlinear or not, without a simulator.

**Held input.** A linear plant ẋ = A x + B u with u constant over each step has
x[k+1] = e^{Ah} x[k] + ∫₀ʰ e^{As} ds B u[k]; both matrices are blocks of exp([[A, B], [0, 0]] h).
"""

from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm

GRAVITY = 9.81


class Motion(NamedTuple):
    """y(t) = offset + Σ aᵢ sin(ωᵢ t + φᵢ); the k-th derivative shifts each phase by kπ/2."""

    amplitudes: tuple[float, ...]
    frequencies: tuple[float, ...]
    phases: tuple[float, ...]
    offset: float = 0.0

    def __call__(self, t, derivative: int = 0):
        value = np.full(np.shape(t), self.offset if derivative == 0 else 0.0)
        for a, w, phase in zip(self.amplitudes, self.frequencies, self.phases, strict=True):
            value = value + a * w**derivative * np.sin(w * t + phase + derivative * np.pi / 2)
        return value


#: Enough frequencies that position, velocity and acceleration are not confounded.
SWAY = Motion((0.05, 0.02, 0.01), (3.0, 7.0, 12.0), (0.3, 1.1, 2.0))
#: A level that never runs dry.
LEVEL = Motion((0.08, 0.05, 0.02), (0.9, 2.3, 4.1), (0.2, 1.0, 2.5), 0.4)
#: A pendulum that swings through large angles and reverses a few times a second.
SWING = Motion((0.6, 0.4, 0.1), (2.0, 5.0, 9.0), (0.4, 1.3, 2.2))


def grid(samples: int, h: float):
    """Sample instants [s]."""
    return h * np.arange(samples)


def moved_mass_spring(t, p, motion: Motion = SWAY):
    """(u, y) of ÿ = -α y - β ẏ + ρ u: u = (ÿ + β ẏ + α y)/ρ."""
    y, rate, acceleration = motion(t), motion(t, 1), motion(t, 2)
    return (acceleration + p["beta"] * rate + p["alpha"] * y) / p["rho"], y


def moved_level(t, p, motion: Motion = LEVEL):
    """(u, y) of ẏ = -α √(2 g y) + β u: u = (ẏ + α √(2 g y))/β."""
    y = motion(t)
    return (motion(t, 1) + p["alpha"] * np.sqrt(2.0 * GRAVITY * y)) / p["beta"], y


def moved_pendulum(t, p, motion: Motion = SWING):
    """(u, y) of ÿ = -a sin y - b ẏ - c sign ẏ + d u; u jumps where the motion reverses."""
    y, rate = motion(t), motion(t, 1)
    forces = p["a"] * np.sin(y) + p["b"] * rate + p["c"] * np.sign(rate)
    return (motion(t, 2) + forces) / p["d"], y


def moved_chain(t, p, motion: Motion = SWAY):
    """(u, y) of y''' = -a ÿ - b ẏ - c y + d u, relative degree three."""
    lower = p["a"] * motion(t, 2) + p["b"] * motion(t, 1) + p["c"] * motion(t)
    return (motion(t, 3) + lower) / p["d"], motion(t)


def moved_load(t, p, motion: Motion = SWAY):
    """(u, y) of m ÿ = u - b ẏ - k y: the mass enters the acceleration nonlinearly."""
    return p["m"] * motion(t, 2) + p["b"] * motion(t, 1) + p["k"] * motion(t), motion(t)


def held_response(A, B, u, h: float, start=None):
    """States (N, n) of ẋ = A x + B u at the samples, u (N, m) held over each step: exact."""
    n, m = np.shape(B)
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = A, B
    block = expm(block * h)
    states = np.zeros((len(u), n))
    states[0] = 0.0 if start is None else start
    for k in range(len(u) - 1):
        states[k + 1] = block[:n, :n] @ states[k] + block[:n, n:] @ u[k]
    return states


def stiff_response(rate, u, h: float, states: int = 4, tolerance: float = 1e-9):
    """States of ẋ = rate(x, u) from rest at each sample, u held over each step (LSODA)."""
    x = [np.zeros(states)]
    for held in u[:-1]:
        run = solve_ivp(
            lambda _, x, held=held: rate(x, held), (0.0, h), x[-1], "LSODA",
            rtol=tolerance, atol=1e-3 * tolerance,
        )  # fmt: skip
        x.append(run.y[:, -1])
    return np.asarray(x)


def noisy(y, level: float, draw: np.random.Generator):
    """Outputs with white noise of that share of the standard deviation of each."""
    return y + level * np.std(y, axis=0) * draw.standard_normal(y.shape)


def pushed_double_integrator(u, h: float, gain: float, offset: float):
    """Positions of ÿ = gain u + offset from rest, u (N,) held: y, v are exact polynomials a step.

    y[k+1] = y[k] + h v[k] + ½h² a[k], so that ∇²y[k+1]/h² = ½ (a[k] + a[k-1]): no method that
    averages the model over two steps has a discretisation error on this plant.
    """
    a = gain * np.asarray(u) + offset
    v = np.concatenate([[0.0], np.cumsum(h * a[:-1])])
    return np.concatenate([[0.0], np.cumsum(h * v[:-1] + 0.5 * h**2 * a[:-1])])


def lag_step_response(t, rate: float):
    """Step response of ẏ = rate (u - y): 1 - e^{-rate t}."""
    return 1.0 - np.exp(-rate * np.asarray(t))


def three_mass_matrices(p):
    """Eq. (18) as ẋ = A x + B u, x = (y1, y2, y3, ẏ1, ẏ2, ẏ3)."""
    A = np.zeros((6, 6))
    A[:3, 3:] = np.eye(3)
    A[3, [0, 1, 3]] = -p["a2"], p["a3"], -p["a4"]
    A[4, [0, 1, 2, 4]] = p["b1"], -p["b2"], p["b3"], -p["b4"]
    A[5, [1, 2, 5]] = p["c1"], -p["c2"], -p["c3"]
    return A, np.array([[0.0], [0.0], [0.0], [p["a1"]], [0.0], [0.0]])


def coupled_mass_matrices(p):
    """ÿ1 = -k (y1 - y2) - d ẏ1 + u, ÿ2 = k (y1 - y2) - d ẏ2: one spring, one damping, twice."""
    A = np.zeros((4, 4))
    A[:2, 2:] = np.eye(2)
    A[2] = -p["k"], p["k"], -p["d"], 0.0
    A[3] = p["k"], -p["k"], 0.0, -p["d"]
    return A, np.array([[0.0], [0.0], [1.0], [0.0]])


def motor_matrices(p):
    """i' = -R i - K ω + u (relative degree one), φ'' = T i - d ω (two); x = (i, φ, ω)."""
    A = np.array([[-p["R"], 0.0, -p["K"]], [0.0, 0.0, 1.0], [p["T"], 0.0, -p["d"]]])
    return A, np.array([[1.0], [0.0], [0.0]])


# -- observers, line by line from their published discretisations -----------------------------


class Loop(NamedTuple):
    """What a loop shows, one row a step: injection, position error after it, in sliding."""

    injection: np.ndarray
    error: np.ndarray
    sliding: np.ndarray


def second_order_loop(y, f, h, gains, x1, x2):
    """Implicit form of eq. (9), the relay at the end of the step."""
    c1, c2, c3 = gains
    rows = []
    for k in range(len(y) - 1):
        e = y[k] - x1
        A = f[k] + c2 * e
        x1_minus = x1 + h * x2 + 0.5 * h**2 * A + h * c1 * e
        x2_minus = x2 + h * A
        w = min(max((y[k + 1] - x1_minus) / h**2, -c3), c3)
        x1, x2 = x1_minus + h**2 * w, x2_minus + h * w
        rows.append((w, y[k + 1] - x1, abs(w) < c3))
    return _loop(rows)


def first_order_loop(y, f, h, gains, x, p):
    """Implicit form of eq. (5)."""
    delta, T = gains
    omega1, omega2 = 1.5 * np.sqrt(delta), 1.1 * delta
    rows = []
    for k in range(len(y) - 1):
        kappa = h**2 * omega2 / (1 + h * T)
        b = y[k + 1] - x - h * (f[k] + omega2 * p / (1 + h * T))
        if abs(b) <= kappa:
            s, r = b / kappa, 0.0
        else:
            s = np.sign(b)
            r = (-h * omega1 + np.sqrt(h**2 * omega1**2 + 4 * (abs(b) - kappa))) / 2
        p = (p + h * s) / (1 + h * T)
        x = y[k + 1] - r**2 * s
        rows.append((omega1 * r * s + omega2 * p, r**2 * s, abs(b) <= kappa))
    return _loop(rows)


def super_twisting_loop(y, f, h, gains, x1, x2):
    """Implicit form of Davila's observer."""
    lambda1, alpha = gains
    rows = []
    for k in range(len(y) - 1):
        s = y[k + 1] - x1 - h * (x2 + h * f[k])
        T = h**2 * alpha
        if abs(s) <= T:
            xi, e = s / T, 0.0
        else:
            xi = np.sign(s)
            r = (-h * lambda1 + np.sqrt(h**2 * lambda1**2 + 4 * (abs(s) - T))) / 2
            e = xi * r**2
        x2 = x2 + h * (f[k] + alpha * xi)
        x1 = y[k + 1] - e
        rows.append((alpha * xi, e, abs(s) <= T))
    return _loop(rows)


def second_order_euler(y, f, h, gains, x1, x2):
    """Eq. (9) by explicit Euler; `error` is that before the step, in `sliding` nothing."""
    c1, c2, c3 = gains
    rows = []
    for k in range(len(y) - 1):
        e = y[k] - x1
        rows.append((c3 * np.sign(e), e, False))
        x1, x2 = x1 + h * (x2 + c1 * e), x2 + h * (f[k] + c2 * e + c3 * np.sign(e))
    return _loop(rows)


def first_order_euler(y, f, h, gains, x, p):
    """Eq. (5) by explicit Euler."""
    delta, T = gains
    rows = []
    for k in range(len(y) - 1):
        e = y[k] - x
        v = 1.5 * np.sqrt(delta) * np.sqrt(abs(e)) * np.sign(e) + 1.1 * delta * p
        rows.append((v, e, False))
        x, p = x + h * (f[k] + v), p + h * (-T * p + np.sign(e))
    return _loop(rows)


def super_twisting_euler(y, f, h, gains, x1, x2):
    """Davila's observer by explicit Euler."""
    lambda1, alpha = gains
    rows = []
    for k in range(len(y) - 1):
        e = y[k] - x1
        rows.append((alpha * np.sign(e), e, False))
        x1 = x1 + h * (x2 + lambda1 * np.sqrt(abs(e)) * np.sign(e))
        x2 = x2 + h * (f[k] + alpha * np.sign(e))
    return _loop(rows)


def _loop(rows):
    injection, error, sliding = zip(*rows, strict=True)
    return Loop(np.array(injection), np.array(error), np.array(sliding))
