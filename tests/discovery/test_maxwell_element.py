"""A mass on rubber: a spring and a damper in series, beside the spring of the model."""

import numpy as np
import pytest
from scipy.linalg import expm

import eoi_jax as eoi
from eoi_jax import effects

PERIOD, COUNT = 0.01, 1500
GAIN, SPRING, DAMPER, STIFFNESS, RATE = 50.0, 90.0, 1.0, 60.0, 4.0
MOUNT = eoi.Plant(
    lambda t, x, u, p: p.gain * u - p.spring * x.y[0] - p.damper * x.y[1],
    {"gain": 40.0, "spring": 110.0, "damper": 2.0},
    relative_degree=2, inputs=("force",), outputs=("stroke",),
)  # fmt: skip


def shaken(seed: int) -> eoi.Record:
    """Exact steps of the linear system, held force; one thousandth of noise."""
    random = np.random.default_rng(seed)
    force = np.repeat(random.uniform(-1.0, 1.0, COUNT // 15), 15)
    rates = np.zeros((4, 4))  # stroke, its speed, stretch of the element's spring, force
    rates[0, 1] = rates[2, 1] = 1.0
    rates[1] = [-SPRING, -DAMPER, -STIFFNESS, GAIN]
    rates[2, 2] = -RATE
    step, state, outputs = expm(PERIOD * rates), np.zeros(3), []
    for drive in force:
        outputs.append(state[0])
        state = (step @ [*state, drive])[:3]
    noise = 1e-3 * np.std(outputs) * random.standard_normal(COUNT)
    return eoi.Record.from_period(PERIOD, force[:, None], (outputs + noise)[:, None], hold="zero")


@pytest.mark.slow
def test_a_mount_that_relaxes_is_named():
    found = eoi.discover(MOUNT, shaken(1), validation=shaken(2))
    assert found.status.code == "complete"
    assert [added.effect for added in found.added] == [effects.MaxwellElement()]
    values = found.plant.parameters
    assert values["maxwell_element_stiffness"] == pytest.approx(STIFFNESS, rel=0.02)
    assert values["maxwell_element_rate"] == pytest.approx(RATE, rel=0.02)
    assert values["spring"] == pytest.approx(SPRING, rel=0.02)


def test_it_needs_a_position_and_an_input():
    """In free motion a spring, a damper and the element have more parameters than modes."""
    free = eoi.Plant(lambda t, x, u, p: -p.k * x.y[0], {"k": 1.0}, 2, inputs=())
    store = eoi.Plant(lambda t, x, u, p: u[0] - p.k * x.y[0], {"k": 1.0}, 1)
    element = effects.MaxwellElement()
    assert element.fits(MOUNT, 0)
    assert not element.fits(free, 0)
    assert not element.fits(store, 0)
