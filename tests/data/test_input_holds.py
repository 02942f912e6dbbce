"""A hold for each input: what is read, and that each column is that of a record with its hold."""

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.data.holds import made_alike
from eoi_jax.data.input_holds import read_hold, suggested_hold
from eoi_jax.simulation.simulate import drive

H, N = 0.1, 300
TIME = H * np.arange(N)
HOLDS = ("zero", "linear", "smooth")
RNG = np.random.default_rng(0)
U = np.cumsum(RNG.standard_normal((N, 3)), axis=0)
Y = np.c_[np.sin(TIME), np.cos(TIME)]
NAMES = ["valve", "flow", "sun"]
MIXED = dict(zip(NAMES, HOLDS, strict=True))


def mixed(u=U, **options):
    return eoi.Record(TIME, u, Y, input_names=NAMES, hold=MIXED, **options)


def alone(u=U):
    """Records with one of the inputs, and its hold."""
    return [eoi.Record(TIME, u[:, j], Y, input_names=[NAMES[j]], hold=HOLDS[j]) for j in range(3)]


def columns(function, records):
    return np.concatenate([function(record) for record in records], axis=-1)


@pytest.mark.parametrize(
    "function",
    [
        lambda record: record.midpoint_inputs(),
        lambda record: record.resample(4).inputs,
        lambda record: record.resample(4).midpoint_inputs(),
        lambda record: record.smooth(8.0).inputs,
        lambda record: record[50:90].resample(2).inputs,
        lambda record: record.bridged.midpoint_inputs(),
    ],
)
def test_each_input_follows_its_hold(function):
    np.testing.assert_array_equal(function(mixed()), columns(function, alone()))


@pytest.mark.parametrize("substeps", [1, 3])
def test_each_input_follows_its_hold_and_its_skew(substeps):
    delays = np.array([0.03, -0.05, 0.02])
    record = mixed().with_delayed_inputs(delays)
    single = [
        part.with_delayed_inputs([delay]) for part, delay in zip(alone(), delays, strict=True)
    ]
    for function in (
        lambda record: record.resample(substeps).inputs,
        lambda record: record.resample(substeps).midpoint_inputs(),
    ):
        np.testing.assert_array_equal(function(record), columns(function, single))


@pytest.mark.parametrize("skew", [None, np.array([0.03, -0.05, 0.02])])
def test_what_drives_a_free_run_follows_each_hold_and_skew(skew):
    together = drive(TIME, U, HOLDS, 3, skew)
    for j, hold in enumerate(HOLDS):
        single = drive(TIME, U[:, [j]], hold, 3, None if skew is None else skew[[j]])
        np.testing.assert_array_equal(together.inputs[..., j], single.inputs[..., 0])


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["fixed", "adaptive"])
def test_a_simulation_of_a_linear_plant_is_the_sum_of_those_of_each_input(solver):
    gains = (2.0, -1.0, 0.5)

    def plant(chosen):
        return eoi.Plant(
            lambda t, x, u, p: (sum(g * u[i] for i, g in enumerate(chosen)) - x.y[0]) / p.tau,
            {"tau": 0.4}, 1, inputs=tuple(f"u{i}" for i in range(len(chosen))),
        )  # fmt: skip

    whole = eoi.simulate(plant(gains), TIME, U, hold=HOLDS, solver=solver)
    assert whole.hold == HOLDS
    parts = [
        eoi.simulate(plant([gain]), TIME, U[:, j], hold=HOLDS[j], solver=solver).outputs
        for j, gain in enumerate(gains)
    ]
    np.testing.assert_allclose(whole.outputs, sum(parts), atol=1e-9)


def test_stamps_between_the_samples_of_a_clock_are_resampled_by_each_hold():
    time = TIME + RNG.uniform(-0.02, 0.02, N)
    with pytest.warns(eoi.RecordWarning, match="inputs by their hold"):
        record = eoi.Record(time, U, Y, input_names=NAMES, hold=MIXED)
    with pytest.warns(eoi.RecordWarning):
        single = [eoi.Record(time, U[:, j], Y, hold=HOLDS[j]) for j in range(3)]
    np.testing.assert_array_equal(record.inputs, columns(lambda part: part.inputs, single))


def test_a_gap_leaves_no_doubt_where_it_leaves_none_in_any_input():
    u = np.c_[np.repeat(np.arange(30.0), 10), U[:, 1], U[:, 2]]
    u[[50, 103, 205, 206], 1] = np.nan  # at a step of the valve, between two, two samples
    with pytest.warns(eoi.RecordWarning):
        record = mixed(u)
    np.testing.assert_array_equal(np.flatnonzero(~record.input_valid), [50, 205, 206])


@pytest.mark.parametrize(
    ("hold", "read"),
    [
        ("smooth", "smooth"),
        (("zero", "linear", "zero"), ("zero", "linear", "zero")),
        (["linear"] * 3, "linear"),
        ({"sun": "smooth", "valve": "zero", "flow": "linear"}, HOLDS),
    ],
)
def test_holds_are_read_by_name_or_in_order(hold, read):
    record = eoi.Record(TIME, U, Y, input_names=NAMES, hold=hold)
    assert (record.hold, record.hold_declared) == (read, True)
    assert record.holds == ((read,) * 3 if isinstance(read, str) else read)
    assert eoi.Record(TIME, U, Y, input_names=NAMES).with_hold(hold).hold == read
    assert record.without_inputs().holds == ()


