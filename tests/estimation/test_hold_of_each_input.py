"""Inputs of one record that are made in different ways: the fit decides the hold of each.

A room is heated by a valve that a controller sets, through a radiator, and loses heat to the
weather, which goes on between the samples: ``R C dT/dt = (F - T) + R h (H - T)``.
"""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import eoi_jax as eoi
from eoi_jax.data.holds import chosen_hold, moving_inputs, undeclared_hold

PERIOD = 0.25
TRUTH = {"a": 0.5, "b": 0.8, "c": 1.5}
ROOM = eoi.Plant(
    lambda t, x, u, p: p.a * (u[0] - x.y[0]) + p.b * u[1] + p.c * u[1] * x.y[0] / 20.0,
    {"a": 0.4, "b": 1.0, "c": 1.0}, 1, inputs=("outdoor", "heating"), outputs=("room",),
)  # fmt: skip


def weather(seed):
    """A sum of sines up to a quarter of the Nyquist frequency: one at any instant."""
    rng = np.random.default_rng(seed)
    w, phase = rng.uniform(0.2, 4.0, 6), rng.uniform(0.0, 6.0, 6)
    return lambda t: 5.0 * np.sum(np.sin(np.multiply.outer(t, w) + phase), axis=-1)


@cache
def measured(seed, late, count=900, noise=2e-3):
    """Time, inputs and outputs of the room."""
    time, outdoor = PERIOD * np.arange(count), weather(seed)
    valve = np.random.default_rng(seed + 50).uniform(-3.0, 3.0, count)  # another one each sample
    y, room = np.zeros(count), 0.0
    for k in range(count - 1):
        y[k] = room
        for begin, end, level in ((0.0, late, valve[max(k - 1, 0)]), (late, 1.0, valve[k])):
            if end > begin:
                span = time[k] + PERIOD * begin, time[k] + PERIOD * end
                room = solve_ivp(
                    lambda t, s, v=level: TRUTH["a"] * (outdoor(t) - s) + TRUTH["b"] * v
                    + TRUTH["c"] * v * s / 20.0,
                    span, [room], rtol=1e-9, atol=1e-11,
                ).y[0, -1]  # fmt: skip
    y[-1] = room
    y += noise * np.std(y) * np.random.default_rng(seed + 100).standard_normal(count)
    return time, np.c_[outdoor(time), valve], y


def built(seed=0, late=0.0, order=(0, 1), **options):
    """A record of the room; `late`: by which the valve acts later than logged [samples]."""
    time, inputs, y = measured(seed, late)
    names = [("outdoor", "heating")[j] for j in order]
    return eoi.Record(
        time, inputs[:, list(order)], y, input_names=names, output_names=["room"], **options
    )


@pytest.fixture(scope="module")
def record():
    return built()


def test_the_samples_cannot_tell_what_the_fit_tells(record):
    assert (record.hold, record.hold_declared) == ("linear", False)
    result = eoi.identify(ROOM, record)
    assert result.records[0].hold == ("smooth", "zero")
    declared = eoi.identify(ROOM, record.with_hold(("smooth", "zero")))
    for name in TRUTH:
        assert result.parameters[name] == pytest.approx(declared.parameters[name], rel=1e-9)
    assert any(reason.startswith("hold zero for heating: the index is ")
               for reason in result.reasons)  # fmt: skip


def test_refine_and_validate_decide_for_each_input(record):
    result = eoi.refine(ROOM, record)
    for name, value in TRUTH.items():
        assert abs(result.parameters[name] - value) < 4.0 * result.standard_errors[name]
    assert any(note.startswith("hold zero for heating: the error is ") for note in result.notes)
    run = eoi.validate(ROOM.with_parameters(TRUTH), built(seed=7))
    assert run.nrmse[0] < 2.2e-3
    assert run.records[0].holds[1] == "zero" != run.records[0].holds[0]


def test_the_order_of_the_inputs_does_not_matter(record):
    swapped = eoi.Plant(
        lambda t, x, u, p: p.a * (u[1] - x.y[0]) + p.b * u[0] + p.c * u[0] * x.y[0] / 20.0,
        {"a": 0.4, "b": 1.0, "c": 1.0}, 1, inputs=("heating", "outdoor"), outputs=("room",),
    )  # fmt: skip
    results = eoi.identify(ROOM, record), eoi.identify(swapped, built(order=(1, 0)))
    assert results[0].records[0].holds == results[1].records[0].holds[::-1]
    for name in TRUTH:
        assert results[0].parameters[name] == pytest.approx(results[1].parameters[name], rel=1e-9)


@pytest.mark.slow
def test_a_skew_of_one_input_beside_the_hold_of_another():
    result = eoi.identify(ROOM, built(late=0.4))
    (used,) = result.records
    assert used.holds[1] == "zero"
    np.testing.assert_allclose(used.skew / PERIOD, [0.0, 0.4], atol=0.05)
    for name, value in TRUTH.items():
        assert result.parameters[name] == pytest.approx(value, rel=0.02)


