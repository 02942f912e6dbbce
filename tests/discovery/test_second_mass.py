"""A mass that is not measured, behind a spring: a mode of the plant's own."""

import numpy as np
import pytest
from scipy.linalg import expm

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery.free_run_candidates import candidates
from eoi_jax.discovery.judge import Judged
from eoi_jax.models.placements import placements
from eoi_jax.refinement.refine import refine_once
from eoi_jax.refinement.remaining import remaining
from eoi_jax.simulation.validate import judged_runs

PERIOD, COUNT = 0.01, 600
GAIN, FRICTION, RATIO, FREQUENCY, DAMPING = 50.0, 4.0, 0.6, 20.0, 1.5
JOINT = eoi.Plant(
    lambda t, x, u, p: p.gain * u - p.friction * x.y[1], {"gain": 60.0, "friction": 6.0},
    relative_degree=2, inputs=("torque",), outputs=("angle",),
)  # fmt: skip


SHAFT = eoi.Plant(
    lambda t, x, u, p: p.gain * u - p.friction * x.y[0], {"gain": 60.0, "friction": 6.0},
    relative_degree=1, inputs=("torque",), outputs=("speed",),
)  # fmt: skip


def driven(seed: int, in_bearing: bool = False, measured: int = 0) -> eoi.Record:
    """A joint turns a load through a shaft that bends: exact steps of two masses.

    Args:
        seed: of torque and noise.
        in_bearing: whether its damper holds the load to the ground.
        measured: 0: the angle, 1: its speed.
    """
    random = np.random.default_rng(seed)
    torque = np.repeat(random.choice([-1.0, 1.0], COUNT // 10), 10)
    spring, damper = FREQUENCY**2, DAMPING
    rates = np.zeros((5, 5))  # angle, its speed, angle and speed of the load, torque
    rates[0, 1] = rates[2, 3] = 1.0
    rates[1] = [-RATIO * spring, -FRICTION - RATIO * damper, RATIO * spring, RATIO * damper, GAIN]
    rates[3] = [spring, damper, -spring, -damper, 0.0]
    if in_bearing:  # the damper holds the load to the ground
        rates[1, [1, 3]] = [-FRICTION, 0.0]
        rates[3, [1, 3]] = [0.0, -damper]
    step, state, outputs = expm(PERIOD * rates), np.zeros(4), []
    for drive in torque:
        outputs.append(state[measured])
        state = (step @ [*state, drive])[:4]
    noise = 1e-3 * np.std(outputs) * random.standard_normal(COUNT)
    return eoi.Record.from_period(PERIOD, torque[:, None], (outputs + noise)[:, None], hold="zero")


def test_the_score_of_a_second_mass_is_high_at_the_peak_of_the_residual():
    """Little damped, the mode is met only near its frequency: no coarse grid does."""
    refined = refine_once(JOINT, (driven(1),), None)
    tried = [effects.LinearStiffness(), effects.CoulombFriction(), effects.SecondMass()]
    first = remaining(refined, tried).ranking[0]
    assert first.names == ("second_mass",)
    assert first.share > 0.9
    # Small beside the measured one, it would swing with the frequency that both have.
    both = FREQUENCY * np.sqrt(1.0 + RATIO)
    assert first.values["second_mass_frequency"] == pytest.approx(both, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("plant", [JOINT, SHAFT], ids=lambda plant: plant.outputs[0])
@pytest.mark.parametrize("in_bearing", [False, True])
def test_a_load_behind_a_shaft_that_bends_is_found(in_bearing: bool, plant: eoi.Plant):
    measured = int(plant is SHAFT)
    fitted, judging = (driven(seed, in_bearing, measured) for seed in (1, 2))
    found = eoi.discover(plant, fitted, validation=judging)
    assert found.status.code == "complete"
    assert [added.effect for added in found.added] == [effects.SecondMass(in_bearing)]
    values = found.plant.parameters
    assert values["second_mass_ratio"] == pytest.approx(RATIO, rel=0.02)
    assert values["second_mass_frequency"] == pytest.approx(FREQUENCY, rel=0.02)
    assert values["second_mass_damping"] == pytest.approx(DAMPING, rel=0.1)
    assert values["gain"] == pytest.approx(GAIN, rel=0.02)


@pytest.mark.parametrize("in_bearing", [False, True])
def test_the_states_along_a_run_are_those_of_the_mass(in_bearing: bool):
    """Beside many small steps, for a velocity that keeps its mean in each half sample."""
    frequency, damping, steps = 15.0, 2.0, 400
    velocity = np.cos(7.0 * 0.5 * PERIOD * np.arange(201))
    stages = np.stack([velocity[:-2:2], velocity[1::2], velocity[2::2]], axis=-1)[None]
    mass = effects.SecondMass(in_bearing)
    along = mass.states_along(0.0 * stages, stages, PERIOD, np.array([frequency, damping]))
    assert along.shape == (2, 1, 100, 3)
    speeds = 0.5 * (velocity[1:] + velocity[:-1])
    stretch, speed, wanted = 0.0, velocity[0], []
    for v in speeds:
        for _ in range(steps):
            small, slip = 0.5 * PERIOD / steps, speed - (0.0 if in_bearing else v)
            push = -(frequency**2) * stretch - damping * slip
            stretch, speed = stretch + small * (speed - v), speed + small * push
        wanted.append((stretch, speed))
    middles, ends = np.array(wanted[::2]).T, np.array(wanted[1::2]).T
    np.testing.assert_allclose(along[:, 0, :, 1], middles, atol=2e-3)
    np.testing.assert_allclose(along[:, 0, :, 2], ends, atol=2e-3)
    np.testing.assert_array_equal(along[:, 0, 1:, 0], along[:, 0, :-1, 2])


def test_a_heavy_mass_is_tried_from_its_own_frequency():
    """Both swing with ω √(1 + r), which is what the residual shows as if r were small."""
    starts = effects.SecondMass().further_starts((0.1, 30.0, 2.0))
    assert len(starts) == 2
    for ratio, frequency, damping in starts:
        assert frequency * np.sqrt(1.0 + ratio) == pytest.approx(30.0)
        assert damping == 2.0
    refined = refine_once(SHAFT, (driven(1, measured=1),), None)
    run = judged_runs(refined.plant, (driven(2, measured=1),))
    judged = Judged(refined, (), (run, None))
    models = candidates(judged, [effects.SecondMass()], 0.01)
    ratios = {round(plant.parameters["second_mass_ratio"], 6) for plant, _ in models}
    assert {1.0, 4.0} < ratios


def test_only_what_is_driven_and_moves_has_a_second_mass():
    free = eoi.Plant(lambda t, x, u, p: -p.k * x.y[0], {"k": 1.0}, 2, (), ("position",))
    assert placements(free, [effects.SecondMass()]) == []
    slow = eoi.Plant(lambda t, x, u, p: p.b * u - x.y[0], {"b": 1.0}, 1, ("u",), ("level",))
    assert placements(slow, [effects.SecondMass()]) == []
    assert len(placements(JOINT, [effects.SecondMass()])) == 1
    assert len(placements(SHAFT, [effects.SecondMass()])) == 1
