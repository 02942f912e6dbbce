"""Effects that free runs show where the injection has no answer."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery import (
    free_run_evidence,
    free_run_search,
    free_run_trials,
    in_free_runs,
)
from eoi_jax.discovery.additions import smallest_values
from eoi_jax.discovery.free_run_candidates import candidates
from eoi_jax.discovery.free_run_evidence import without_stand_ins
from eoi_jax.discovery.free_run_search import FreeRunAnswer, search_free_runs
from eoi_jax.discovery.free_run_trials import Search, over_both
from eoi_jax.discovery.judge import Judge, Judged, _standardised, mean_error, only_otherwise
from eoi_jax.discovery.probability import Contest
from eoi_jax.models.augmented import Placed, augmented, place
from eoi_jax.models.effects import Product
from eoi_jax.refinement.refine import refine_once
from eoi_jax.refinement.remaining import remaining
from eoi_jax.simulation.validate import validate
from tests.discovery.upright_pendulum import PLANT, upright

PERIOD, COUNT = 2.0, 600
NOISE = 0.02


def heated(t, x, u, p):
    return p.k * u - (x.y[0] - p.ambient) / p.tau


PLATE = eoi.Plant(
    heated,
    {"k": 0.3, "ambient": 20.0, "tau": 60.0},
    relative_degree=1,
    inputs=("voltage",),
    outputs=("temperature",),
    bounds={"tau": (1.0, np.inf)},
    units={"voltage": "V", "temperature": "K", "tau": "s"},
)
TRUE = {"k": 0.4, "ambient": 20.0, "tau": 50.0, "exchange": 0.012, "rate": 0.01}


def staircase(seed):
    random = np.random.default_rng(seed)
    return np.repeat(random.uniform(2.0, 8.0, COUNT // 30), 30)


def measured(seed, exchange=TRUE["exchange"]):
    """A plate beside a store that nobody measures, by SciPy; at rest with its surroundings."""
    voltage, time = staircase(seed), PERIOD * np.arange(COUNT)

    def rate(t, x):
        plate, store = x
        u = voltage[min(int(t / PERIOD), COUNT - 1)]
        warmed = TRUE["k"] * u - (plate - TRUE["ambient"]) / TRUE["tau"]
        return [warmed + exchange * (store - plate), TRUE["rate"] * (plate - store)]

    run = solve_ivp(rate, (0.0, time[-1]), [20.0, 20.0], t_eval=time, max_step=PERIOD, rtol=1e-8)
    noise = NOISE * np.random.default_rng(seed).standard_normal(COUNT)
    return eoi.Record(
        time, voltage, run.y[0] + noise, f"run {seed}", hold="zero", input_names=("voltage",),
        output_names=("temperature",), units={"voltage": "V", "temperature": "K"},
    )  # fmt: skip


def searched(records, judging, tried):
    answer = search_free_runs([PLATE], [((records,), (judging,))], tried)
    assert answer is not None
    return answer


@pytest.fixture(scope="module")
def found():
    return searched(measured(1), measured(2), [effects.SecondNode(), effects.ConstantOffset()])


@pytest.mark.slow
@pytest.mark.long
def test_a_store_that_is_not_measured_is_found_with_its_size(found):
    assert [placed.effect.name for placed in found.best.placed] == ["second_node"]
    values = found.best.refinement.parameters
    assert values["second_node_exchange"] == pytest.approx(TRUE["exchange"], rel=0.05)
    assert values["second_node_rate"] == pytest.approx(TRUE["rate"], rel=0.05)
    assert found.best.runs[0].rmse[0] < 1.3 * NOISE < 5.0 * NOISE < found.base.runs[0].rmse[0]


@pytest.mark.slow
@pytest.mark.long
def test_a_model_that_lacks_nothing_gets_no_effect():
    right = searched(measured(1, 0.0), measured(2, 0.0), [*effects.standard(), *effects.wider()])
    assert right.best.placed == ()
    assert right.base.runs[0].rmse[0] < 1.1 * NOISE


def volume(t, x, u, p):
    return p.a * u * (p.inlet - x.y[0]) + p.b * (p.steam - x.y[0])


VOLUME = eoi.Plant(
    volume, {"a": 0.2, "inlet": 30.0, "b": 0.2, "steam": 90.0}, 1, ("flow",), ("temperature",),
)  # fmt: skip
STREAM = {"a": 0.35, "inlet": 20.0, "b": 0.15, "steam": 100.0}


def passed(seed, cells):
    """Cells in a row by SciPy, each heated alike, from anywhere on; as many samples of 1 s."""
    draw, time = np.random.default_rng(seed), 1.0 * np.arange(COUNT)
    flow = np.repeat(draw.uniform(0.2, 0.9, COUNT // 12), 12)

    def rate(t, x):
        before = np.concatenate([[STREAM["inlet"]], x[:-1]])
        u = flow[min(int(t), COUNT - 1)]
        return cells * STREAM["a"] * u * (before - x) + STREAM["b"] * (STREAM["steam"] - x)

    start = np.linspace(30.0, 50.0, cells)
    run = solve_ivp(rate, (0.0, time[-1]), start, t_eval=time, max_step=1.0, rtol=1e-8)
    y = run.y[-1] + 0.05 * draw.standard_normal(COUNT)
    return eoi.Record(
        time, flow, y, f"run {seed}", hold="zero", input_names=("flow",),
        output_names=("temperature",),
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("cells", [1, 2, 6])
def test_cells_in_series_are_found_with_their_number_and_where_there_are_any(cells):
    variants = [((passed(1, cells),), (passed(2, cells),))]
    answer = search_free_runs([VOLUME], variants, [*effects.standard(), *effects.wider()])
    assert answer is not None
    assert [placed.effect for placed in answer.best.placed] == (
        [] if cells == 1 else [effects.CellsInSeries(cells)]
    )
    for name, value in STREAM.items():
        assert answer.best.refinement.parameters[name] == pytest.approx(value, rel=0.02)
    assert answer.best.runs[0].rmse[0] < 0.06


def test_the_state_of_a_second_node_follows_the_difference_along_a_run():
    """dw/dt = -b w - dy/dt from zero, by SciPy's filter on a straight line between samples."""
    y = np.cumsum(np.random.default_rng(0).standard_normal((1, 50)), axis=1)
    stages = np.stack([y[:, :-1], 0.5 * (y[:, :-1] + y[:, 1:]), y[:, 1:]], axis=-1)
    rate, h = 0.3, 0.5
    along = effects.SecondNode().states_along(stages, stages, h, np.array([rate]))
    decay = np.exp(-rate * h)
    expected = lfilter([-(1.0 - decay) / (rate * h)], [1.0, -decay], np.diff(y[0]))
    np.testing.assert_allclose(along[0, 0, :, 2], expected, rtol=1e-12)
    np.testing.assert_allclose(along[0, 0, 1:, 0], expected[:-1], rtol=1e-12)


