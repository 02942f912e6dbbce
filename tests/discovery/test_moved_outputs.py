"""An output that was logged late beside another: moved where that explains, not given an effect."""

import numpy as np
import pytest

import eoi_jax as eoi

PERIOD = 0.01
TIME = PERIOD * np.arange(1200)
FREQUENCIES = np.array([0.9, 1.7, 3.1, 5.3])


def force(time: np.ndarray) -> np.ndarray:
    return np.sum(np.sin(np.outer(time, FREQUENCIES)), axis=1)


def logged(late: float, seed: int, lag: float = 0.0) -> eoi.Record:
    """Position and speed of ẍ = u - 4 x - 1.2 ẋ, settled; the speed late, or behind a lag [s]."""
    time = TIME + 1.7 * seed
    response = 1j * FREQUENCIES / (4.0 - FREQUENCIES**2 + 1.2j * FREQUENCIES)
    waves = response * np.exp(1j * np.outer(time, FREQUENCIES))
    sensor = np.exp(-1j * FREQUENCIES * late) / (1.0 + 1j * FREQUENCIES * lag)
    position, speed = np.sum((waves / (1j * FREQUENCIES)).imag, 1), np.sum((waves * sensor).imag, 1)
    clean = np.stack([position, speed], axis=1)
    noise = 1e-3 * np.random.default_rng(seed).standard_normal(clean.shape)
    return eoi.Record(TIME, force(time), clean + noise, f"run {seed}", hold="smooth")


def oscillator() -> eoi.Plant:
    equations = {"x": "v", "v": "u - k*x - d*v"}
    values = {"k": 4.4, "d": 1.0}
    return eoi.plant_from_text(equations, values, ["x", "v"], inputs=["u"])


@pytest.mark.parametrize("late", [0.07, -0.073])
def test_an_output_of_a_second_logger_is_moved(late: float) -> None:
    found = eoi.discover(oscillator(), logged(late, 1), validation=logged(late, 2))
    assert found.status.code == "nothing_missing"
    assert not found.added
    (note,) = [note for note in found.notes if "was moved to" in note]
    assert f"v was moved to {abs(late)} s {'earlier' if late > 0 else 'later'} beside" in note
    assert f"`late = {{ v = {late} }}`" in note
    assert abs(found.plant.parameters["k"] - 4.0) < 0.01
    assert abs(found.plant.parameters["d"] - 1.2) < 0.01


@pytest.mark.parametrize(("late", "lag"), [(0.0, 0.0), (0.0, 0.3)])
def test_what_is_not_late_or_is_a_lag_is_not_moved(late: float, lag: float) -> None:
    found = eoi.discover(oscillator(), logged(late, 1, lag), validation=logged(late, 2, lag))
    assert not any("was moved to" in note for note in found.notes)
    if lag:
        assert "sensor_lag" in found.effects
