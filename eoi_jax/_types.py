"""Array types and axis names of the signatures.

Axes: ``time`` samples N, ``nu`` inputs, ``ny`` outputs, ``np`` parameters, ``nz`` internal
states, ``r`` the highest relative degree, ``rates`` = r - 1 derivatives of an output.
"""

from typing import TypeAlias

import numpy as np
from jax import Array
from jaxtyping import Bool, Float

Scalar: TypeAlias = Float[Array, ""]
Theta: TypeAlias = Float[Array, " np"]
Output: TypeAlias = Float[Array, " ny"]
Input: TypeAlias = Float[Array, " nu"]
Rates: TypeAlias = Float[Array, "rates ny"]
Regressor: TypeAlias = Float[Array, "ny np"]
Flags: TypeAlias = Bool[Array, " ny"]

# On the host: records hold NumPy arrays.
TimeAxis: TypeAlias = Float[np.ndarray, " time"]
Signals: TypeAlias = Float[np.ndarray, "time channel"]
Inputs: TypeAlias = Float[np.ndarray, "time nu"]
Outputs: TypeAlias = Float[np.ndarray, "time ny"]
OutputMask: TypeAlias = Bool[np.ndarray, "time ny"]
Mask: TypeAlias = Bool[np.ndarray, " time"]

# Of a field that came later: a file holds it only where it is set, and others read as before.
WHERE_SET = {"stored": "where set"}