@pytest.mark.slow
@pytest.mark.long
def test_an_input_that_yields_is_found_where_the_gain_has_made_up_for_it():
    def maxwell(t, x, u, p):
        return p.stiffness * u - p.rate * x.y[0]

    plant = eoi.Plant(maxwell, {"stiffness": 60.0, "rate": 30.0}, 1, ("velocity",), ("force",))
    placed = place(plant, effects.InputYield(), 0)
    values = dict(zip(placed.names, (2.0, 0.05), strict=True))
    true = augmented(plant.with_parameters({"stiffness": 900.0}), [placed], values)

    def run(seed):
        random, time = np.random.default_rng(seed), 0.01 * np.arange(1500)
        velocity = 30.0 * np.sin(7.0 * time + random.uniform(0, 6)) * (1 + 0.5 * np.sin(time))
        record = eoi.simulate(true, time, velocity, hold="linear")
        noise = 0.5 * random.standard_normal(record.outputs.shape)
        return eoi.Record(time, velocity, record.outputs + noise, f"run {seed}", hold="linear",
                          input_names=("velocity",), output_names=("force",))  # fmt: skip

    tried = [effects.InputYield(), effects.InputSaturation(), effects.InputQuadratic()]
    answer = search_free_runs([plant], [((run(1),), (run(2),))], tried)
    assert answer is not None
    assert [placed.effect.name for placed in answer.best.placed] == ["input_yield"]
    assert answer.best.refinement.parameters["input_yield_level"] == pytest.approx(2.0, rel=0.1)


def drifting(seed, count, gain):
    """A plate whose lamp has this gain; exact, for an input that is held."""
    voltage, random = staircase(seed)[:count], np.random.default_rng(seed)
    pole, rise = np.exp(-PERIOD / TRUE["tau"]), gain * TRUE["tau"]
    warmer = np.asarray(lfilter([0.0, (1.0 - pole) * rise], [1.0, -pole], voltage))
    noise = NOISE * random.standard_normal(count)
    return eoi.Record(
        PERIOD * np.arange(count), voltage, TRUE["ambient"] + warmer + noise, f"run {seed}",
        hold="zero", input_names=("voltage",), output_names=("temperature",),
    )  # fmt: skip


def test_a_few_held_out_samples_that_drift_do_not_choose_between_fits_of_one_model():
    """The lamp ages between the records: one fit is right for the first one, one for the second."""
    records, judging = (drifting(1, 400, 0.4),), (drifting(2, 60, 0.41),)
    judge = Judge.of(judging, PLATE)
    assert judge is not None
    search = Search.begun([PLATE], records, judge)
    assert search is not None
    aged = PLATE.with_parameters({**search.base.refinement.parameters, "k": 0.41})
    assert search.judge.prefers(search.judge.runs(aged), search.base.runs)
    assert search.predicts_better(search.base, aged)
    assert not replace(search, searched=judging).predicts_better(search.base, aged)


def shaken(seed, count=300, amplitude=9.0, samples=8):
    """The beginning of a record with a swing of the temperature that no model has."""
    part = measured(seed)[:count]
    swing = amplitude * np.sin(2.0 * np.pi * np.arange(count) / samples)
    return part.with_outputs(part.outputs + swing[:, None], part.name)


@pytest.mark.slow
def test_errors_before_are_those_of_the_refined_model_on_test_records_too(tmp_path):
    """A store that nobody measures spoils the estimate of the passes, which predicts far worse."""
    unseen = measured(3)
    found = eoi.discover(PLATE, measured(1), measured(2), [effects.SecondNode()], test=unseen)
    assert found.effects == ("second_node",)
    assert found.base is not None
    assert found.before is not None
    assert found.test_before is not None
    for held, runs in ((measured(2), found.before), (unseen, found.test_before)):
        errors = [validate(plant, held, window=np.inf).rmse[0]
                  for plant in (found.plant_before, found.declared.plant)]  # fmt: skip
        assert runs.rmse[0] == pytest.approx(errors[0], rel=0.05)
        assert errors[1] > 1.3 * errors[0]
    found.save(tmp_path / "found.npz")
    again = eoi.load(tmp_path / "found.npz", plant=PLATE)
    assert again.plant_before.parameters == found.plant_before.parameters


@pytest.mark.slow
@pytest.mark.parametrize("shown", [True, False])
def test_records_of_the_fit_confirm_what_few_held_out_ones_hardly_do(monkeypatch, shown):
    """There the errors fall by a fifth, of what shakes them; in the fit nearly all goes."""
    if not shown:
        monkeypatch.setattr(in_free_runs, "shown_by_all", lambda answer: False)
    found = eoi.discover(PLATE, measured(1), shaken(2), [effects.SecondNode()])
    if shown:
        assert found.effects == ("second_node",)
        assert any("those of the fit each show it by more" in note for note in found.notes)
        return
    assert (found.status.code, found.effects) == ("unexplained", ())
    assert found.lead is not None
    assert [added.effect.name for added in found.lead.added] == ["second_node"]


SPUN = eoi.Plant(lambda t, x, u, p: u - p.damping * x.y[0], {"damping": 1.2}, 1, inputs=("drive",),
                 outputs=("speed",))  # fmt: skip


def spun(seed, product=0.0):
    """A drive that is switched, and a product of drive and speed."""
    time = 0.05 * np.arange(400)
    drive = np.where((time + seed) % 7.0 < 3.5, 1.0, 0.2)
    plant = eoi.Plant(lambda t, x, u, p: u - p.damping * x.y[0] - p.product * u * x.y[0],
                      {"damping": 1.0, "product": product}, 1, inputs=("drive",),
                      outputs=("speed",))  # fmt: skip
    run = eoi.simulate(plant, time, drive, 0.5, hold="zero")
    noise = 0.01 * np.random.default_rng(seed).standard_normal((400, 1))
    return run.with_outputs(run.outputs + noise, "spun")


@pytest.mark.parametrize(
    ("damping", "otherwise"),
    [(0.83, True), (1.0, False), (1.19, False)],
    ids=["as wrong on the other side", "true", "hardly another prediction"],
)
def test_a_model_may_predict_otherwise_and_no_better(damping, otherwise):
    judge = Judge.of((spun(1),), SPUN)
    assert judge is not None
    trial = SPUN.with_parameters({"damping": damping})
    assert only_otherwise(judge, trial, SPUN) == otherwise


