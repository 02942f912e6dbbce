r"""The VSS-based direct identification of Xu and Hashimoto, eq. (22) of the paper, section 6.

For $\ddot y = \alpha^\top\zeta$ with measured y, ẏ and regressors ζ an identifier

    x̂₁' = x̂₂      x̂₂' = α̂₀ᵀζ + v      v = v_c + v_v      σ = h₁ (x₁ - x̂₁) + (x₂ - x̂₂)
    v_c = h₁ (x₂ - x̂₂)      v_v = dᵀ|ζ| sign σ

slides on σ = 0, where v_v is (α - α̂₀)ᵀζ in the mean. With u_eq = v behind y_f' = (v - y_f)/τ,

    ω = u_eq - v_c + (α̂₀ - α̂)ᵀζ      α̂' = Γ ζ ω        (22)

(the paper prints α̂ for its rate, and |v| for |u| in |ζ|: misprints, since neither could work). The
filter delays u_eq but not ζ, so that α̂ has a bias, by the effect of a lag τ on (α - α̂₀); this is
the method as published, and it is not corrected here. Integrated with the sampling step: the relay
by Euler's rule, x̂₁ by the trapezoid and the model at the middle of the step, because half a step of
delay between them would be identified as friction.

What the paper leaves open is chosen in favour of the method: the velocity is the derivative of
the zero-phase filtered output (`filtered.motion`), α̂₀ the middle of the intervals that bound the
parameters, Γ = [mean ζζᵀ]⁻¹/T, so that every direction converges with the time constant T, a tenth
of the records. For an output of relative degree one v_c is zero and σ = x₁ - x̂₁.

Source: J.-X. Xu, H. Hashimoto, Int. J. Control 57 (1993) 1413; IEEE Trans. Industrial Electronics
43 (1996).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from eoi_jax._status import Status
from eoi_jax._types import Flags, Output, Scalar
from eoi_jax.comparison.methods.comparator import (
    AbstractComparator,
    Estimate,
    algebraic_answer,
    named,
    not_applicable,
)
from eoi_jax.comparison.methods.filtered import Equation, equation, model_and_slopes
from eoi_jax.compiler.programs import jit
from eoi_jax.data.record import Record
from eoi_jax.estimation.regression.least_squares import least_squares, untraced
from eoi_jax.models.library.mass_spring_damper import mass_spring_damper_dynamics
from eoi_jax.models.plant import Plant

# Section 6 of the paper, for its plant: intervals of α, β and ρ.
_INTERVALS = {"alpha": (100.0, 500.0), "beta": (5.0, 20.0), "rho": (1.0, 5.0)}


@dataclass(frozen=True)
class IdentifierSettings:
    """Numbers of the identifier; h₁ and τ as in section 6 of the paper, for its plant."""

    rate: float = 20.0  # h₁ [1/s]
    lag: float = 0.02  # τ [s]
    final_share: float = 0.1  # of the records: over it α̂ is averaged, and with it α̂ adapts
    max_drift: float = 0.02  # relative, of a converged α̂ within that share


_SETTINGS = IdentifierSettings()


class VSSDirect(AbstractComparator):
    """VSS-based direct identification, eq. (22), with the paper's gains for its plant.

    For any other plant: intervals are the plant's bounds where they are finite, else the nominal
    value ± its size (at least what gives the term the rms of y^(r)); d is their width, as in the
    paper; 1/τ is the cut-off that the paper's own filter would get, and h₁ = 0.4/τ.

    Source: J.-X. Xu, H. Hashimoto, Int. J. Control 57 (1993) 1413; section 6 of the paper.
    """

    name = "vss_direct"
    description = "VSS-based direct identification of Xu and Hashimoto, eq. (22)"

    def estimate(self, plant: Plant, records: Sequence[Record]) -> Estimate:
        """α̂ at the end of all records, run one after the other."""
        refused = algebraic_answer(plant)
        if refused is not None:
            return refused
        if not plant.is_affine:
            reason = "the method takes a plant that is affine in its parameters, without internal"
            return not_applicable(f"{reason} states or lags of its inputs")
        if plant.relative_degree > 2:
            return not_applicable(
                f"the method takes outputs of relative degree one or two, and the plant has "
                f"{plant.relative_degree}"
            )
        filtered = equation(plant, records)
        signals, gains, unidentified = _prepared(filtered)
        if unidentified:
            text = f"no trace in the records of {'; '.join(unidentified)}"
            return Estimate(None, None, Status("unidentifiable", text))
        return _answer(plant, np.asarray(_identifier(signals, gains)))


def _answer(plant: Plant, history: Float[np.ndarray, "time np"]) -> Estimate:
    last = history[-max(int(_SETTINGS.final_share * len(history)), 2) :]
    theta = np.mean(last, axis=0)
    if not np.all(np.isfinite(history)):
        text = "the identifier does not stay finite: sampling too slow for its gains"
        return Estimate(None, None, Status("diverged", text))
    middle = len(last) // 2
    moved = np.abs(np.mean(last[middle:], axis=0) - np.mean(last[:middle], axis=0))
    drift = float(np.max(moved / np.maximum(np.abs(theta), np.finfo(float).tiny)))
    text = f"mean over the last tenth of the records, in which it drifts by {drift:.2g} at most"
    is_steady = drift < _SETTINGS.max_drift
    code = "converged" if is_steady else "passes_exhausted"
    advice = "" if is_steady else ": longer records, or more excitation"
    return Estimate(named(plant, theta), None, Status(code, text + advice))


class _Gains(eqx.Module):
    """Gains of the identifier.

    Attributes:
        middle: α̂₀.
        width: d.
        rate: h₁ [1/s].
        lag: τ [s].
        adaptation: Γ.
        weights: of the outputs.
        second: whether each output has relative degree two.
    """

    middle: Float[Array, " np"]
    width: Float[Array, " np"]
    rate: Scalar
    lag: Scalar
    adaptation: Float[Array, "np np"]
    weights: Output
    second: Flags


Signals = tuple[Array, Array, Array, Array, Array, Array, Array]


def _prepared(filtered: Equation) -> tuple[Signals, _Gains, list[str]]:
    """Signals and gains of the identifier, and combinations that the data do not determine."""
    plant, is_paper_plant = filtered.plant, filtered.plant.dynamics is mass_spring_damper_dynamics
    theta, parts = np.asarray(plant.theta, dtype=float), []
    for record, signals, mask in zip(
        filtered.records, filtered.motions, filtered.masks, strict=True
    ):
        f, phi = (np.asarray(a) for a in model_and_slopes(
            plant, *(jnp.asarray(a) for a in (signals.time, signals.y, signals.u, theta)))
        )  # fmt: skip
        valid = record.valid
        begins = valid & ~np.concatenate([[False], valid[:-1]])
        velocity = signals.y[:, 1] if plant.relative_degree > 1 else np.zeros_like(signals.y[:, 0])
        period = np.full(len(record), record.sample_period)
        row = (
            signals.y[:, 0],
            velocity,
            f - phi @ theta,
            phi,
            mask,
            begins,
            period,
            signals.highest,
        )
        parts.append([values[valid] for values in row])
    y, velocity, offset, phi, mask, begins, period, highest = (
        np.concatenate(values) for values in zip(*parts, strict=True)
    )
    size = np.mean(highest**2, axis=0)
    weights = 1.0 / np.where(size > 0, size, 1.0)
    middle, width = _intervals(plant, is_paper_plant, phi, weights)
    moments = np.einsum("kj,j,kja,kjb->ab", mask, weights, phi, phi) / len(phi)
    solution = least_squares(moments, np.zeros(len(theta)), plant.free)
    unidentified = untraced(solution, plant.names, plant.free)
    lag = _SETTINGS.lag if is_paper_plant else 1.0 / filtered.filters.narrow
    rate = _SETTINGS.rate if is_paper_plant else _SETTINGS.rate * _SETTINGS.lag / lag
    settling = _SETTINGS.final_share * float(np.sum(period))
    gains = _Gains(
        jnp.asarray(middle),
        jnp.asarray(width),
        jnp.asarray(rate),
        jnp.asarray(lag),
        jnp.asarray(solution.inverse / settling),
        jnp.asarray(weights),
        jnp.asarray(np.asarray(plant.degrees) == 2),
    )
    drift = offset + phi @ middle
    drift[:-1] = 0.5 * (drift[:-1] + drift[1:])
    arrays = (y, velocity, drift, phi, mask, begins, period)
    return tuple(jnp.asarray(array) for array in arrays), gains, unidentified  # type: ignore[return-value]


def _intervals(
    plant: Plant, is_paper_plant: bool, phi: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Middle and width of the interval of each parameter; width 0 for a fixed one."""
    theta = np.asarray(plant.theta, dtype=float)
    if is_paper_plant:
        low, high = (np.array([_INTERVALS[name][i] for name in plant.names]) for i in (0, 1))
    else:
        term = np.sqrt(np.mean(np.sum(weights[:, None] * phi**2, axis=1), axis=0))
        reach = np.maximum(np.abs(theta), 1.0 / np.where(term > 0, term, np.inf))
        has_bounds = np.isfinite(plant.lower) & np.isfinite(plant.upper)
        low = np.where(has_bounds, plant.lower, theta - reach)
        high = np.where(has_bounds, plant.upper, theta + reach)
    free = np.asarray(plant.free) > 0
    return np.where(free, 0.5 * (low + high), theta), np.where(free, high - low, 0.0)


