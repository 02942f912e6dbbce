"""Known starts of outputs and their derivatives, judged on records of a simulator of SciPy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import eoi_jax as eoi
from eoi_jax.models.augmented import augmented, place
from eoi_jax.simulation.simulate import simulate

PERIOD, NOISE, TRUE = 0.02, 5e-3, {"a": 20.0, "b": 0.5}
AT_REST = {"rate": 0.0}


def solved(rate_of, angle, rate, time):
    ends = 0.0, time[-1]
    return solve_ivp(rate_of, ends, [angle, rate], t_eval=time, rtol=1e-10, atol=1e-12).y[0]


def swing(seed, rate=0.0, count=25, angle=1.0, name="drop"):
    """A pendulum that is let go."""
    time = PERIOD * np.arange(count)
    x = solved(lambda _, x: [x[1], -TRUE["a"] * np.sin(x[0]) - TRUE["b"] * x[1]], angle, rate, time)
    y = x + NOISE * np.random.default_rng(seed).standard_normal(count)
    return eoi.Record(time, np.zeros((count, 0)), y, name, output_names=("angle",))


def pendulum(initial=None, **values):
    equations = {"angle": "rate", "rate": "-a*sin(angle) - b*rate"}
    return eoi.plant_from_text(equations, {"a": 15.0, "b": 1.0, **values}, ["angle"],
                               initial=initial)  # fmt: skip


def test_a_short_record_says_more_where_its_start_is_known():
    """Half a second: the damping is traded against the rate at the start, unless that is zero."""
    fits = [[eoi.refine(pendulum(known), swing(seed)) for seed in range(6)]
            for known in (None, AT_REST)]  # fmt: skip
    free, known = (np.array([fit.parameters["b"] - TRUE["b"] for fit in column]) for column in fits)
    assert np.std(known) < 0.6 * np.std(free)
    assert np.sqrt(np.mean(known**2)) < 0.1
    for fit in fits[1]:
        assert fit.starts[0].y[1, 0] == 0.0
        assert abs(fit.starts[0].y[0, 0] - 1.0) < 3.0 * NOISE
        assert not any("known start" in note for note in fit.notes)


def test_a_known_start_holds_in_the_first_run_of_each_record_only():
    records = [swing(1, count=100), swing(2, count=100, angle=0.5, name="second")]
    fit = eoi.refine(pendulum(AT_REST), records, window=0.5)
    rates = {(start.record, start.time): start.y[1, 0] for start in fit.starts}
    assert len(rates) == 8
    for (_, time), rate in rates.items():
        assert (rate == 0.0) == (time == 0.0)
    assert fit.parameters["a"] == pytest.approx(TRUE["a"], rel=0.02)


def test_several_records_start_each_from_its_own_value():
    records = [swing(1), swing(2, angle=0.5, name="second")]
    fit = eoi.refine(pendulum(AT_REST), records)
    for start, angle in zip(fit.starts, (1.0, 0.5), strict=True):
        np.testing.assert_allclose(start.y[:, 0], [angle, 0.0], atol=3.0 * NOISE)


def test_the_second_part_of_a_split_has_no_known_start():
    first, second = swing(1, count=160).split(0.5)
    assert second.continues
    assert not first.continues
    assert second[10:].continues
    fit = eoi.refine(pendulum(AT_REST), [first, second])
    assert fit.starts[0].y[1, 0] == 0.0
    assert fit.starts[1].y[1, 0] != 0.0
    assert fit.rmse[0] < 1.2 * NOISE
    validation = eoi.validate(fit.plant, second)
    assert validation.rmse[0] < 1.2 * NOISE
    assert not any("known start" in note for note in validation.notes)


def test_a_known_start_holds_behind_no_gap_of_the_inputs():
    time = PERIOD * np.arange(120)
    y = solved(lambda _, x: [x[1], -20.0 * np.sin(x[0]) - 0.5 * x[1] + 1.0], 1.0, 0.0, time)
    u = np.ones(120)
    u[50:60] = np.nan
    with pytest.warns(eoi.RecordWarning):
        record = eoi.Record(time, u, y + NOISE * np.random.default_rng(0).standard_normal(120),
                            "gap", hold="zero")  # fmt: skip
    plant = eoi.plant_from_text({"y": "v", "v": "-a*sin(y) - b*v + u"}, {"a": 15.0, "b": 1.0},
                                ["y"], ["u"], initial={"v": 0.0})  # fmt: skip
    fit = eoi.refine(plant, record)
    assert [start.y[1, 0] == 0.0 for start in fit.starts] == [True, False]
    assert fit.parameters["a"] == pytest.approx(TRUE["a"], rel=0.02)


def test_validation_starts_where_the_plant_knows_it():
    record, plant = swing(3, count=150), pendulum(AT_REST, **TRUE)
    known = eoi.validate(plant, record, initial_samples=4)
    free = eoi.validate(pendulum(**TRUE), record, initial_samples=4)
    assert known.rmse[0] < 1.3 * NOISE < 0.7 * free.rmse[0]
    windows = eoi.validate(plant, record, window=1.2)
    assert windows.rmse[0] < 1.5 * NOISE


def test_a_start_that_the_records_contradict_is_said_and_stays():
    moving = swing(1, rate=1.0, count=60)
    fit = eoi.refine(pendulum(AT_REST), moving)
    (note,) = [note for note in fit.notes if "known start" in note]
    assert fit.starts[0].y[1, 0] == 0.0
    assert "by record: drop angle' 0.9" in note or "by record: drop angle' 1" in note
    assert "not 0." in note
    validation = eoi.validate(pendulum(AT_REST, **TRUE), moving)
    assert any("contradicts the records" in note for note in validation.notes)
    assert not any("known start" in note for note in eoi.refine(pendulum(), moving).notes)


def stored(second: float) -> eoi.Record:
    """The first of two stores of heat; the second one, which is not measured, starts there."""
    time = PERIOD * np.arange(200)
    y = solved(
        lambda _, x: [3.0 * (x[1] - x[0]), 0.5 * (x[0] - x[1]) - 0.4 * x[1]], 1.0, second, time
    )
    y = y + NOISE * np.random.default_rng(4).standard_normal(200)
    return eoi.Record(time, np.zeros((200, 0)), y, "cut", output_names=["hot"])


def test_the_start_of_an_internal_state_that_the_records_contradict_is_said_and_stays():
    rates = {"hot": "a*(core - hot)", "core": "0.5*(hot - core) - b*core"}
    plant = eoi.plant_from_text(
        rates, {"a": 3.0, "b": 0.5}, ["hot"], initial={"core": 0.0}, fixed=["a"]
    )
    right, moving = (eoi.refine(plant, stored(second)) for second in (0.0, 0.8))
    assert not any("known start" in note for note in right.notes)
    (note,) = [note for note in moving.notes if "known start" in note]
    assert moving.starts[0].z == 0.0
    assert "by record: cut core 0.8" in note or "by record: cut core 0.7" in note
    assert "not 0." in note


def test_a_free_run_starts_by_default_where_the_plant_knows_it():
    time, nothing = PERIOD * np.arange(20), np.zeros((20, 0))
    plant = pendulum({"angle": "pi/4"}, **TRUE)
    np.testing.assert_allclose(simulate(plant, time, nothing).outputs[0], np.pi / 4.0)
    assert simulate(plant, time, nothing, 0.3).outputs[0] == 0.3
    assert simulate(pendulum(), time, nothing).outputs[0] == 0.0


def test_known_starts_survive_effects_and_files(tmp_path):
    plant = pendulum({"rate": 0.0, "angle": 1.0})
    assert plant.initial == {"angle": (1.0, 0.0)}
    changed = plant.with_parameters({"a": 9.0}).declared_anew(fixed=("b",))
    assert changed.initial == plant.initial
    drag = place(plant, eoi.effects.QuadraticDrag(), 0)
    assert augmented(plant, [drag], {drag.names[0]: 0.1}).initial == plant.initial
    found = eoi.refine(plant, swing(0))
    found.save(tmp_path / "fit")
    assert eoi.load(tmp_path / "fit").plant.initial == plant.initial
    eoi.export(plant, tmp_path / "model.json")
    assert eoi.load(tmp_path / "model.json").initial == plant.initial
    eoi.export(plant, tmp_path / "model.py")
    assert "rate: derivative 1 of angle; starts at 0.0" in (tmp_path / "model.py").read_text()


def function(t, x, u, p):
    angle, rate = x.y
    return -p.a * angle - p.b * rate


def in_python(initial):
    return eoi.Plant(function, TRUE, 2, (), ("angle",), initial=initial)


def test_a_plant_in_python_names_its_outputs(tmp_path):
    assert in_python({"angle": (None, 0.0)}).initial == {"angle": (None, 0.0)}
    assert in_python({"angle": 0.5}).initial == {"angle": (0.5, None)}
    assert in_python({"angle": (None, None)}).initial == {}
    known = in_python({"angle": (None, 0.0)}).known_start
    np.testing.assert_array_equal(known, [[np.nan], [0.0]])
    eoi.export(in_python({"angle": (None, 0.0)}), tmp_path / "model.json")
    assert eoi.load(tmp_path / "model.json").initial == {"angle": (None, 0.0)}


@pytest.mark.parametrize(
    ("initial", "message"),
    [
        ({"rate": 0.0}, "`initial` must be one of angle, got 'rate'"),
        ({"angle": (0.0, 0.0, 0.0)}, "must be at most 2 values"),
        ({"angle": ()}, "must be at most 2 values"),
        ({"angle": (None, np.inf)}, "must hold finite numbers, or None"),
        ({"angle": "rest"}, "must hold finite numbers, or None"),
    ],
)
def test_a_known_start_that_is_none_is_refused(initial, message):
    with pytest.raises(ValueError, match=message):
        in_python(initial)


@pytest.mark.parametrize(
    ("initial", "message"),
    [
        ({"speed": 0.0}, "must have states only .angle, rate., got 'speed'"),
        ({"rate": "a"}, "`model.initial.rate` must be a number.*Leave it out"),
        ({"rate": np.inf}, "`model.initial.rate` must be a number"),
    ],
)
def test_a_known_start_in_text_that_is_none_is_refused(initial, message):
    with pytest.raises(ValueError, match=message):
        pendulum(initial)


def test_an_output_that_is_no_state_has_no_known_start():
    with pytest.raises(ValueError, match="must be left out: the output is a function"):
        eoi.Plant(lambda t, x, u, p: p.k * x.z[0], {"k": 1.0}, 0, ("u",), ("y",),
                  internal=lambda t, x, u, p: u - x.z, internal_initial=(0.0,),
                  initial={"y": 0.0})  # fmt: skip