@pytest.mark.slow
@pytest.mark.parametrize("contradicts", [False, True])
def test_a_product_that_the_records_of_the_fit_do_not_confirm_is_a_lead(monkeypatch, contradicts):
    """It names no cause, and is chosen of many."""
    records = [spun(seed, 0.5) for seed in (1, 2)]
    if contradicts:
        monkeypatch.setattr(in_free_runs, "contradicted_by_fit", lambda answer: True)
    found = eoi.discover(SPUN, records[0], records[1], [Product("u", "y")])
    lead = found.added if found.lead is None else found.lead.added
    assert found.effects == (() if contradicts else ("product",))
    assert [added.effect.name for added in lead] == ["product"]


def test_of_a_plant_that_is_unstable_windows_judge_where_whole_runs_are_lost():
    """With a gain 2 % off the whole run falls over; over 4 time constants of 1/3 s it does not."""
    record = upright(1, 600, friction=0.0)
    off = PLANT.with_parameters({"b": 1.02})
    judge = Judge.of((record,), off)
    assert judge is not None
    assert judge.longest is not None
    assert judge.window == pytest.approx(0.5 * judge.longest, abs=0.01)
    assert judge.longest <= 4.0 / 3.0
    assert validate(off, record, window=np.inf).nrmse[0] > 1.0
    assert all(run is not None and run.nrmse[0] < 0.3 for run in judge.runs(off))
    stable = Judge.of((measured(1),), PLATE)
    assert stable is not None
    assert stable.longest is None


def test_of_a_plant_that_is_unstable_a_judge_takes_records_shorter_than_the_start_of_a_window():
    records = upright(1, 600, friction=0.0), upright(2, 60, friction=0.0)[:40]
    off = PLANT.with_parameters({"b": 1.02})
    judge = Judge.of(records, off)
    assert judge is not None
    assert judge.longest is not None
    assert judge.longest / records[0].sample_period > 40
    assert judge.whole_head == 20
    for run in judge.runs(off):
        assert run is not None
        assert all(np.any(scored) for scored in run.scored_at)


def begun(hold="zero"):
    records, judging = (
        (eoi.Record(made.time, made.inputs, made.outputs, hold=hold, input_names=("voltage",),
                    output_names=("temperature",), units=made.units),)
        for made in (measured(1), measured(2))
    )  # fmt: skip
    judge = Judge.of(judging, PLATE)
    assert judge is not None
    search = Search.begun([PLATE], records, judge)
    assert search is not None
    return search


def with_effect(search, effect, best, values):
    """A fit with an effect more."""
    plant = best.refinement.plant
    placed = place(plant, effect, 0)
    start = dict(zip(placed.names, values, strict=True))
    return search.fitted(augmented(plant, [placed], start), (placed,), best)


def test_an_effect_that_stood_in_for_a_new_one_goes_when_nothing_tells_its_size_any_more():
    """What the store does not take up yet looks like a lamp that saturates, as long as it lacks."""
    search = begun()
    clipped = with_effect(search, effects.InputSaturation(), search.base, [7.0])
    assert clipped is not None
    assert [item.effect.name for item in clipped.placed] == ["input_saturation"]
    stored = with_effect(search, effects.SecondNode(), clipped, [0.01, 0.01])
    assert stored is not None
    assert [item.effect.name for item in stored.placed] == ["second_node"]
    values = stored.refinement.parameters
    assert values["second_node_rate"] == pytest.approx(TRUE["rate"], rel=0.05)
    # A new effect of unknown size is none.
    assert with_effect(search, effects.InputSaturation(), stored, [7.0]) is None


@pytest.mark.slow
def test_the_hold_is_chosen_again_for_the_answer():
    """Held inputs, taken as going on between samples: the store is found, and then the hold."""
    linear, zero = begun("linear"), begun("zero")
    best = with_effect(linear, effects.SecondNode(), linear.base, [0.01, 0.01])
    assert best is not None
    search, answer = free_run_search._made_best([linear, zero], linear, best)
    assert search is zero
    assert answer.error < best.error - 0.5
    assert free_run_search._made_best([linear, zero], zero, answer) == (zero, answer)
    assert free_run_search._made_best([linear, zero], linear, linear.base)[0] is linear


def weather(seed, hold, tau=1.75, count=2500):
    """What goes on between samples, and a body that follows it within two of them, exactly."""
    rng = np.random.default_rng(seed)
    rates, phases = rng.uniform(0.02, 0.2, 6), rng.uniform(0.0, 6.0, 6)
    time = np.arange(float(count))
    waves = np.exp(1j * (np.outer(time, rates) + phases))
    u, y = waves.sum(1).imag, (waves / (1.0 + 1j * rates * tau)).sum(1).imag + 0.3 * tau
    record = eoi.Record(time, u, y + 0.2 * rng.standard_normal(count), f"{seed}")
    return record.with_hold(hold)


def test_a_hold_that_fits_a_little_better_by_more_than_chance_is_that_of_the_answer():
    """Held for half a sample too long, a slow input makes the body faster, and fits as well."""
    body = eoi.plant_from_text({"y": "(u - y)/tau"}, {"tau": 1.5}, ["y"], ["u"], name="body")
    judge = Judge.of((weather(2, "linear"),), body)
    assert judge is not None
    searches = []
    for hold in ("zero", "linear"):
        judging = replace(judge, records=(weather(2, hold),))
        searches.append(Search.begun([body], (weather(1, hold),), judging))
    zero, linear = searches
    best = with_effect(zero, effects.ConstantOffset(), zero.base, [0.3])
    assert best.refinement.parameters["tau"] < 0.85 * 1.75
    search, answer = free_run_search._made_best(searches, zero, best)
    assert search is linear
    assert answer.error > best.error - 0.03
    assert answer.refinement.parameters["tau"] == pytest.approx(1.75, rel=0.03)


@pytest.mark.parametrize(("degree", "count"), [(1, 13), (2, 24), (3, 36)])
def test_windows_of_short_records_give_a_start_with_velocities(degree, count):
    """Twelve samples for each derivative from zero on, a third of which are the start."""
    time = np.arange(130.0)
    plant = eoi.Plant(lambda t, x, u, p: -p.a * x.y[degree - 1], {"a": 1.0}, degree)
    judge = Judge.of((eoi.Record.from_period(1.0, 0.0 * time, np.sin(time), hold="zero"),), plant)
    assert judge is not None
    assert judge.window == count
    assert judge.head == count // 3


