"""Ripples of many periods: where the residual repeats along the position."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery.candidates import atoms, seen_at
from eoi_jax.discovery.cosine_modes import modal_record
from eoi_jax.discovery.noise_spectrum import fitted_power
from eoi_jax.discovery.regression import fitted
from eoi_jax.discovery.round_start import base_of
from eoi_jax.discovery.wavenumbers import wavenumbers
from eoi_jax.models.augmented import place

COGS, TORQUE, PHASE = 24.0, 0.08, 0.4
MOTOR = eoi.Plant(
    lambda t, x, u, p: (u[0] - p.friction * x.y[1]) / p.inertia,
    {"inertia": 0.03, "friction": 0.1}, 2, inputs=("torque",), outputs=("angle",),
    bounds={"inertia": (1e-3, 1.0), "friction": (0.0, 5.0)},
    units={"torque": "N m", "angle": "rad"},
)  # fmt: skip


def turned(seed, samples=4000, torque=TORQUE):
    """A motor with 24 cogs that turns up to 20 times, its torque held for 0.2 to 1 s."""
    draw, h, states = np.random.default_rng(seed), 0.004, np.zeros((samples, 2))
    lengths = draw.integers(50, 250, samples // 50)
    drive = np.repeat(draw.uniform(-0.9, 0.9, len(lengths)), lengths)[:samples]

    def slope(t, x, u):
        return [x[1], (u - 0.07 * x[1] - torque * np.sin(COGS * x[0] + PHASE)) / 0.02]

    at = 0
    while at < samples - 1:
        end = min(at + lengths[0], samples - 1)
        lengths = lengths[1:]
        grid = h * np.arange(end - at + 1)
        part = solve_ivp(
            slope,
            (0.0, grid[-1]),
            states[at],
            t_eval=grid,
            args=(drive[at],),
            rtol=1e-9,
            atol=1e-10,
        )
        states[at : end + 1], at = part.y.T, end
    step = 2.0 * np.pi / 10_000
    return eoi.Record(
        h * np.arange(samples), drive, np.round(states[:, 0] / step) * step, f"run {seed}",
        hold="zero", input_names=("torque",), output_names=("angle",),
    )  # fmt: skip


def found_in(record):
    one, placed = modal_record(MOTOR, record, 60.0), place(MOTOR, effects.PositionRipple(), 0)
    base = base_of(MOTOR, [one])
    residual = fitted(base, [], np.ones_like(base.target)).residual
    power = fitted_power(residual, base.noise, base.local, base.output)
    return one, placed, wavenumbers([one], residual, power, placed)


def test_the_residual_of_a_motor_repeats_with_its_cogs():
    one, placed, found = found_in(turned(1))
    reach = np.ptp(one.y[:, 0, 0])
    assert reach * COGS / (2.0 * np.pi) > 30.0  # periods: beyond any grid
    assert found[0] == pytest.approx(COGS, abs=1.0 / reach)
    none = np.zeros(0)
    seen = seen_at(MOTOR, placed, [one], 60.0, none, none, found)
    grid = placed.effect.grid(seen)
    assert found[0] in grid
    assert 2.0 * found[0] in grid
    assert len(grid) < 150
    assert atoms(MOTOR, placed, grid[-1:], [one])


def test_a_motor_without_cogs_has_no_wavenumber():
    assert len(found_in(turned(2, torque=0.0))[2]) == 0


@pytest.mark.slow
@pytest.mark.long
def test_cogging_of_many_periods_is_found():
    found = eoi.discover(MOTOR, turned(1), validation=turned(3))
    assert found.effects == ("position_ripple",)
    assert found.status.code == "complete"
    values = found.plant.parameters
    assert values["position_ripple_wavenumber"] == pytest.approx(COGS, rel=1e-4)
    level = np.hypot(values["position_ripple_sine"], values["position_ripple_cosine"])
    assert level * values["inertia"] == pytest.approx(TORQUE, rel=0.01)
    assert values["friction"] == pytest.approx(0.07, rel=0.01)
