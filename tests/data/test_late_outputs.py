"""Outputs that were logged late beside the others: told, and moved where the reader is asked to."""

from pathlib import Path

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.data.late_outputs import late_outputs, without_lateness

PERIOD = 0.01
TIME = PERIOD * np.arange(1500)


FREQUENCIES = np.array([0.9, 1.7, 3.1, 5.3])
RESPONSE = 1.0 / (4.0 - FREQUENCIES**2 + 1.2j * FREQUENCIES)


def force(time: np.ndarray) -> np.ndarray:
    return np.sum(np.sin(np.outer(time, FREQUENCIES)), axis=1)


def motion(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position and speed of ẍ = u - 4 x - 1.2 ẋ under that force, settled."""
    waves = RESPONSE * np.exp(1j * np.outer(time, FREQUENCIES))
    return np.sum(waves.imag, axis=1), np.sum((1j * FREQUENCIES * waves).imag, axis=1)


def logged(late: float, seed: int = 0) -> eoi.Record:
    """Position, and speed that a second logger wrote late [s], with noise of 1e-3 each."""
    clean = np.stack([motion(TIME)[0], motion(TIME - late)[1]], axis=1)
    noise = 1e-3 * np.random.default_rng(seed).standard_normal(clean.shape)
    return eoi.Record(TIME, force(TIME), clean + noise, f"late {late} s", hold="smooth")


def oscillator() -> eoi.Plant:
    equations = {"x": "v", "v": "u - k*x - 1.2*v"}
    return eoi.plant_from_text(
        equations, {"k": 4.4}, ["x", "speed"], inputs=["u"], output={"speed": "v"}
    )


def test_an_output_that_is_late_beside_another_is_told() -> None:
    results = (
        eoi.validate(oscillator().with_parameters({"k": 4.0}), logged(0.07)),
        eoi.refine(oscillator(), logged(0.07)),
    )
    for result in results:
        (note,) = [note for note in result.notes if "logged late" in note]
        assert note.startswith("speed seems to be logged late by 0.07 s beside the other outputs")
        assert "`late = { speed = 0.07 }`" in note


def test_an_output_that_is_early_is_told_by_a_negative_time() -> None:
    runs = eoi.validate(oscillator().with_parameters({"k": 4.0}), logged(-0.07))
    assert any("logged early by 0.07 s" in note and "speed = -0.07" in note for note in runs.notes)


def test_a_time_between_samples_is_told_to_a_tenth_of_a_sample() -> None:
    runs = eoi.validate(oscillator().with_parameters({"k": 4.0}), logged(0.074))
    (note,) = [note for note in runs.notes if "logged late" in note]
    assert abs(float(note.split(" by ")[1].split(" s ")[0]) - 0.074) < 0.1 * PERIOD


@pytest.mark.parametrize("stiffness", [4.0, 4.4])
def test_without_lateness_nothing_is_said(stiffness: float) -> None:
    runs = eoi.validate(oscillator().with_parameters({"k": stiffness}), logged(0.0))
    assert not any("logged late" in note or "logged early" in note for note in runs.notes)


@pytest.mark.parametrize("late", [0.07, -0.07, 0.074])
def test_the_reader_moves_it(tmp_path: Path, late: float) -> None:
    position, speed = motion(TIME)[0], motion(TIME - late)[1]
    table = np.stack([TIME, np.ones(len(TIME)), position, speed], axis=1)
    file = tmp_path / "run.csv"
    np.savetxt(file, table, delimiter=",", header="t,u,x,speed", comments="")
    record = eoi.read_record(file, "t", "u", ["x", "speed"], late={"speed": late})
    measured = record.output_valid[:, 1]
    assert len(TIME) - 9 <= measured.sum() < len(TIME)
    assert np.all(record.output_valid[:, 0])
    np.testing.assert_allclose(record.outputs[measured, 1], motion(TIME)[1][measured], atol=1e-9)
    between = "with values from a spline" in record.notes[-1]
    assert between == (late == 0.074)
    assert f"`speed` moved to {late:g} s earlier" in record.notes[-1]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("error", [np.nan, np.inf, 0.0])
def test_runs_that_are_not_scored_or_diverge_or_are_exact_tell_nothing(error: float) -> None:
    record = logged(0.07)
    for part in (record, record[:12]):
        assert late_outputs([part], [np.full(part.outputs.shape, error)], ("x", "v")) == {}


def test_gaps_move_as_well() -> None:
    full = logged(0.07)
    y = full.outputs.copy()
    y[100:120, 1] = np.nan
    record = without_lateness(eoi.Record(TIME, np.ones(len(TIME)), y, "gap"), {"y2": 0.07})
    assert not np.any(record.output_valid[93:113, 1])
    assert np.all(record.output_valid[80:93, 1])
    assert np.all(record.output_valid[113:140, 1])


def test_a_wrong_column_and_a_wrong_time_are_refused() -> None:
    record = logged(0.0)
    with pytest.raises(ValueError, match=r"`late` must be one of y1, y2, got 'u1'"):
        without_lateness(record, {"u1": 0.1})
    with pytest.raises(
        ValueError, match=r"`late\[y2\]` must be a time shorter than the record, 14.99 s"
    ):
        without_lateness(record, {"y2": 15.0})
