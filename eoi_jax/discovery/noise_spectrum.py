r"""The power of the residual in each mode: measurement noise and what no model explains.

    S(ω) = a N(ω) + c + d Y(ω) + ε² Y(ω) + δ² Ȳ

N is the power of the measurement noise that the record predicts, r-fold differentiated; c is flat;
Y is the local power of y^(r) itself (errors in proportion: jitter, interpolation). a, c, d ≥ 0 are
estimated by maximum likelihood (Whittle: modes are independent, each with variance S). The last two
terms are a floor: no model of a real plant is assumed to be more accurate than ε. In modes with
little power it is not assumed to be more accurate than δ of the mean Ȳ over all modes of the same
output, because errors leak into them from the strong modes.
"""

import numpy as np
from jaxtyping import Float, Int

from eoi_jax.discovery.rules import RULES

_RULES = RULES.noise
_ROUNDS = 60

Rows = Float[np.ndarray, " rows"]


def local_power(highest: Rows) -> Rows:
    """Y: power of y^(r), averaged over neighbouring modes of one record and output."""
    total = np.cumsum(np.concatenate([[0.0], highest**2]))
    index = np.arange(len(highest))
    first = np.maximum(index - _RULES.reach, 0)
    last = np.minimum(index + _RULES.reach + 1, len(highest))
    return (total[last] - total[first]) / (last - first)


def fitted_power(
    residual: Rows, noise: Rows, local: Rows, output: Int[np.ndarray, " rows"]
) -> Rows:
    """S(ω) of each mode, by multiplicative updates that never lower the likelihood.

    Args:
        residual: modes of the residual of the model.
        noise: N.
        local: Y.
        output: index of the output of each mode; each output has its own a, c, d.

    Source:
        Févotte, Idier, Neural Computation 23 (2011) 2421 (Itakura–Saito, exponent ½).
    """
    power = np.empty_like(residual)
    for j in np.unique(output):
        modes = output == j
        power[modes] = _fit_output(residual[modes] ** 2, noise[modes], local[modes])
    return power


def expected_power(noise: Rows, local: Rows, output: Int[np.ndarray, " rows"]) -> Rows:
    """The power that the record predicts for each output: measurement noise and the floor."""
    power = np.empty_like(noise)
    for j in np.unique(output):
        modes = output == j
        power[modes] = noise[modes] + _floor(local[modes])
    return power


def _fit_output(square: Rows, noise: Rows, local: Rows) -> Rows:
    floor = _floor(local)
    basis = np.stack([noise, np.ones_like(noise), local])
    basis = basis[np.max(basis, axis=1) > 0]
    level = np.mean(square)
    weights = level / np.mean(basis, axis=1) / len(basis)
    for _ in range(_ROUNDS):
        power = weights @ basis + floor
        numerator, denominator = basis @ (square / power**2), basis @ (1.0 / power)
        weights = weights * np.sqrt(numerator / denominator)
    return weights @ basis + floor


def _floor(local: Rows) -> Rows:
    """ε² Y + δ² Ȳ of one output; outputs may have different units."""
    # The constant keeps S positive for a plant at rest.
    return _RULES.floor**2 * local + _RULES.flat**2 * np.mean(local) + 1e-30