MISTAKES = [
    ({"valve": "zero", "flow": "zero"}, r"`hold` must say how each .* got nothing for sun\. Leave"),
    ({**MIXED, "wind": "zero"}, r"`hold\[wind\]` must be of an input of the record, valve, flow"),
    ({**MIXED, "sun": "auto"}, r"`hold\[sun\]` must be one of zero, linear, smooth, got 'auto'"),
    (("zero", "linear"), "`hold` must be zero, linear, smooth, or such a word for each of 3"),
    (["zero", "linear", 3], r"`hold\[sun\]` must be one of zero, linear, smooth, got '3'"),
    (0.5, "`hold` must be zero, linear, smooth, or such a word for each of 3 inputs, got 0.5"),
]


@pytest.mark.parametrize(("hold", "message"), MISTAKES)
def test_a_wrong_hold_is_named_with_its_rule(hold, message):
    with pytest.raises(ValueError, match=message):
        read_hold(hold, NAMES)


def test_a_record_takes_no_automatic_hold_afterwards():
    with pytest.raises(ValueError, match="`hold` must be one of zero, linear, smooth, got 'auto'"):
        mixed().with_hold("auto")


def test_the_samples_of_each_input_suggest_its_hold():
    steps, wave, still = np.repeat(np.arange(30.0), 10), U[:, 1], np.ones(N)
    hold, (note,) = suggested_hold(np.c_[steps, wave, still], NAMES)
    assert hold == ("zero", "linear", "zero")
    assert note == (
        "Hold taken as zero for valve and sun, linear for flow: share of the steps that change the "
        "value is valve 9.7 %, flow 100 %, sun 0 %, limit 20 %."
    )
    assert suggested_hold(np.c_[wave, still], NAMES[:2])[0] == "linear"
    assert suggested_hold(np.c_[steps, still], NAMES[:2])[0] == "zero"


def test_a_hold_of_each_input_is_stored_shown_and_hashed(tmp_path):
    record = mixed(name="run")
    record.save(tmp_path / "run.npz")
    back = eoi.load(tmp_path / "run.npz")
    assert (back.hold, back.holds) == (HOLDS, HOLDS)
    assert back.content_hash == record.content_hash != record.with_hold("zero").content_hash
    assert "hold zero for valve, linear for flow, smooth for sun, 100 % valid" in str(record)
    lines = [axes.get_lines()[0].get_drawstyle() for axes in record.plot().axes[2:]]
    assert lines == ["steps-post", "default", "default"]


def test_tables_of_other_packages_say_the_hold_of_each_input():
    record = mixed()
    assert eoi.record_to_pandas(record).attrs["hold"] == HOLDS
    dataset = eoi.record_to_xarray(record)
    assert dataset.attrs["hold"] == list(HOLDS)  # as netCDF can store it
    holds = dataset.attrs["hold"]
    back = eoi.record_from_xarray(dataset, NAMES, ["y1", "y2"], hold=holds)
    assert back.hold == HOLDS
    np.testing.assert_array_equal(back.inputs, record.inputs)


def test_columns_of_a_file_have_their_holds_under_their_names(tmp_path):
    table = np.c_[TIME, U, Y]
    header = "t,a,b,c,y,z"
    np.savetxt(tmp_path / "run.csv", table, delimiter=",", header=header, comments="")

    def read(hold, **options):
        return eoi.read_record(
            tmp_path / "run.csv", time="t", inputs=["a", "b", "c"], outputs=["y", "z"], hold=hold,
            **options,
        )  # fmt: skip

    holds = {"a": "zero", "b": "linear", "c": "smooth"}
    assert read(holds).hold == HOLDS
    assert read(holds, renames={"a": "valve"}).hold == HOLDS
    with pytest.raises(ValueError, match=r"`hold` must be one of t, a, b, c, y, z, got 'd'"):
        read({**holds, "d": "zero"})


def test_pieces_of_a_long_record_have_a_hold_for_each_input():
    u = np.c_[np.repeat(np.arange(400.0), 10), np.random.default_rng(1).standard_normal(4000)]
    long = eoi.LongRecord(H, u, u[:, 1], piece=2000, overlap=0)
    assert [piece.hold for piece in long] == [("zero", "linear")] * 2
    long = eoi.LongRecord(H, u, u[:, 1], piece=2000, overlap=0, hold=["smooth", "zero"])
    assert [piece.hold for piece in long] == [("smooth", "zero")] * 2


def test_a_record_without_inputs_has_no_hold_in_its_text():
    record = eoi.Record(np.arange(9.0), np.zeros((9, 0)), np.arange(9.0), input_names=())
    assert "hold" not in str(record)
    assert "100 % valid" in str(record)


def test_records_are_made_alike_where_the_fit_has_left_some_out():
    rng = np.random.default_rng(0)
    read = [
        eoi.Record(np.arange(40) * 0.1, rng.standard_normal(40), rng.standard_normal(40), name,
                   hold=hold)
        for name, hold in (("short", "auto"), ("declared", "linear"), ("long", "auto"))
    ]  # fmt: skip
    used = read[1], read[2].with_hold("smooth")
    assert [record.hold for record in made_alike(read, read, used)] == [
        "smooth",
        "linear",
        "smooth",
    ]
