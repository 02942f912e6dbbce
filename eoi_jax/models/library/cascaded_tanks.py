r"""Two tanks, one above the other; only the level of the lower one is measured.

$\dot z = -k_1 \sqrt z + k_4 u$ (upper level, an internal state),
$\dot y = k_2 \sqrt z - k_3 \sqrt y$ (lower level).

Source of the model and the measured data set: M. Schoukens, P. Mattsson, T. Wigren, J.-P. Noël,
*Cascaded tanks benchmark combining soft and hard nonlinearities*, Workshop on Nonlinear System
Identification Benchmarks, 2016. Overflow is not modelled.

The upper level is not measured, so its unit is arbitrary: $z \to s z$ with
$k_1 \to \sqrt s\,k_1$, $k_2 \to k_2/\sqrt s$, $k_4 \to s\,k_4$ does not change y. $k_2$ is
therefore fixed, which defines that unit; only $k_1 k_2$, $k_3$, $k_2^2 k_4$ and $k_2^2 z(0)$ are
identifiable.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from eoi_jax.models.library.level_tank import square_root
from eoi_jax.models.plant import Plant, State


def cascaded_tanks_dynamics(t: Any, x: State, u: Any, p: Any) -> Any:
    """Rate of the lower level [V/s]; levels are in volts of the sensor."""
    del t, u
    return p.k2 * square_root(x.z[0]) - p.k3 * square_root(x.y[0, 0])


def cascaded_tanks_internal(t: Any, x: State, u: Any, p: Any) -> Any:
    """Rate of the upper level [V/s]."""
    del t
    return -p.k1 * square_root(x.z) + p.k4 * u


def cascaded_tanks_start(p: Any) -> Any:
    """The upper level at the start of the record, a parameter."""
    return jnp.reshape(p.upper_initial, (1,))


def cascaded_tanks(*, reference: bool = False) -> Plant:
    """The two tanks of the benchmark, without overflow.

    Args:
        reference: values near the optimum (output error on the estimation record, 0.60 V rms)
            instead of a rough guess.

    Returns:
        Plant of relative degree 1 with one internal state; input ``pump`` [V], output
        ``lower_level`` [V].
    """
    guess = {"k1": 0.05, "k2": 0.05, "k3": 0.05, "k4": 0.05, "upper_initial": 5.0}
    fitted = {"k1": 0.0582, "k2": 0.05, "k3": 0.0897, "k4": 0.0869, "upper_initial": 16.3}
    return Plant(
        cascaded_tanks_dynamics,
        parameters=fitted if reference else guess,
        relative_degree=1,
        inputs=("pump",),
        outputs=("lower_level",),
        internal=cascaded_tanks_internal,
        internal_initial=cascaded_tanks_start,
        fixed=("k2",),  # defines the unit of the upper level
        bounds={"upper_initial": (0.0, np.inf)},  # a level
        units={
            "k1": "√V/s",
            "k2": "√V/s",
            "k3": "√V/s",
            "k4": "1/s",
            "upper_initial": "V",
            "pump": "V",
            "lower_level": "V",
        },
        name="cascaded tanks",
    )
