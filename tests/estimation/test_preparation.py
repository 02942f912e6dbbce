"""Which steps count: gaps, rest and reversals are out, weights rise smoothly beside them."""

import numpy as np
import pytest
from problems import SWAY, grid

from eoi_jax.data.masks import moving
from eoi_jax.data.record import Record
from eoi_jax.estimation.preparation import prepare_steps, step_inputs
from eoi_jax.models.check_records import check_records
from eoi_jax.models.library import Plant, mass_spring_damper, pendulum

H = 0.01
ROUGH, SMOOTH = pendulum(), mass_spring_damper()


def made(plant, records, taps=2, transient=0.0, memory=1.0, noise=0.0, explicit=False, taper=0.0):
    velocity_noise = [np.full(len(plant.outputs), noise)] * len(records)
    inputs = [step_inputs(record, explicit) for record in records]
    return prepare_steps(
        plant, records, inputs, taps, transient, memory, velocity_noise, explicit, taper
    )


def record_of(y, hold="linear", u=None, **kwargs):
    return Record.from_period(H, np.zeros(len(y)) if u is None else u, y, hold=hold, **kwargs)


def test_steps_lie_between_the_samples():
    t = grid(50, H)
    u, y = np.cos(t), SWAY(t)
    steps = made(SMOOTH, [record_of(y, u=u)])
    np.testing.assert_allclose(steps.time[0], t[:-1] + 0.5 * H)
    np.testing.assert_array_equal(steps.y[0, :, 0], y[:-1])
    np.testing.assert_array_equal(steps.y_next[0, :, 0], y[1:])
    np.testing.assert_allclose(steps.u[0, :, 0], 0.5 * (u[1:] + u[:-1]))
    np.testing.assert_array_equal(steps.restart[0], np.arange(49) == 0)
    assert steps.sample_period[0] == H


def test_explicit_form_reads_the_input_at_the_start_of_a_step():
    u = np.cos(grid(50, H))
    steps = made(SMOOTH, [record_of(SWAY(grid(50, H)), u=u)], explicit=True)
    np.testing.assert_array_equal(steps.u[0, :, 0], u[:-1])


def test_the_start_is_left_out_until_an_implicit_observer_slides():
    steps = made(SMOOTH, [record_of(SWAY(grid(50, H)))], taps=3)
    np.testing.assert_array_equal(np.flatnonzero(steps.use[0, :, 0] == 0), np.arange(3 + 3))


@pytest.mark.parametrize("taps", [1, 2, 3])
def test_a_gap_is_out_with_the_moving_average_behind_it_and_restarts_the_observer(taps):
    y = SWAY(grid(100, H))
    y[40:45] = np.nan
    with pytest.warns(UserWarning, match="not finite"):
        record = record_of(y)
    steps = made(SMOOTH, [record], taps=taps)
    out = np.flatnonzero(steps.use[0, :, 0] == 0)
    # Steps 39 … 44 touch a missing sample; the observer starts anew at 45.
    want = [*range(taps + 3), *range(39, 45 + taps + 3)]
    np.testing.assert_array_equal(out, want)
    np.testing.assert_array_equal(np.flatnonzero(steps.restart[0]), [0, 45])


def test_a_gap_costs_the_explicit_observer_a_transient():
    y = SWAY(grid(200, H))
    y[80] = np.nan
    with pytest.warns(UserWarning, match="not finite"):
        record = record_of(y)
    steps = made(SMOOTH, [record], transient=0.3, explicit=True)
    score = steps.score[0, :, 0]
    assert np.all(score[:30] == 0)
    assert np.all(score[81 : 81 + 30] == 0)
    assert np.all(score[81 + 30 :] == 1)


def test_stuck_samples_and_reversals_are_out_for_dry_friction_only():
    t = grid(301, H)
    y = np.where(t < 1.0, 0.0, np.where(t < 2.0, np.sin(np.pi * (t - 1.0)) ** 2, 0.0))
    rough, smooth = made(ROUGH, [record_of(y)]), made(SMOOTH, [record_of(y)])
    assert np.all(smooth.use[0, 10:, 0] == 1)
    use = rough.use[0, :, 0] > 0
    assert not np.any(use[:100])  # at rest
    assert not np.any(use[201:])
    reversal = 150  # sin² is largest at 1.5 s
    assert not np.any(use[reversal - 1 : reversal + 2])
    assert np.all(use[105 : reversal - 2])
    assert np.all(use[reversal + 4 : 198])


def test_motion_below_the_noise_is_no_motion():
    rising = 1e-3 * np.arange(21.0)[:, None]
    assert np.all(moving((2,), rising, 1.0, np.array([0.0])))
    assert np.all(moving((2,), rising, 1.0, np.array([1e-4])))
    assert not np.any(moving((2,), rising, 1.0, np.array([1e-3])))