@jit
def _identifier(signals: Signals, gains: _Gains) -> Float[Array, "time np"]:
    """α̂ at every sample."""
    middle, width, rate, lag = gains.middle, gains.width, gains.rate, gains.lag
    second = gains.second

    def step(carry: tuple[Array, Array, Array, Array], row: Signals) -> tuple[tuple, Array]:
        x1, x2, filtered, alpha = carry
        y, velocity, drift, phi, mask, begins, h = row
        x1, x2 = jnp.where(begins, y, x1), jnp.where(begins, velocity, x2)
        filtered = jnp.where(begins, 0.0, filtered)
        sigma = jnp.where(second, rate * (y - x1) + (velocity - x2), y - x1)
        linear = jnp.where(second, rate * (velocity - x2), 0.0)
        v = linear + (jnp.abs(phi) @ width) * jnp.sign(sigma)
        omega = filtered - linear + phi @ (middle - alpha)
        slope = gains.adaptation @ (phi.T @ (gains.weights * mask * omega))
        moved = drift + v
        new_x2 = x2 + h * jnp.where(second, moved, 0.0)
        new = (
            x1 + h * jnp.where(second, 0.5 * (x2 + new_x2), moved),
            new_x2,
            filtered + h / lag * (v - filtered),
            alpha + h * slope,
        )
        return new, new[3]

    zero = jnp.zeros_like(signals[0][0])
    return jax.lax.scan(step, (zero, zero, zero, middle), signals)[1]
