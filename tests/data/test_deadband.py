"""Outputs that a historian stored with a deadband are told from what is coarse, slow or at rest."""

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.data.deadband import deadband_note
from eoi_jax.data.inspection import inspect

N = 1500
K = np.arange(N)
DRAW = np.random.default_rng(4)
COURSE = 40.0 + 8.0 * np.sin(0.01 * K) + 3.0 * np.sin(0.037 * K)


def last_stored(values, deadband):
    """The last value that was more than a deadband from the one stored before."""
    stored = [values[0]]
    for value in values[1:]:
        stored.append(value if abs(value - stored[-1]) > deadband else stored[-1])
    return np.asarray(stored)


@pytest.mark.parametrize("resolution", [0.1, 0.01, 1e-9])
@pytest.mark.parametrize(("deadband", "noise"), [(0.15, 0.1), (0.3, 0.02), (0.5, 0.1)])
def test_values_stored_with_a_deadband_are_told(deadband, noise, resolution):
    measured = COURSE + noise * DRAW.standard_normal(N)
    values = last_stored(resolution * np.round(measured / resolution), deadband)
    (note,) = deadband_note("T", values)
    assert note.startswith("`T` repeats its value in ")
    assert "Export the stored events alone" in note


NOISY = COURSE + 0.1 * DRAW.standard_normal(N)
MOVES = np.cumsum(np.where(K // 100 % 2, 3.0 + DRAW.integers(0, 2, N), 0.0))
QUIET = {
    "noise alone": NOISY,
    "a coarse sensor": 0.1 * np.round(10.0 * COURSE),
    "a coarse sensor and noise": 0.5 * np.round(2.0 * NOISY),
    "levels that rounding splits": 0.5 * np.round(2.0 * NOISY) + 1e-5 * DRAW.standard_normal(N),
    "a slow sensor": np.repeat(NOISY[::5], 5),
    "a slow sensor of a ramp": np.repeat(3.0 * K[::4], 4),
    "a drive between rests": MOVES,
    "constant": np.ones(N),
    "events with empty cells between": np.where(
        np.diff(last_stored(NOISY, 0.3), prepend=0.0) != 0.0, last_stored(NOISY, 0.3), np.nan
    ),
}


@pytest.mark.parametrize("values", QUIET.values(), ids=QUIET)
def test_what_is_coarse_slow_or_at_rest_is_not_told(values):
    assert not deadband_note("T", values)


def test_inspect_and_fits_tell(tmp_path):
    time, drive = 60.0 * K, np.repeat(DRAW.uniform(0.0, 10.0, N // 30), 30)
    plant = eoi.Plant(
        lambda t, x, u, p: p.b * u[0] - p.a * x.y[0], {"a": 1e-3, "b": 1e-3}, 1, ("u",), ("T",)
    )
    run = eoi.simulate(plant, time, drive, hold="zero").outputs[:, 0]
    stored = last_stored(np.round(run + 0.02 * DRAW.standard_normal(N), 2), 0.2)
    (note,) = deadband_note("T", stored)
    record = eoi.Record(time, drive, stored, "day", input_names=["u"], output_names=["T"],
                        hold="zero")  # fmt: skip
    assert f"day: {note}" in eoi.identify(plant, record).reasons
    assert f"day: {note}" in eoi.refine(plant, record).notes
    rows = "".join(
        f"{t:g},{u!r},{y:g}\n" for t, u, y in zip(time, drive.tolist(), stored, strict=True)
    )
    (tmp_path / "day.csv").write_text("t,u,T\n" + rows)
    assert note in inspect(tmp_path / "day.csv").advice