def test_a_speed_moves_while_it_is_not_zero():
    speed = np.concatenate([np.full(10, 2.0), np.zeros(10), np.full(10, -2.0)])[:, None]
    got = moving((1,), speed, 1e-3, np.array([0.1]))[:, 0]
    assert np.all(got[:9])  # steady, which a position would call rest
    assert not np.any(got[9:20])
    assert np.all(got[20:])


def test_noise_does_not_move_a_plant_at_rest():
    sigma = 1e-4
    y = sigma * np.random.default_rng(0).standard_normal(2000)
    steps = made(ROUGH, [record_of(y)], noise=np.sqrt(2.0) * sigma / H)
    # Three increments in a row beyond 4 σ and of one sign: practically never.
    assert np.sum(steps.use > 0) == 0


def test_direction_is_certain_only_with_both_neighbours():
    steps = np.array([1, 1, 1, 0, 1, 1, 1, -1, -1, -1], dtype=float)[:, None]
    want = [True, True, False, False, False, True, False, False, True, True]
    y = np.concatenate([np.zeros((1, 1)), np.cumsum(steps, axis=0)])
    np.testing.assert_array_equal(moving((2,), y, 1.0, np.zeros(1))[:, 0], want)


def test_outputs_without_friction_are_not_masked_by_the_others():
    def two(t, x, u, p):
        import jax.numpy as jnp

        return jnp.stack([-p.c * jnp.sign(x.y[1, 0]), -p.k * x.y[0, 1]])

    plant = Plant(two, {"c": 1.0, "k": 1.0}, 2, outputs=("rough", "smooth"))
    y = np.stack([np.zeros(100), SWAY(grid(100, H))], axis=1)
    steps = made(plant, [record_of(y)])
    assert not np.any(steps.use[0, :, 0])
    assert np.all(steps.use[0, 5:, 1] == 1)


def test_weights_rise_as_a_raised_cosine_beside_what_is_out():
    y = SWAY(grid(400, H))
    y[200] = np.nan
    with pytest.warns(UserWarning, match="not finite"):
        record = record_of(y)
    steps = made(SMOOTH, [record], taps=1, taper=0.2)
    use = steps.use[0, :, 0]
    first = 201 + 4  # restart at 201, settled after taps + 3
    distance = np.arange(1, 25)
    want = 0.5 - 0.5 * np.cos(np.pi * np.minimum(distance / 20.0, 1.0))
    np.testing.assert_allclose(use[first : first + 24], want, atol=1e-12)
    np.testing.assert_allclose(use[198 : 198 - 24 : -1], want, atol=1e-12)
    np.testing.assert_array_equal(steps.score[0, :, 0] > 0, use > 0)


def test_a_record_without_holes_has_no_taper_at_its_end():
    steps = made(SMOOTH, [record_of(SWAY(grid(200, H)))], taper=0.3)
    assert np.all(steps.use[0, 100:, 0] == 1)


def test_transient_and_burn_in_are_not_scored_but_filtered():
    t = grid(200, H)
    steps = made(SMOOTH, [record_of(SWAY(t)), record_of(SWAY(t), burn_in=0.8)], transient=0.5)
    for i, start in enumerate((50, 80)):
        assert np.all(steps.score[i, :start] == 0)
        assert np.all(steps.score[i, start:] == 1)
        assert np.all(steps.use[i, 10:] == 1)


def test_blocks_have_their_length_and_a_rest_is_left_out():
    record = record_of(SWAY(grid(251, H)))  # 2.5 s, a tenth of it is shorter than the memory
    steps = made(SMOOTH, [record], memory=1.0)
    np.testing.assert_array_equal(np.flatnonzero(steps.block_end[0]), [99, 199])
    assert np.all(steps.block_weight[0, 200:] == 0.0)


def test_weights_of_a_block_have_mean_square_one_and_vanish_at_its_ends():
    steps = made(SMOOTH, [record_of(SWAY(grid(251, H)))], memory=1.0)
    one = steps.block_weight[0, :100]
    assert np.mean(one**2) == pytest.approx(1.0, rel=1e-6)
    assert one[0] < 1e-3
    np.testing.assert_allclose(one, one[::-1], rtol=1e-12)


def test_a_long_record_has_fifty_blocks_and_a_short_one_ten_if_the_memory_allows():
    long = made(SMOOTH, [record_of(SWAY(grid(5001, H)))], memory=0.01)
    assert np.sum(long.block_end) == 50
    short = made(SMOOTH, [record_of(SWAY(grid(1001, H)))], memory=0.9)
    assert np.sum(short.block_end) == 10


