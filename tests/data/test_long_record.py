"""A record in pieces: every step once, from whatever is sliced like an array."""

import h5py
import numpy as np
import pytest
import zarr

import eoi_jax as eoi

H = 1e-2


def wave(samples):
    t = np.arange(samples) * H
    return np.sin(t), np.cos(3 * t)


@pytest.mark.parametrize("samples", [1000, 2000, 2001, 2999, 3001, 3002, 4001, 7345])
def test_every_step_is_scored_in_one_piece(samples):
    u, y = wave(samples)
    seen = []
    for piece in eoi.LongRecord(H, u, y, piece=2000, overlap=500):
        first = round(piece.time[0] / H)
        skip = round(piece.burn_in / H)
        np.testing.assert_array_equal(piece.outputs[:, 0], y[first : first + len(piece)])
        seen += range(first + skip, first + len(piece) - 1)
    assert seen == list(range(samples - 1))


@pytest.mark.parametrize("kind", ["memmap", "columns", "h5py", "zarr", "array"])
def test_any_source_reads_the_same(kind, tmp_path):
    u, y = wave(5200)
    both = np.stack([y, 2 * y], axis=1).astype("f4")
    if kind in ("memmap", "columns"):
        np.save(tmp_path / "y.npy", both)
        given = np.load(tmp_path / "y.npy", mmap_mode="r")
        given = given[:, ::-1] if kind == "columns" else given  # a view of a map
    elif kind == "h5py":
        given = h5py.File(tmp_path / "y.h5", "w").create_dataset("y", data=both)
    elif kind == "zarr":
        given = zarr.array(both, store=str(tmp_path / "y.zarr"))
    else:
        given = both
    long = eoi.LongRecord(H, u, given, piece=2000, overlap=100, output_names=["a", "b"],
                          units={"a": "m"}, hold="zero", name="rig")  # fmt: skip
    piece = long[1]
    order = [1, 0] if kind == "columns" else [0, 1]
    np.testing.assert_array_equal(piece.outputs, both[1900:4001][:, order])
    assert (piece.name, piece.output_names, piece.hold) == ("rig[1]", ("a", "b"), "zero")
    assert [one.name for one in long[:2]] == ["rig[0]", "rig[1]"]
    assert long[-1].time[-1] == pytest.approx(5199 * H)
    assert long.duration == pytest.approx(52.0)


def test_the_hash_sees_length_and_values():
    u, y = wave(5000)
    one = eoi.LongRecord(H, u, y).data_hash
    assert one == eoi.LongRecord(H, u.copy(), y.copy()).data_hash
    assert one != eoi.LongRecord(H, u[:-1], y[:-1]).data_hash
    assert one != eoi.LongRecord(H, u, y + 1e-9).data_hash


def test_the_hash_of_the_content_sees_hold_and_overlap_too():
    u, y = wave(5000)
    several = [eoi.LongRecord(H, u, y, hold=hold) for hold in ("zero", "linear")]
    several.append(eoi.LongRecord(H, u, y, overlap=10, hold="zero"))
    assert len({one.content_hash for one in several}) == 3
    assert len({one.data_hash for one in several}) == 1
    again = eoi.LongRecord(H, u.copy(), y.copy(), name="other", hold="zero")
    assert again.content_hash == several[0].content_hash


@pytest.mark.parametrize("samples", [5000, 100_000])  # the whole is looked at, or places in it
def test_the_hold_is_decided_once_for_all_pieces(samples):
    """Half of the input is a staircase; over the whole record half of the steps change it."""
    t = np.arange(samples) * H
    half = samples // 2
    u = np.where(np.arange(samples) < half, np.sign(np.sin(t)), np.sin(t))
    long = eoi.LongRecord(H, u, np.cos(t), piece=half, overlap=100)
    assert [long.hold, *(piece.hold for piece in long)] == ["linear"] * 3
    stairs = eoi.LongRecord(H, np.sign(np.sin(t)), np.cos(t), piece=half, overlap=100)
    assert [piece.hold for piece in stairs] == ["zero"] * 2
    assert (
        long.content_hash == eoi.LongRecord(H, u, np.cos(t), half, 100, hold="linear").content_hash
    )
    free = eoi.LongRecord(H, np.zeros((samples, 0)), np.cos(t), piece=half, overlap=100)
    assert free.hold == free[0].hold


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sample_period": 0.0}, "`sample_period` must be positive"),
        ({"inputs": np.zeros(3)}, "`inputs` must be as long as the outputs, 2000 samples"),
        ({"inputs": np.zeros(9), "outputs": np.zeros(9)}, "`outputs` must hold 1000 samples"),
        ({"piece": 10}, "`piece` must be at least 1000 samples"),
        ({"overlap": -1}, "`overlap` must be from 0 to the length of a piece"),
        ({"hold": "first"}, "`hold` must be one of auto, zero, linear, smooth"),
        ({"overlap": 10**6}, "`overlap` must be from 0 to the length of a piece"),
    ],
)
def test_what_makes_no_record_is_refused(changes, message):
    u, y = wave(2000)
    with pytest.raises(ValueError, match=message):
        eoi.LongRecord(**{"sample_period": H, "inputs": u, "outputs": y, **changes})
