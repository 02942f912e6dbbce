"""Two species that follow each other, with what sensors and loggers leave out."""

import warnings

import numpy as np
from scipy.integrate import solve_ivp

import eoi_jax as eoi

H, SIGMA = 0.05, 1e-3
TRUE = {"k1": 0.8, "k2": 0.3}
CHAIN = eoi.plant_from_text({"a": "feed - k1*a", "b": "k1*a - k2*b"}, TRUE, ["a", "b"], ["feed"])
START = CHAIN.with_parameters({"k1": 0.5, "k2": 0.5})


def signals(samples=1201, seed=0):
    """Time, a feed that steps every second, and both outputs with white noise."""
    time, rng = H * np.arange(samples), np.random.default_rng(seed)
    steps = rng.uniform(0.0, 2.0, samples)
    feed = steps[(np.arange(samples) * H + 1e-9).astype(int)]
    y = np.zeros((samples, 2))
    y[0] = 1.0, 0.5
    for k in range(samples - 1):  # exact to the solver's tolerance within every held step
        rate = lambda t, x, u=feed[k]: [u - 0.8 * x[0], 0.8 * x[0] - 0.3 * x[1]]  # noqa: E731
        y[k + 1] = solve_ivp(rate, (0.0, H), y[k], rtol=1e-9, atol=1e-12).y[:, -1]
    return time, feed, y + SIGMA * rng.standard_normal(y.shape)


def record_of(time, feed, y, name="run", hold="zero"):
    """A record of them, without the warnings on what is missing."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", eoi.RecordWarning)
        return eoi.Record(
            time, feed, y, name, hold=hold, input_names=["feed"], output_names=["a", "b"]
        )


def without(values, missing, channel=None):
    """The values with NaN where `missing` says, in one channel or in all."""
    holed = np.array(values)
    holed[missing if channel is None else (missing, channel)] = np.nan
    return holed
