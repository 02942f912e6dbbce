"""A pendulum with viscous friction that a controller keeps upright, by SciPy."""

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

import eoi_jax as eoi

PLANT = eoi.Plant(
    lambda t, x, u, p: p.a * jnp.sin(x.y[0]) + p.b * u, {"a": 9.0, "b": 1.0}, 2,
    inputs=("torque",), outputs=("angle",),
)  # fmt: skip


def upright(seed, count=1200, period=0.01, friction=0.6):
    """A record; the recorded torque drives the model."""
    random = np.random.default_rng(seed)
    command = np.repeat(random.uniform(-0.5, 0.5, count // 60), 60)
    x, angles, torques = np.zeros(2), [], []
    for target in command:
        torque = -40.0 * (x[0] - target) - 12.0 * x[1]
        angles.append(x[0])
        torques.append(torque)
        run = solve_ivp(
            lambda t, x, u: [x[1], 9.0 * np.sin(x[0]) - friction * x[1] + u], (0.0, period), x,
            args=(torque,), rtol=1e-7,
        )  # fmt: skip
        x = run.y[:, -1]
    noise = 5e-4 * random.standard_normal(count)
    return eoi.Record.from_period(
        period, np.array(torques), np.array(angles) + noise, hold="zero",
        input_names=("torque",), output_names=("angle",),
    )  # fmt: skip
