"""Plants whose outputs are functions of the states, and their records by SciPy.

Battery: terminal voltage v = 3.4 V + 0.7 V soc - R0 i - v1 with C1 v1' = i - v1/R1, soc' = -i/Q.
The current is held over each second, so that soc and v1 of the next sample are exact. Accelerometer
on a mass whose base is moved: m x'' = -b x' - k (x - base), of which only x'' is measured.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

from eoi_jax.data.record import Record
from eoi_jax.models.plant import Plant

BATTERY = {"R0": 0.03, "R1": 0.02, "C1": 1500.0, "Q": 7200.0}
ACCELEROMETER = {"m": 3.0, "b": 4.0, "k": 100.0}


def _voltage(t, x, u, p):
    return 3.4 + 0.7 * x.z[0] - p.R0 * u[0] - x.z[1]


def _cell(t, x, u, p):
    return jnp.stack([-u[0] / p.Q, (u[0] - x.z[1] / p.R1) / p.C1])


def battery(**values: float) -> Any:
    """The cell, at its true parameters unless others are given."""
    return Plant(
        _voltage,
        {**BATTERY, **values},
        relative_degree=0,
        inputs=("current",),
        outputs=("voltage",),
        internal=_cell,
        internal_initial=(0.8, 0.0),
        units={"current": "A", "voltage": "V"},
        name="battery",
    )


def current(seed: int, samples: int = 1800) -> np.ndarray:
    """Pulses of a minute [A]."""
    draw = np.random.default_rng(seed)
    return np.repeat(draw.choice([0, 0, 1, 2, 3, -1], samples // 60), 60).astype(float)


def cell_states(amperes: np.ndarray) -> np.ndarray:
    """soc and v1 at every sample."""
    decay, states = np.exp(-1.0 / (BATTERY["R1"] * BATTERY["C1"])), [(0.8, 0.0)]
    for i in amperes[:-1]:
        soc, v1 = states[-1]
        states.append((soc - i / BATTERY["Q"], decay * v1 + BATTERY["R1"] * (1.0 - decay) * i))
    return np.asarray(states)


def battery_record(seed: int = 1, noise: float = 1e-3, samples: int = 1800) -> Record:
    amperes = current(seed, samples)
    soc, v1 = cell_states(amperes).T
    voltage = 3.4 + 0.7 * soc - BATTERY["R0"] * amperes - v1
    voltage = voltage + noise * np.random.default_rng(seed + 100).standard_normal(samples)
    time = np.arange(float(samples))
    return Record(
        time,
        amperes,
        voltage,
        f"cell {seed}",
        hold="zero",
        input_names=("current",),
        output_names=("voltage",),
        units={"current": "A", "voltage": "V"},
    )


def _force(x, u, p):
    return -p.b * x[1] - p.k * (x[0] - u[0])


def _acceleration(t, x, u, p):
    return _force(x.z, u, p) / p.m


def _mass(t, x, u, p):
    return jnp.stack([x.z[1], _force(x.z, u, p) / p.m])


def accelerometer(**values: float) -> Any:
    """The mass, of which the acceleration alone is measured."""
    return Plant(
        _acceleration,
        {**ACCELEROMETER, **values},
        relative_degree=0,
        inputs=("base",),
        outputs=("acc",),
        internal=_mass,
        internal_initial=(0.0, 0.0),
        fixed=("m",),
        name="accelerometer",
    )


def _mixed(t, x, u, p):
    acceleration = _force(x.y[:, 0], u, p) / p.m
    return jnp.stack([acceleration, p.gain * acceleration])


def mixed(**values: float) -> Any:
    """The mass, of which the position (degree 2) and the acceleration (degree 0) are measured."""
    return Plant(
        _mixed,
        {**ACCELEROMETER, "gain": 1.0, **values},
        relative_degree=(2, 0),
        inputs=("base",),
        outputs=("x", "acc"),
        fixed=("m",),
        name="mixed",
    )


def shaken(
    seed: int = 1, noise: float = 0.05, outputs: tuple[str, ...] = ("acc",), period: float = 0.01
) -> Record:
    """Twenty seconds of the mass."""
    draw = np.random.default_rng(seed)
    m, b, k = ACCELEROMETER.values()
    time = np.arange(0.0, 20.0, period)
    frequency, phase = draw.uniform(1.0, 15.0, 8), draw.uniform(0.0, 6.0, 8)

    def base(t: Any) -> Any:
        return 0.02 * np.sum(np.sin(np.multiply.outer(t, frequency) + phase), axis=-1)

    def rates(t: Any, x: Any) -> Any:
        return [x[1], (-b * x[1] - k * (x[0] - base(t))) / m]

    solution = solve_ivp(rates, (0.0, 20.0), [0.0, 0.0], t_eval=time, rtol=1e-10, atol=1e-12)
    signals = {"x": solution.y[0], "acc": np.asarray(rates(time, solution.y)[1])}
    signals["acc"] = signals["acc"] + noise * draw.standard_normal(len(time))
    columns = np.stack([signals[name] for name in outputs], axis=1)
    return Record(
        time, base(time), columns, f"shaker {seed}", hold="linear", input_names=("base",),
        output_names=outputs,
    )  # fmt: skip