@pytest.mark.slow
def test_refine_finds_the_skew_too_and_holds_out_alike():
    late, other = built(late=0.4), built(late=0.4, seed=3)
    result = eoi.refine(ROOM, late, validation=other)
    (used,) = result.records
    assert used.hold == ("smooth", "zero")
    np.testing.assert_allclose(used.skew / PERIOD, [0.0, 0.4], atol=0.01)
    assert result.rmse[0] < 1.1 * 2e-3 * np.std(late.outputs)
    for name, value in TRUTH.items():
        assert abs(result.parameters[name] - value) < 4.0 * result.standard_errors[name]
    assert result.nominal is ROOM
    assert result.notes[-1].startswith("heating leads the outputs by 0.1 s in the log (0.4 sample")
    profile = eoi.profile(result, late, "b")  # of the same records, as they were read
    lower, upper = profile.interval
    assert lower < TRUTH["b"] < upper
    assert upper - lower < 6.0 * result.standard_errors["b"]
    assert result.status.code == "converged"  # not kept at the start by a held-out record as read


def test_refine_shifts_no_input_that_never_changes():
    time = PERIOD * np.arange(200)
    y = 3.0 * (1.0 - np.exp(-0.5 * time)) + 1e-3 * np.random.default_rng(0).standard_normal(200)
    plant = eoi.Plant(lambda t, x, u, p: p.a * (u - x.y[0]), {"a": 0.4}, 1)
    result = eoi.refine(plant, eoi.Record(time, np.full(200, 3.0), y))
    assert result.parameters["a"] == pytest.approx(0.5, rel=1e-3)
    assert not np.any(result.records[0].skew)


def test_refine_shifts_nothing_without_a_skew_and_where_a_hold_is_declared(record):
    assert not np.any(eoi.refine(ROOM, record).records[0].skew)
    declared = built(late=0.4, hold={"outdoor": "smooth", "heating": "zero"})
    assert not np.any(eoi.refine(ROOM, declared).records[0].skew)


def test_a_declared_hold_of_each_input_is_used_as_declared(record):
    declared = record.with_hold({"outdoor": "zero", "heating": "smooth"})
    assert (declared.hold, declared.hold_declared) == (("zero", "smooth"), True)
    result = eoi.identify(ROOM, declared, smoothing=False)
    assert result.records[0].hold == ("zero", "smooth")
    assert not any(reason.startswith("hold ") for reason in result.reasons)


def test_nothing_is_missing_where_inputs_differ(record):
    found = eoi.discover(ROOM, record, built(seed=3))
    assert (found.effects, found.status.code) == ((), "nothing_missing")
    assert any(note.startswith("hold zero for heating: ") for note in found.notes)


# -- the search over holds alone ------------------------------------------------------------------


def search(power, start, count=3, least=0.98):
    """`chosen_hold` of inputs that all move, and what it has tried."""
    names = [f"u{j}" for j in range(count)]
    signals = np.random.default_rng(0).standard_normal((50, count))
    records = [eoi.Record.from_period(1.0, signals, signals[:, 0], input_names=names)]
    tried = []

    def value(hold):
        tried.append(hold)
        words = (hold,) * count if isinstance(hold, str) else hold
        return power(words)

    return chosen_hold(value, start, records, lambda new, old: new < least * old), tried


def test_as_many_fits_as_inputs_not_as_combinations():
    truth = ("zero", "linear", "smooth", "zero", "linear", "linear")
    cost = lambda words: 1.0 + sum(a != b for a, b in zip(words, truth, strict=True))  # noqa: E731
    choice, tried = search(cost, "linear", count=6)
    assert choice.best == truth
    assert len(tried) == len(set(tried)) <= 3 + 2 * 2 * 6 + 3  # of 729
    lines = choice.evidence("the error")
    assert lines[0] == (
        "hold zero for u0: the error is 2 times as large with linear, 2 times as large with smooth"
    )
    assert len(lines) == 6


def test_an_input_that_hardly_matters_follows_the_others_or_its_staircase():
    gains = (1.0, 1e-3, 1.0)

    def cost(words):
        return 1.0 + sum(g * (word != "zero") for g, word in zip(gains, words, strict=True))

    choice, _ = search(cost, ("linear", "linear", "smooth"))
    assert choice.best == "zero"  # which the others share
    assert choice.evidence("the index")[1] == (
        "hold zero for u1: the index is the same within 2 % with the others"
    )
    choice, _ = search(lambda words: 1.0 + (words[0] != "linear"), ("zero", "zero", "linear"))
    assert choice.best == ("linear", "zero", "linear")


def test_inputs_that_never_change_are_not_tried():
    u = np.c_[np.sin(np.arange(60.0)), np.ones(60)]
    records = [eoi.Record.from_period(1.0, u, u[:, 0])]
    assert moving_inputs(records) == (0,)
    choice = chosen_hold(lambda hold: 1.0, "linear", records, lambda new, old: new < old)
    assert (choice.best, set(choice.values)) == ("linear", {"zero", "linear", "smooth"})


def test_an_input_is_judged_by_the_first_record_in_which_it_moves():
    still, steps, wave = np.ones(60), np.repeat(np.arange(6.0), 10), np.sin(np.arange(60.0))
    records = [eoi.Record.from_period(1.0, np.c_[wave, other], wave) for other in (still, steps)]
    assert [record.hold for record in records] == ["linear", ("linear", "zero")]
    assert undeclared_hold(records) == ("linear", "zero")