@pytest.mark.parametrize(("noise", "windows"), [(0.05, 10), (0.4, 5), (0.8, 3), (5.0, 3)])
def test_windows_are_as_short_as_leaves_motion_in_them(noise, windows):
    """A ramp of 20 over the record: in one of n windows its standard deviation is 20/n/√12."""
    time = np.arange(300.0)
    outputs = 20.0 * time / 300.0 + noise * np.random.default_rng(0).standard_normal(300)
    judge = Judge.of((eoi.Record.from_period(1.0, 0.0 * time, outputs, hold="zero"),), PLATE)
    assert judge is not None
    assert judge.window == 300 // windows
    assert judge.head == min(50, 100 // windows)


@pytest.mark.slow
def test_a_base_that_is_lost_over_whole_records_is_judged_in_windows():
    """An integrator that something unknown drives, too: no parameter keeps it near the record."""
    time = 0.1 * np.arange(600)
    force, plant = np.sin(time), eoi.Plant(lambda t, x, u, p: p.b * u, {"b": 1.0}, 2)
    unknown = (3.0 * np.cos(0.08 * time), -20.0 * np.sin(0.1 * time))
    record, held = (
        eoi.Record(time, force, time - np.sin(time) + part, hold="linear") for part in unknown
    )
    answer = search_free_runs([plant], [((record,), (held,))], [effects.ConstantOffset()])
    assert answer is not None
    lengths = [runs and runs.window for runs in answer.base.runs]
    assert lengths == [pytest.approx(12.0), pytest.approx(6.0)]
    whole = search_free_runs([plant], [((record,), (record,))], [effects.ConstantOffset()])
    assert whole is not None
    assert whole.base.runs[0].window is None


def test_whole_records_of_an_integrator_judge_where_an_effect_predicts_them():
    """A constant force sums up to ten times the spread; with it, nothing is left but noise."""
    time = 0.1 * np.arange(400)

    def record(frequency, seed):
        motion = -np.sin(frequency * time) / frequency**2 - 0.01 * time**2
        noise = 1e-3 * np.random.default_rng(seed).standard_normal(400)
        return eoi.Record(time, np.sin(frequency * time), motion + noise, hold="linear")

    plant = eoi.Plant(lambda t, x, u, p: p.b * u, {"b": 1.0}, 2)
    pair = (record(2.0, 1),), (record(3.0, 2),)
    answer = search_free_runs([plant], [pair], [effects.ConstantOffset()])
    assert answer is not None
    assert np.all(answer.base.runs[0].nrmse > 1.0)
    assert answer.best.runs[0].window is None
    assert [placed.effect.name for placed in answer.best.placed] == ["constant_offset"]
    assert answer.best.refinement.parameters["constant_offset"] == pytest.approx(-0.02, rel=1e-2)


@pytest.mark.slow
def test_whole_records_of_a_plant_that_returns_show_what_is_missing_however_large_it_is():
    """The held-out record hardly moves: a level that is off exceeds its spread."""
    time = 0.5 * np.arange(400)

    def record(levels, seed):
        u = np.repeat(levels, 400 // len(levels))
        y = lfilter([0.0, 1.0 - np.exp(-0.05)], [1.0, -np.exp(-0.05)], 2.0 * u - 3.0)
        y += 1e-3 * np.random.default_rng(seed).standard_normal(400)
        return eoi.Record(time, u, y, hold="zero")

    plant = eoi.Plant(lambda t, x, u, p: (p.k * u - x.y[0]) / p.tau, {"k": 1.0, "tau": 10.0}, 1)
    records = record([4.0, 2.0, 3.0, 1.5], 1), record([1.0, 1.1, 0.95, 1.05], 2)
    answer = search_free_runs([plant], [(records[:1], records[1:])], [effects.ConstantOffset()])
    assert answer is not None
    assert np.all(answer.base.runs[0].nrmse > 1.0)
    assert answer.base.runs[0].window is None
    assert [placed.effect.name for placed in answer.best.placed] == ["constant_offset"]


@pytest.mark.parametrize(
    ("rivals", "chosen"),
    [
        # An end stop imitates an offset with a parameter more.
        ({"constant_offset": -1.32, "end_stop": -1.33}, "constant_offset"),
        ({"constant_offset": -1.32, "end_stop": -1.36}, "end_stop"),
        # A product names no cause.
        ({"constant_offset": -1.32, "product": -1.37}, "constant_offset"),
        ({"constant_offset": -1.32, "product": -1.42}, "product"),
    ],
)
def test_of_laws_that_are_as_good_the_plainest_is_chosen(monkeypatch, rivals, chosen):
    judge, trials = judged_with(rivals)
    monkeypatch.setattr(Judge, "prefers", lambda *_: True)
    assert judge.plainest(list(trials.values())).placed[0].effect.name == chosen


def test_a_product_that_is_better_by_chance_alone_gives_way_to_a_law(monkeypatch):
    judge, trials = judged_with({"constant_offset": -1.32, "end_stop": -1.30, "product": -1.60})
    monkeypatch.setattr(Judge, "prefers", lambda *_: False)
    assert judge.plainest(list(trials.values())).placed[0].effect.name == "constant_offset"


@pytest.mark.parametrize(
    ("held_out", "fitted", "chosen"),
    [
        ((-0.5, -0.6), (-1.0, -0.2), "constant_offset"),  # nearer to a few records by chance
        ((-0.5, -0.6), (-1.0, -1.0), "end_stop"),
        ((-0.5, -0.505), (-1.0, -0.995), "constant_offset"),  # as good, with fewer parameters
        ((-0.5, -0.55), (-1.0, -0.97), "end_stop"),  # on all records, but not on those that judge
    ],
)
def test_of_models_that_are_accepted_all_records_choose(held_out, fitted, chosen):
    judge, trials = judged_with(dict(zip(("constant_offset", "end_stop"), held_out, strict=True)))
    models = [
        replace(trial, fit_runs=(replace(trial.runs[0], nrmse=np.exp([error])), None))
        for trial, error in zip(trials.values(), fitted, strict=True)
    ]
    assert judge.plainest(models).placed[0].effect.name == chosen
    # Neither may only one that was accepted stay where the plainer one is as good on all records.
    assert judge.plainest_of_all(models, models[1:]).placed[0].effect.name == chosen


@pytest.mark.parametrize(("error", "count"), [(-1.32, 1), (-1.42, 2)])
def test_a_pair_is_better_than_one_effect_by_what_makes_an_effect_stay(error, count):
    """Else a pair that does not stay sets what others are as good as: 0.03, and 0.03 for it."""
    judge, trials = judged_with({"constant_offset": -1.285, "end_stop": error})
    single, other = trials.values()
    pair = replace(other, placed=(*single.placed, *other.placed))
    assert len(judge.plainest([single, pair]).placed) == count


def judged_with(errors):
    """A model with one effect or none, of mean errors that are given by its name."""
    plant, time = eoi.Plant(lambda t, x, u, p: p.b * u, {"b": 1.0}, 2), 0.1 * np.arange(60)
    record = eoi.Record(time, np.sin(time), time - np.sin(time), hold="linear")
    fit, judge = refine_once(plant, (record,), None), Judge((record,), 2.0, 6, 9)
    whole, _ = judge.runs(plant)
    tried = effects.ConstantOffset(), effects.EndStop(1), Product("u", "y")
    laws = {law.name: (place(plant, law, 0),) for law in tried}
    return judge, {
        name: Judged(fit, laws.get(name, ()), (replace(whole, nrmse=np.exp([error])), None))
        for name, error in errors.items()
    }


def test_a_plain_law_that_is_no_answer_does_not_come_before_one_that_is():
    judge, trials = judged_with({"none": 0.0, "constant_offset": -0.4, "product": -0.42})
    base, *models = trials.values()
    search = Search(judge.records, judge.records, judge, (base,))
    assert [model.placed[0].effect.name for model in search.answers(models)] == ["product"]


@pytest.mark.parametrize(
    ("error", "placed", "significant", "replaces"),
    [
        (-0.70, ("constant_offset",), True, True),
        (-0.62, ("constant_offset",), True, False),  # hardly lower
        (-0.64, ("constant_offset", "product"), True, False),  # for two effects, one of them rare
        (-0.80, ("constant_offset", "product"), True, True),
        (-0.70, ("constant_offset",), False, False),  # over the origin it may be chance
        (-0.90, ("end_stop", "constant_offset"), True, False),  # beside it, it must be significant
    ],
)
def test_a_model_takes_the_place_of_one_that_came_from_the_same_origin(
    monkeypatch, error, placed, significant, replaces
):
    judge, models = judged_with(
        {"none": 0.0, "end_stop": -0.6, "constant_offset": error, "product": error}
    )
    base, best, trial = models["none"], models["end_stop"], models["constant_offset"]
    trial = replace(trial, placed=tuple(at for name in placed for at in models[name].placed))
    monkeypatch.setattr(Judge, "prefers", lambda _, __, rival: rival is base.runs and significant)
    assert judge.replaces(trial, best, base) is replaces
    search = Search(judge.records, judge.records, judge, (base,))
    assert search.accepts(trial, best, [Contest(base, best, ())]) is replaces
    assert search.accepts(trial, best, []) is False


def test_the_search_goes_on_from_what_is_left_without_stand_ins(monkeypatch):
    """A product hid an offset beside an end stop; without it the offset is found."""
    judge, models = judged_with(
        {"none": 0.0, "end_stop": -0.6, "product": -0.5, "constant_offset": -0.9}
    )
    base, stop, stand_in, offset = models.values()
    plant = base.refinement.plant
    wide, answer = (
        replace(model, placed=(*stop.placed, *model.placed)) for model in (stand_in, offset)
    )
    found_from = {id(base): wide, id(stop): answer}

    def tried_from(best, *_, **__):
        return [(plant, ())] if id(best) in found_from else []

    monkeypatch.setattr(free_run_search, "_begun", lambda *_: [search])
    monkeypatch.setattr(free_run_search, "replacements", lambda *_: [])
    monkeypatch.setattr(free_run_search, "candidates", tried_from)
    monkeypatch.setattr(Search, "fitted", lambda _, __, ___, best: found_from[id(best)])
    monkeypatch.setattr(Search, "further_forms", lambda *_: [])
    monkeypatch.setattr(Search, "narrowed", lambda _, model, *__, **___: model)
    monkeypatch.setattr(Search, "leanest", lambda _, best: stop if best is wide else best)
    monkeypatch.setattr(Search, "settled", lambda _, best: best)
    monkeypatch.setattr(Search, "of_unknown_size", lambda *_: [])
    monkeypatch.setattr(
        Judge, "prefers", lambda _, trial, best: mean_error(trial) < mean_error(best)
    )
    search = Search(judge.records, judge.records, judge, (base,))
    ended = FreeRunAnswer(base, answer, judge.records, judge, better_base=False, share=1.0)
    monkeypatch.setattr(
        FreeRunAnswer,
        "of",
        lambda _, best, __, rounds: replace(ended, best=best, rounds=tuple(rounds)),
    )
    found = search_free_runs([plant], [(judge.records, judge.records)], [])
    assert found is not None
    assert found.best is answer
    assert all(
        contest.chosen is model for contest, model in zip(found.rounds, (wide, answer), strict=True)
    )


def with_errors(model, **standard_errors):
    return replace(model, refinement=replace(model.refinement, standard_errors=standard_errors))


def test_an_effect_with_which_refinement_tells_no_parameter_any_more_goes(monkeypatch):
    """It makes a part of the model so fast, or so large, that only ratios are left."""
    judge, models = judged_with({"none": 0.0, "end_stop": -0.6, "product": -0.9})
    base, stop, wide = (with_errors(model, b=0.1) for model in models.values())
    wide = replace(wide, placed=(*stop.placed, *wide.placed))
    further = {id(base): stop, id(stop): wide}
    monkeypatch.setattr(free_run_search, "_begun", lambda *_: [search])
    monkeypatch.setattr(free_run_search, "replacements", lambda *_: [])
    monkeypatch.setattr(
        free_run_search,
        "candidates",
        lambda best, *_, **__: [(base.refinement.plant, ())] if id(best) in further else [],
    )
    monkeypatch.setattr(Search, "fitted", lambda _, __, ___, best: further[id(best)])
    monkeypatch.setattr(Search, "further_forms", lambda *_: [])
    monkeypatch.setattr(Search, "narrowed", lambda _, model, *__, **___: model)
    monkeypatch.setattr(Search, "leanest", lambda _, best: best)
    monkeypatch.setattr(Search, "of_unknown_size", lambda *_: [])
    monkeypatch.setattr(
        Judge, "prefers", lambda _, trial, best: mean_error(trial) < mean_error(best)
    )
    told = {"end_stop": 0.2}  # standard error of b, which is one, after refinement to the end

    def refined(_, placed, *__):
        model = {len(one.placed): one for one in (base, stop, wide)}[len(placed)]
        last = placed[-1].effect.name if placed else ""
        return [with_errors(model, b=told.get(last, 7.0))]

    monkeypatch.setattr(free_run_trials, "over_both", refined)
    search = Search(judge.records, judge.records, judge, (base,))
    found = search_free_runs([base.refinement.plant], [(judge.records, judge.records)], [])
    assert found is not None
    assert found.best.placed == stop.placed
    assert [contest.chosen for contest in found.rounds] == [stop]
    told.clear()
    found = search_free_runs([base.refinement.plant], [(judge.records, judge.records)], [])
    assert found is not None
    assert found.best.placed == ()
    assert found.rounds == ()


def test_records_too_short_for_windows_are_judged_in_whole_runs():
    record = measured(1)
    short = eoi.Record(record.time[:20], record.inputs[:20], record.outputs[:20], hold="zero")
    judge = Judge.of((short,), PLATE)
    assert judge is not None
    assert judge.lengths == (None,)
    assert judge.runs(PLATE)[1] is None
    assert judge.without_whole_runs() is judge


@pytest.mark.parametrize(
    ("lengths", "most", "chosen"),
    [
        ((100, 100), 200, (0, 1)),
        ((100,) * 7, 320, (0, 3, 6)),
        ((100,) * 7, 199, (0,)),
        ((100, 50, 40), 160, (0, 2)),
    ],
)
def test_long_records_are_searched_in_part(monkeypatch, lengths, most, chosen):
    rules = replace(free_run_trials._RULES, samples=most)
    monkeypatch.setattr(free_run_trials, "_RULES", rules)
    assert portion_of(lengths) == chosen
    # Four steps of a state with its derivatives by three parameters and its start.
    rules = replace(free_run_trials._RULES, samples=10**6, work=20 * most)
    monkeypatch.setattr(free_run_trials, "_RULES", rules)
    assert portion_of(lengths) == chosen


def portion_of(lengths):
    """Numbers of the records of these lengths that are searched."""
    records = tuple(
        eoi.Record(np.arange(count), np.zeros(count), np.arange(count) + 100.0 * i, hold="zero")
        for i, count in enumerate(lengths)
    )
    searched = free_run_trials.portion(records, PLATE)
    return tuple(records.index(record) for record in searched)


@pytest.mark.slow
@pytest.mark.long
def test_of_a_single_long_record_its_beginning_is_searched(monkeypatch):
    monkeypatch.setattr(
        free_run_trials, "_RULES", replace(free_run_trials._RULES, samples=COUNT // 2)
    )
    record, judging = measured(1), measured(2)
    answer = search_free_runs([PLATE], [((record,), (judging,))], [effects.SecondNode()])
    assert answer is not None
    assert answer.share == 0.5
    assert [placed.effect.name for placed in answer.best.placed] == ["second_node"]
    assert len(answer.best.refinement.records[0]) == COUNT


def test_a_fall_is_measured_by_its_scatter():
    values = np.array([1.0, 2.0, 3.0, 2.0])
    error = np.std(values, ddof=1) / 2.0
    assert _standardised(values) == pytest.approx(2.0 / error)
    assert _standardised(np.ones(1)) == 0.0
    assert _standardised(np.zeros(4)) == 0.0
    assert _standardised(-np.ones(4)) < -1e300  # all blocks alike


def cooling(t, x, u, p):
    return -p.k * (x.y[0] - 22.0)


STEEL = eoi.Plant(
    cooling, {"k": 0.002}, 1, inputs=(), outputs=("temperature",), units={"temperature": "°C"}
)


def cooled(seed, start, power):
    """A hot body in a room of 22 °C, by SciPy."""
    time = 2.0 * np.arange(700)

    def rate(t, x):
        lost = 0.38e-11 * ((x + 273.15) ** 4 - 295.15**4) if power == 4 else 2e-5 * x**power
        return -8e-4 * (x - 22.0) - lost

    run = solve_ivp(rate, (0.0, time[-1]), [start], t_eval=time, rtol=1e-8, atol=1e-8).y[0]
    noise = 0.5 * np.random.default_rng(seed).standard_normal(len(time))
    return eoi.Record(
        time, np.zeros((700, 0)), run + noise, f"run {seed}", input_names=(),
        output_names=("temperature",), units={"temperature": "°C"},
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize(
    ("power", "name", "parameter", "value"),
    [
        (4, "radiation", "radiation_coefficient", 0.38e-3),
        (1.8, "power_loss", "power_loss_exponent", 1.8),
    ],
)
def test_a_hot_body_radiates_or_loses_heat_with_a_power(power, name, parameter, value):
    tried = [effects.Radiation(celsius=True), effects.PowerLoss(), effects.ConstantOffset()]
    records = cooled(1, 620.0, power), cooled(2, 430.0, power)
    answer = search_free_runs([STEEL], [(records, (cooled(3, 540.0, power),))], tried)
    assert answer is not None
    assert [placed.effect.name for placed in answer.best.placed] == [name]
    assert answer.best.refinement.parameters[parameter] == pytest.approx(value, rel=0.05)


def eliminated(seed, count=600, period=0.5):
    """A drug that an enzyme takes up, dosed in steps: exact between its samples."""
    random = np.random.default_rng(seed)
    dose = np.repeat(0.05 + 0.5 * random.random(count // 24 + 1), 24)[:count]
    level, run = 0.2, np.empty(count)
    for i in range(count):
        run[i] = level
        level = solve_ivp(
            lambda _, y, u=dose[i]: u - 0.8 * y / (0.5 + y), (0.0, period), [level], rtol=1e-9
        ).y[0, -1]
    noisy = run + 5e-3 * np.std(run) * random.normal(size=count)
    return eoi.Record(
        period * np.arange(count), dose, noisy, f"run {seed}", hold="zero",
        input_names="dose", output_names="drug",
    )  # fmt: skip


@pytest.mark.slow
def test_an_elimination_that_saturates_is_named_and_measured():
    plant = eoi.Plant(
        lambda t, x, u, p: p.b * u - p.k * x.y[0], {"b": 0.9, "k": 0.4}, 1, ("dose",), ("drug",)
    )
    answer = eoi.discover(plant, eliminated(1), validation=eliminated(2))
    assert answer.effects == ("saturating_loss",)
    assert answer.status.code == "complete"
    found = answer.plant.parameters
    assert found["saturating_loss_rate"] == pytest.approx(0.8, rel=0.02)
    assert found["saturating_loss_half"] == pytest.approx(0.5, rel=0.02)


def test_an_uptake_that_saturates_is_found_where_a_constant_one_empties_the_simulated_basin():
    """What is simulated falls below zero, and what is measured never does."""
    plant = eoi.Plant(
        lambda t, x, u, p: p.b * u - p.uptake, {"b": 0.9, "uptake": 0.3}, 1, ("dose",), ("drug",)
    )
    answer = eoi.discover(
        plant, eliminated(1), validation=eliminated(2), effects=["saturating_loss"]
    )
    assert answer.effects == ("saturating_loss",)
    assert answer.status.code == "complete"
    assert answer.plant.parameters["saturating_loss_half"] == pytest.approx(0.5, rel=0.05)


def switched(seed, count=950, period=0.02):
    """A motor whose bridge is open between its pulses, of the mean of its pulses; both ways."""
    random = np.random.default_rng(seed)
    duty = np.repeat(random.uniform(-1.0, 1.0, count // 25), 25)
    speed, run = 0.0, np.empty(count)
    for i in range(count):
        run[i] = speed
        rate = 2.0 + 5.0 * abs(duty[i])
        end = 510.0 * duty[i] / rate
        speed = end + (speed - end) * np.exp(-rate * period)
    noisy = run + 5e-3 * np.std(run) * random.normal(size=count)
    return eoi.Record.from_period(
        period, duty, noisy, f"run {seed}", hold="zero", input_names="duty", output_names="speed"
    )


@pytest.mark.slow
@pytest.mark.long
def test_a_driver_that_is_open_between_pulses_damps_in_proportion_to_its_duty():
    plant = eoi.Plant(
        lambda t, x, u, p: p.b * u - p.k * x.y[0], {"b": 300.0, "k": 3.0}, 1, ("duty",), ("speed",)
    )
    answer = eoi.discover(plant, switched(1), validation=switched(2))
    assert answer.effects == ("input_damping",)
    assert answer.status.code == "complete"
    found = answer.plant.parameters
    assert found["input_damping"] == pytest.approx(5.0, rel=0.02)
    assert found["k"] == pytest.approx(2.0, rel=0.03)


@pytest.mark.slow
@pytest.mark.long
def test_discovery_adds_what_free_runs_show_and_calls_it_partial_or_explained():
    answer = eoi.discover(PLATE, measured(1), validation=measured(2))
    assert "second_node" in answer.effects
    assert answer.status.code in ("partial", "complete")
    assert answer.after is not None
    assert answer.before is not None
    assert answer.after.rmse[0] < 0.5 * answer.before.rmse[0]
    assert "second store" in str(answer)


def test_a_single_fit_says_where_its_runs_diverge():
    record = measured(1)
    unstable = eoi.Plant(
        lambda t, x, u, p: p.a * x.y[0] ** 3 + p.k * u, {"a": 1.0, "k": 1.0}, 1,
        ("voltage",), ("temperature",), units={"voltage": "V", "temperature": "K"},
    )  # fmt: skip
    assert refine_once(unstable, (record,), None).status.code == "diverged"


def test_a_single_fit_says_what_stays_open_without_looking_for_common_factors():
    record = measured(1)
    product = eoi.Plant(
        lambda t, x, u, p: p.a * (p.b * u - x.y[0]), {"a": 0.1, "b": 1.0, "c": 1.0}, 1,
        ("voltage",), ("temperature",), units={"voltage": "V", "temperature": "K"},
    )  # fmt: skip
    fit = refine_once(product, (record,), None)
    assert (fit.status.code, fit.common_factors) == ("unidentifiable", ())
    assert "no trace in the outputs of c" in fit.status.message


def test_the_score_test_tries_a_store_beside_a_parameter():
    refined = refine_once(PLATE, (measured(1),), None)
    ranked = remaining(refined, [effects.SecondNode(), effects.ConstantOffset()])
    assert ranked.significant[0].names == ("second_node",)


@pytest.mark.parametrize(("product", "cells"), [(-0.2, 3), (0.2, None)])
def test_a_further_form_is_tried_only_where_the_fit_has_left_it_a_place(product, cells):
    plant = eoi.plant_from_text({"c": "k*(u - c)"}, {"k": 0.5}, ["c"], ["u"], name="vessel")
    flow = place(plant, Product("u", "y"), 0)
    stream = augmented(plant, (flow,), {flow.names[0]: -0.2})
    series = place(stream, effects.CellsInSeries(), 0)
    whole = augmented(stream, (series,), {}).with_parameters({flow.names[0]: product})
    time, u = 0.1 * np.arange(200.0), np.repeat([1.0, 0.5, 1.5, 1.0], 50)
    record = eoi.Record(time, u, u, "run", hold="zero", input_names=["u"], output_names=["c"])
    judge = Judge.of((record,), plant)
    assert judge is not None
    base, model = (
        Judged(refine_once(start, (record,), None, max_steps=0), placed, judge.runs(start))
        for start, placed in [(plant, ()), (whole, (flow, series))]
    )
    following = Search((record,), (record,), judge, (base,))._next_forms(model)
    assert (following and vars(following[1].effect)["cells"]) == cells


def test_a_model_whose_fit_has_no_answer_is_not_searched_from():
    """Free runs may not show a parameter of it: what they lack then has no score."""
    records, judging = (measured(1)[:200],), (measured(2)[:200],)
    judge = Judge.of(judging, PLATE)
    assert judge is not None
    search = Search.begun([PLATE], records, judge)
    assert search is not None
    assert candidates(search.base, [effects.ConstantOffset()], 0.01)
    without_trace = replace(search.base.refinement, status=eoi.Status("unidentifiable", "no trace"))
    hidden = replace(search.base, refinement=without_trace)
    assert candidates(hidden, [effects.ConstantOffset()], 0.01) == []


def fan(t, x, u, p):
    return p.b * u - p.a * x.y[0]


FAN = eoi.Plant(fan, {"b": 2.0, "a": 0.5}, 1, inputs=("u",), outputs=("y",))


def blown(seed, offset=0.0):
    """A flow that a propeller drives with the square of its speed, exact from step to step."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.uniform(-1.0, 1.0, COUNT // 15), 15)
    pole = np.exp(-0.8 * 0.1)
    force = (3.0 * u * np.abs(u) + offset) * (1.0 - pole) / 0.8
    y = lfilter([0.0, 1.0], [1.0, -pole], force) + 0.02 * random.standard_normal(COUNT)
    return eoi.Record(0.1 * np.arange(COUNT), u, y, hold="zero", input_names=("u",))


def test_an_effect_whose_parameter_runs_off_becomes_the_law_in_which_it_ends():
    """Of b (u + q u|u|) the records tell the product b q alone."""
    judge = Judge.of((blown(2),), FAN)
    assert judge is not None
    search = Search.begun([FAN], (blown(1),), judge)
    assert search is not None
    placed = place(FAN, effects.InputQuadratic(), 0)
    plant = augmented(search.base.refinement.plant, [placed], {"input_quadratic": 0.5})
    trial = search.fitted(plant, (placed,), search.base)
    assert trial is not None
    limits = search._in_the_limit(trial, trial.placed), search.narrowed(trial, [])
    for limit in limits:
        assert limit is not None
        assert [at.effect for at in limit.placed] == [effects.InputSquare()]
        assert limit.refinement.parameters == pytest.approx({"b": 3.0, "a": 0.8}, rel=0.03)
    # Many laws end in none.
    unlimited = replace(trial, placed=(place(FAN, effects.InputSaturation(), 0),))
    assert search._in_the_limit(unlimited, unlimited.placed) is None


def test_an_effect_begins_within_the_bounds_of_its_parameters():
    """An exponent has a least value, and the base has none for it."""
    judge = Judge.of((blown(2),), FAN)
    assert judge is not None
    search = Search.begun([FAN], (blown(1),), judge)
    assert search is not None
    power = place(FAN, effects.PowerLoss(), 0)
    assert smallest_values(power) == {"power_loss_coefficient": 0.0, "power_loss_exponent": 0.1}
    trial = search.with_only([power], search.base)
    assert trial is not None
    assert trial.placed == (power,)


def test_of_two_effects_one_may_be_enough():
    judge = Judge.of((blown(2),), FAN)
    assert judge is not None
    search = Search.begun([FAN], (blown(1),), judge)
    assert search is not None
    placed = tuple(place(FAN, kind(), 0) for kind in (effects.ConstantOffset, effects.InputSquare))
    plant = augmented(search.base.refinement.plant, placed, {"constant_offset": 0.1})
    trial = search.fitted(plant, placed, search.base)
    assert trial is not None
    assert trial.placed == placed[1:]
    assert trial.refinement.parameters == pytest.approx({"b": 3.0, "a": 0.8}, rel=0.03)


def test_of_two_effects_none_may_be_told(monkeypatch):
    """One after the other: what is left then is no trial of either."""
    judge = Judge.of((blown(2),), FAN)
    assert judge is not None
    search = Search.begun([FAN], (blown(1),), judge)
    assert search is not None
    placed = tuple(
        place(FAN, kind(), 0) for kind in (effects.ConstantOffset, effects.QuadraticDrag)
    )
    plant = augmented(search.base.refinement.plant, placed,
                      {name: 0.01 for at in placed for name in at.names})  # fmt: skip
    monkeypatch.setattr(Search, "of_unknown_size", lambda _, model: list(model.placed[:1]))
    assert search.fitted(plant, placed, search.base) is None


@pytest.mark.parametrize("told", [True, False])
def test_an_effect_whose_size_the_answer_does_not_tell_goes(monkeypatch, told):
    """It had one on records made in another way, or in a part of them."""
    ended = []
    monkeypatch.setattr(Search, "settled", lambda _, best: ended.append(best) or best)
    monkeypatch.setattr(
        Search, "of_unknown_size",
        lambda search, model: [] if told or not ended else list(search.further(model)),
    )  # fmt: skip
    answer = search_free_runs([FAN], [((blown(1),), (blown(2),))], [effects.InputSquare()])
    assert answer is not None
    assert bool(answer.best.placed) is told


def beside_a_level(offset: float) -> tuple[FreeRunAnswer, list[Placed]]:
    """An answer of free runs, a square of the input beside a level that was there before it."""
    judge = Judge.of((blown(2, offset),), FAN)
    assert judge is not None
    kinds = effects.ConstantOffset, effects.InputSquare
    level, square = (place(FAN, kind(), 0) for kind in kinds)
    models = []
    for placed in ((level,), (level, square)):
        plant = augmented(FAN, placed, {"constant_offset": 0.0})
        fit = refine_once(plant, (blown(1, offset),), None)
        models.append(Judged(fit, placed, judge.runs(fit.plant)))
    base, best = models
    answer = FreeRunAnswer(base, best, (blown(1, offset),), judge, True, 1.0)
    return answer, [level, square]


@pytest.mark.parametrize(("offset", "stays"), [(0.0, False), (0.3, True)])
def test_of_an_explanation_goes_what_free_runs_do_not_tell_beside_their_effects(offset, stays):
    answer, (level, square) = beside_a_level(offset)
    left = without_stand_ins(answer, answer.best, FAN, ())
    assert left.placed == ((level, square) if stays else (square,))
    if not stays:
        assert left.refinement.parameters == pytest.approx({"b": 3.0, "a": 0.8}, rel=0.03)


@pytest.mark.parametrize(("offset", "stays"), [(0.0, False), (0.3, True)])
def test_what_the_injection_is_not_sure_of_goes_where_it_is_not_needed(monkeypatch, offset, stays):
    """Also where its size is told: a model of which something else is wrong bends it."""
    monkeypatch.setattr(free_run_evidence, "has_size", lambda *_: True)
    answer, (level, square) = beside_a_level(offset)
    assert without_stand_ins(answer, answer.best, FAN, ()).placed == (level, square)
    left = without_stand_ins(answer, answer.best, FAN, [level])
    assert left.placed == ((level, square) if stays else (square,))


def test_a_model_with_more_states_than_samples_tell_is_not_tried():
    """Runs of twelve samples, of which four tell the start: a plate with three further stores."""
    record = measured(1)
    short = eoi.Record(record.time[:12], record.inputs[:12], record.outputs[:12], hold="zero")
    judge = Judge.of((short,), PLATE)
    assert judge is not None
    assert judge.shortest_head == 4
    stores = {"internal": lambda t, x, u, p: -x.z, "internal_initial": [0.0] * 3}
    wide = eoi.Plant(
        heated, dict(PLATE.parameters), inputs=PLATE.inputs, outputs=PLATE.outputs, **stores
    )
    assert over_both(wide, (), (record,), judge) == []
    assert len(over_both(PLATE, (), (record,), judge)) == 1


@pytest.mark.parametrize(("backward", "name"), [(0.6, "coulomb"), (0.3, "asymmetric")])
def test_friction_whose_two_levels_agree_is_told_as_one_level(backward, name):
    """Of a cart that is driven both ways, and held nowhere."""
    plant = eoi.Plant(lambda t, x, u, p: p.k * u - p.d * x.y[1], {"k": 1.0, "d": 0.5}, 2)

    def measured(seed):
        random, time = np.random.default_rng(seed), 0.02 * np.arange(600)
        u = np.repeat(random.uniform(-3.0, 3.0, 20), 30)
        friction = place(plant, effects.AsymmetricFriction(), 0)
        levels = dict(zip(friction.names, (0.6, backward), strict=True))
        run = eoi.simulate(augmented(plant, [friction], levels), time, u, hold="zero").outputs
        return eoi.Record(time, u, run + 1e-3 * random.standard_normal(run.shape), hold="zero")

    judge = Judge.of((measured(2),), plant)
    assert judge is not None
    search = Search.begun([plant], (measured(1),), judge)
    assert search is not None
    friction = place(plant, effects.AsymmetricFriction(), 0)
    wide = search.with_only([friction], search.base)
    assert wide is not None
    (law,) = search.narrowed(wide, effects.standard()).placed
    assert law.effect.name == f"{name}_friction"


def test_a_lead_longer_than_the_records_has_no_size():
    """The input itself is lost beside its rate, and the gain of the model with it."""
    plant = eoi.Plant(
        lambda t, x, u, p: p.b * u - p.k * x.y[0], {"b": 0.9, "k": 0.4}, 1, ("dose",), ("drug",)
    )
    record = eliminated(1)
    judge = Judge.of((record,), plant)
    assert judge is not None
    search = Search.begun([plant], (record,), judge)
    assert search is not None
    rate = place(plant, effects.InputRate(), 0)
    lead, lag = rate.names
    start = augmented(plant, [rate], {lead: 1.0, lag: 2.0})
    fit = refine_once(start, (record,), None)
    for factor, unknown in ((0.9, []), (1.1, [rate])):
        values = fit.parameters | {lead: factor * float(record.time[-1]), lag: 2.0}
        sized = replace(fit, parameters=values, standard_errors=dict.fromkeys(values, 0.1))
        model = Judged(sized, (rate,), judge.runs(fit.plant))
        assert search.of_unknown_size(model) == unknown
