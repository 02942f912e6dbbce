"""One round of discovery: at which frequencies a sinusoid is worth trying."""

import numpy as np

import eoi_jax as eoi
from eoi_jax.modes import Stretch, stretch
from eoi_jax.rounds import in_step

TIME = np.arange(0.0, 40.0, 0.01)


def free(t, x, u, p):
    """ÿ = b u."""
    return p.gain * u


def moved(position: np.ndarray) -> list[Stretch]:
    plant = eoi.Plant(free, {"gain": 1.0}, 2, inputs=("force",), outputs=("position",))
    return [stretch(plant, eoi.Record(TIME, 0.0 * TIME, position), 20.0)]


def strokes(period: float) -> np.ndarray:
    """To and fro, alike in both directions: odd harmonics only."""
    phase = 2.0 * np.pi * TIME / period
    return np.sin(phase) - np.sin(3.0 * phase) / 9.0 + np.sin(5.0 * phase) / 25.0


def test_a_repeated_motion_has_all_its_harmonics_in_step():
    motion, base = moved(strokes(5.0)), 2.0 * np.pi / 5.0
    # The even ones are not in the motion, but in any friction that differs between directions.
    assert all(in_step(motion, harmonic * base) for harmonic in (1, 2, 3, 4))


def test_other_frequencies_are_not_in_step_with_a_repeated_motion():
    motion, base = moved(strokes(5.0)), 2.0 * np.pi / 5.0
    assert not any(in_step(motion, share * base) for share in (0.61, 1.37, 2.42, 3.71))


def test_nothing_is_in_step_with_a_motion_that_never_repeats():
    noise = np.random.default_rng(3).standard_normal(len(TIME))
    motion = moved(np.convolve(noise, np.hanning(80), "same"))
    assert not any(in_step(motion, omega) for omega in (0.0, 0.7, 2.0, 5.0, 9.0))