def test_padding_counts_nowhere_and_shows_the_model_no_new_number():
    long, short = SWAY(grid(200, H)), SWAY(grid(120, H))
    steps = made(SMOOTH, [record_of(long), record_of(short)])
    rest = slice(119, None)
    for flags in (steps.use, steps.score, steps.restart, steps.block_end):
        assert not np.any(flags[1, rest])
    for signal in (steps.time, steps.y, steps.y_next, steps.u):
        np.testing.assert_array_equal(
            signal[1, rest], np.broadcast_to(signal[1, 118], signal[1, rest].shape)
        )


# -- records that do not fit ------------------------------------------------------------------


def test_one_record_and_several_are_a_tuple():
    record = record_of(SWAY(grid(20, H)))
    assert check_records(SMOOTH, record) == (record,)
    assert check_records(SMOOTH, [record, record]) == (record, record)


def test_no_record_is_an_error():
    with pytest.raises(ValueError, match="`records` must hold at least one record, got none"):
        check_records(SMOOTH, [])


def test_names_of_ones_own_are_accepted_in_any_order():
    y = np.zeros((20, 2)) + SWAY(grid(20, H))[:, None]

    def two(t, x, u, p):
        return p.a * u[0] + x.y[0]

    plant = Plant(two, {"a": 1.0}, outputs=("first", "second"))
    own = Record.from_period(H, np.zeros(20), y, output_names=("left", "right"))
    assert check_records(plant, own) == (own,)


def test_a_unit_may_be_spelled_in_another_way():
    plant = Plant(
        lambda t, x, u, p: p.a * u[0], {"a": 1.0}, 2, ("u",), ("y",), units={"u": "N m", "y": "µm"}
    )
    sway = SWAY(grid(20, H))
    record = Record.from_period(
        H, sway, sway, units={"u": "N·m", "y": "\N{GREEK SMALL LETTER MU}m"}
    )
    assert check_records(plant, record) == (record,)


def test_inputs_and_outputs_must_not_have_changed_places():
    plant = Plant(lambda t, x, u, p: p.a * u[0], {"a": 1.0}, 1, ("torque",), ("speed",))
    sway = SWAY(grid(20, H))

    def record(u, y):
        return Record.from_period(H, sway, sway, input_names=u, output_names=y)

    rule = r"must hold the plant's inputs \(torque\), and `outputs` its outputs \(speed\), got the "
    found = "output speed as an input and the input torque as an output. Give the inputs first: "
    with pytest.raises(ValueError, match=r"`records\[record\].inputs` " + rule + found):
        check_records(plant, record("speed", "torque"))
    # Names that say less are as good as none.
    for names in (("torque", "speed"), ("u", "y"), ("speed", "wheel"), ("power", "torque")):
        assert len(check_records(plant, record(*names))) == 1
    backwards = Plant(lambda t, x, u, p: p.a * u[0], {"a": 1.0}, 1, ("y",), ("u",))
    assert len(check_records(backwards, Record.from_period(H, sway, sway))) == 1


@pytest.mark.parametrize(
    ("kind", "names", "message"),
    [
        (
            "output_names",
            ("second", "first"),
            r"outputs` must come in the plant's order \(first, s",
        ),
        (
            "units",
            {"y1": "mm"},
            r"outputs\[y1\]` must be in the plant's unit for `first`, 'm', got",
        ),
        ("units", {"u": "A"}, r"inputs\[u\]` must be in the plant's unit for `u`, 'V', got 'A'"),
    ],
)
def test_order_and_units_must_agree(kind, names, message):
    y = np.zeros((20, 2)) + SWAY(grid(20, H))[:, None]
    plant = Plant(
        lambda t, x, u, p: p.a * u[0] + x.y[0],
        {"a": 1.0},
        outputs=("first", "second"),
        units={"first": "m", "second": "m", "u": "V"},
    )
    record = Record.from_period(H, np.zeros(20), y, **{kind: names})
    with pytest.raises(ValueError, match=message):
        check_records(plant, record)


def test_inputs_must_be_as_many_as_the_plant_has():
    record = Record.from_period(H, np.zeros((20, 2)), SWAY(grid(20, H)))
    with pytest.raises(ValueError, match=r"inputs` must have 1 channel \(voltage\).*got 2"):
        check_records(SMOOTH, record)
    record = Record.from_period(H, np.zeros((20, 0)), SWAY(grid(20, H)))
    with pytest.raises(ValueError, match=r"got 0 .*Write `inputs=\(\)` in `Plant`"):
        check_records(SMOOTH, record)
