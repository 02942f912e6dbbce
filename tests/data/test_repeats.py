"""Columns in which a slower sensor repeats its last value are told, and read without repeats."""

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.cli import actions
from eoi_jax.cli.config import load
from eoi_jax.data.inspection import inspect
from eoi_jax.data.repeats import rows_per_value

H, N = 0.01, 6000
K = np.arange(N)
DRAW = np.random.default_rng(3)
DRIVE = np.repeat(DRAW.uniform(0.0, 70.0, N // 300), 300)


def speed(drive):
    """Of v' = -0.1 v + 0.05 u, with held u."""
    v = np.full(N, 10.0)
    for k in range(N - 1):
        v[k + 1] = np.exp(-0.1 * H) * v[k] + 0.5 * (1.0 - np.exp(-0.1 * H)) * drive[k]
    return v


def kept(values, rows):
    """The last value at each row, of those that came at some rows."""
    return values[rows[np.searchsorted(rows, np.arange(len(values)), side="right") - 1]]


NOISY = np.round(speed(DRIVE) + 0.03 * DRAW.standard_normal(N), 2)
EVEN = K[::20]
UNEVEN = np.cumsum(np.r_[0, DRAW.integers(17, 24, 250)])
SEVERAL = {"even": (EVEN, 20), "uneven": (UNEVEN, 20), "of three or four": (K[::7] // 2, 3.5)}
COARSE = 0.5 * np.round(2.0 * speed(DRIVE))
QUIET = {
    "new in each row": NOISY,
    "coarse": COARSE,
    "a coarse sensor that is kept": kept(COARSE, EVEN),
    "between rests": np.cumsum(np.where(K // 100 % 2, 0.3 + DRAW.random(N), 0.0)),
    "with empty cells between": np.where(K % 20, np.nan, NOISY),
    "constant": np.ones(N),
}


@pytest.mark.parametrize(("rows", "mean"), SEVERAL.values(), ids=SEVERAL)
def test_kept_values_are_told(rows, mean):
    assert rows_per_value(kept(NOISY, rows[rows < N])) == pytest.approx(mean, rel=0.05)


@pytest.mark.parametrize("values", QUIET.values(), ids=QUIET)
def test_what_is_measured_in_each_row_coarse_or_at_rest_is_not_told(values):
    assert rows_per_value(values) == 0.0


@pytest.fixture
def log(tmp_path):
    """A file in which the speed comes once in 20 rows, and the record with empty cells between."""
    rows = zip(H * K, DRIVE.tolist(), kept(NOISY, EVEN).tolist(), strict=True)
    path = tmp_path / "drive.csv"
    path.write_text("t,throttle,speed\n" + "".join(f"{t:.2f},{u:.6g},{y}\n" for t, u, y in rows))
    return path


def test_fits_and_inspect_say_so(log):
    record = eoi.Record(H * K, DRIVE, kept(NOISY, EVEN), "drive", input_names=["throttle"],
                        output_names=["speed"], hold="zero")  # fmt: skip
    plant = eoi.Plant(lambda t, x, u, p: p.b * u[0] - p.a * x.y[0], {"a": 0.08, "b": 0.04}, 1,
                      ("throttle",), ("speed",))  # fmt: skip
    (note,) = record.notes
    assert note.startswith("`speed` changes once in 20 rows and repeats its value in the others")
    assert note.rstrip(".") in str(eoi.identify(plant, record))
    assert f"drive: {note.rstrip('.')}" in eoi.refine(plant, record).notes
    inspection = inspect(log)
    assert note in inspection.advice
    assert not any("`throttle`" in line and "repeats" in line for line in inspection.advice)
    (channel,) = (channel for channel in inspection.channels if channel.name == "speed")
    assert channel.repeats == 20.0
    assert channel.noise is not None
    assert 0.02 < channel.noise < 0.05  # a fifth of it with repeats


def test_repeats_of_a_named_column_are_missing(log):
    read = log, "t", "throttle", "speed"
    with pytest.warns(eoi.RecordWarning, match="`speed` is measured every 20"):
        record = eoi.read_record(*read, empty_repeats="speed")
    values = kept(NOISY, EVEN)
    assert np.array_equal(record.output_valid[:, 0], np.diff(values, prepend=np.nan) != 0.0)
    assert any(note.endswith("values repeat the one before: left out.") for note in record.notes)
    assert not any("changes once in" in note for note in record.notes)
    with pytest.raises(ValueError, match="`empty_repeats` must be one of throttle, speed, got"):
        eoi.read_record(*read, empty_repeats="gps")


def test_a_draft_names_the_column(log, tmp_path):
    outcome = actions.init([log], tmp_path / "drive.toml", False)
    assert "`speed` has a new value once in 20 rows" in outcome.text
    config = load(tmp_path / "drive.toml")
    tables = config.data, config.validation
    assert all(table is not None and table.empty_repeats == ("speed",) for table in tables)
