r"""The power of what is left, mode by mode: measurement noise and all that no model explains.

    S(ω) = a N(ω) + c + d Y(ω) + ε² Y(ω) + δ² Ȳ

N is the power of the measurement noise that the record predicts, r-fold differentiated; c is flat;
Y is the local power of y^(r) itself (errors in proportion: jitter, interpolation). a, c, d ≥ 0 are
found by maximum likelihood (Whittle: modes are independent, each with variance S). The last terms
are a floor: no model of a real plant is taken to be right to better than ε, nor are modes in which
hardly anything happens to better than δ of the mean Ȳ of all modes of the same output: they show
the errors of the others.
"""

import numpy as np
from jaxtyping import Float, Int

_FLOOR, _FLAT = 2e-3, 1e-4  # ε, δ
_ROUNDS = 60
_REACH = 12  # modes on each side over which Y is averaged

Rows = Float[np.ndarray, " rows"]


def local_power(highest: Rows) -> Rows:
    """Y: power of y^(r), averaged over neighbouring modes of one stretch and output."""
    total = np.cumsum(np.concatenate([[0.0], highest**2]))
    index = np.arange(len(highest))
    first = np.maximum(index - _REACH, 0)
    last = np.minimum(index + _REACH + 1, len(highest))
    return (total[last] - total[first]) / (last - first)


def fitted_power(
    residual: Rows, noise: Rows, local: Rows, output: Int[np.ndarray, " rows"]
) -> Rows:
    """S(ω) of each mode, by multiplicative updates that never lower the likelihood.

    Args:
        residual: of the model, as modes.
        noise: N.
        local: Y.
        output: to which each mode belongs; each output has its own a, c, d.

    Source:
        Févotte, Idier, Neural Computation 23 (2011) 2421 (Itakura–Saito, exponent ½).
    """
    power = np.empty_like(residual)
    for j in np.unique(output):
        own = output == j
        power[own] = _one_output(residual[own] ** 2, noise[own], local[own])
    return power


def known_power(noise: Rows, local: Rows, output: Int[np.ndarray, " rows"]) -> Rows:
    """What the record itself predicts, output by output: measurement noise and the floor."""
    power = np.empty_like(noise)
    for j in np.unique(output):
        own = output == j
        power[own] = noise[own] + _floor(local[own])
    return power


def _one_output(square: Rows, noise: Rows, local: Rows) -> Rows:
    floor = _floor(local)
    basis = np.stack([noise, np.ones_like(noise), local])
    basis = basis[np.max(basis, axis=1) > 0]
    level = np.mean(square)
    weights = level / np.mean(basis, axis=1) / len(basis)
    for _ in range(_ROUNDS):
        power = weights @ basis + floor
        up, down = basis @ (square / power**2), basis @ (1.0 / power)
        weights = weights * np.sqrt(up / down)
    return weights @ basis + floor


def _floor(local: Rows) -> Rows:
    """ε² Y + δ² Ȳ of one output: the unit of another one is another."""
    # A plant at rest has no power at all.
    return _FLOOR**2 * local + _FLAT**2 * np.mean(local) + 1e-30
