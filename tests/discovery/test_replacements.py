"""Effects in place of a term of the declared model."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery.additions import level_notes
from eoi_jax.discovery.free_run_search import search_free_runs
from eoi_jax.discovery.free_run_trials import Search
from eoi_jax.discovery.judge import Judge, Judged
from eoi_jax.discovery.replacements import replaced_terms, replacements
from eoi_jax.discovery.result import Added
from eoi_jax.models.augmented import augmented, place
from eoi_jax.refinement.refine import refine_once

PERIOD, COUNT, NOISE = 0.05, 400, 2e-3
PLANT = eoi.Plant(
    lambda t, x, u, p: -p.stiffness * x.y[0] - p.damping * x.y[1],
    {"stiffness": 20.0, "damping": 0.1}, 2, inputs=(), outputs=("angle",),
)  # fmt: skip
LAWS = [effects.ViscousFriction(), effects.CoulombFriction(), effects.QuadraticDrag(),
        effects.CubicDamping(), effects.ConstantOffset()]  # fmt: skip


def released(start, seed, viscous, cubic):
    """A swing that dies out, by SciPy."""
    time = PERIOD * np.arange(COUNT)

    def rate(t, x):
        return [x[1], -25.0 * x[0] - viscous * x[1] - cubic * x[1] ** 3]

    run = solve_ivp(rate, (0.0, time[-1]), [start, 0.0], t_eval=time, rtol=1e-9, atol=1e-12)
    noise = NOISE * np.random.default_rng(seed).standard_normal(COUNT)
    return eoi.Record(time, np.zeros((COUNT, 0)), run.y[0] + noise, hold="zero",
                      output_names=("angle",))  # fmt: skip


def searched(viscous, cubic):
    large, small = released(1.0, 1, viscous, cubic), released(0.2, 2, viscous, cubic)
    answer = search_free_runs([PLANT], [((large,), (small,))], LAWS)
    assert answer is not None
    return answer.best


def test_laws_like_a_term_are_tried_in_its_place_with_the_gain_that_does_as_much():
    record = released(1.0, 1, 0.2, 0.0)
    fit = refine_once(PLANT, (record,), None)
    judge = Judge.of((record,), PLANT)
    assert judge is not None
    models = replacements(Judged(fit, (), judge.runs(fit.plant)), LAWS)
    named = [(placed[0].effect.name, replaced_terms(PLANT, plant)) for plant, placed in models]
    # Viscous friction is the term itself; of the others two have most in common with it.
    assert named == [("quadratic_drag", ("damping",)), ("cubic_damping", ("damping",))]
    plant = models[0][0]
    assert plant.parameters["damping"] == 0.0
    assert plant.parameters["stiffness"] == fit.parameters["stiffness"]
    # Σ v² |v| / Σ v⁴ of a swing of amplitude A that decays with e^(-0.1 t), over its damping.
    speed = 5.0 * np.exp(-0.1 * record.time) * np.sin(5.0 * record.time)
    gain = 0.2 * np.sum(np.abs(speed) ** 3) / np.sum(speed**4)
    assert plant.parameters["quadratic_drag"] == pytest.approx(gain, rel=0.02)


def test_the_only_term_of_a_model_is_replaced_too():
    time = 0.1 * np.arange(200)
    record = eoi.Record(time, np.zeros((200, 0)), 2.0 / (1.0 + 0.3 * time), hold="zero",
                        output_names=("speed",), units={"speed": "rad/s"})  # fmt: skip
    plant = eoi.Plant(lambda t, x, u, p: -p.friction * x.y[0], {"friction": 0.1}, 1, inputs=(),
                      outputs=("speed",), units={"speed": "rad/s"})  # fmt: skip
    fit = refine_once(plant, (record,), None)
    judge = Judge.of((record,), plant)
    assert judge is not None
    models = replacements(Judged(fit, (), judge.runs(fit.plant)), [effects.QuadraticDrag()])
    assert [plant.fixed for plant, _ in models] == [("friction",)]


@pytest.mark.parametrize(("viscous", "count", "fixed"), [(0.0, 40, ("damping",)), (-0.3, 120, ())])
def test_a_term_is_left_out_whose_sign_noise_has_turned_beside_a_law(viscous, count, fixed):
    # Of a swing or two damping is -0.017 with a standard error of 0.009, and the rest unstable.
    # Where a swing is driven by what damps it, the negative sign is beyond doubt.
    part, other = (released(start, seed, viscous, 0.05)[:count]
                   for start, seed in ((1.0, 3), (0.9, 53)))  # fmt: skip
    judge = Judge.of((other,), PLANT)
    assert judge is not None
    search = Search.begun([PLANT], (part,), judge)
    assert search is not None
    law = place(PLANT, effects.CubicDamping(), 0)
    plant = augmented(search.base.refinement.plant, (law,), {"cubic_damping": 0.0})
    fit = search.fitted(plant, (law,), search.base)
    assert fit is not None
    assert fit.refinement.plant.fixed == fixed
    assert fit.refinement.parameters["damping"] == pytest.approx(viscous, abs=0.01)
    assert fit.refinement.parameters["cubic_damping"] == pytest.approx(0.05, rel=0.02)


def test_terms_stay_where_an_effect_without_parameter_has_turned_all_of_them(monkeypatch):
    # Cells in series may fit best with all signs turned; there is nothing to estimate without them.
    time = 0.1 * np.arange(300)
    flow = 1.0 + 0.5 * np.sin(time)[:, None]
    plant = eoi.Plant(lambda t, x, u, p: p.renewal * u * (1.0 - x.y[0]), {"renewal": 0.5}, 1,
                      inputs=("flow",), outputs=("temperature",))  # fmt: skip
    level = 1.0 - np.exp(-0.5 * (time + 0.5 - 0.5 * np.cos(time)))
    record = eoi.Record(time, flow, level, hold="linear", input_names=("flow",),
                        output_names=("temperature",))  # fmt: skip
    judge = Judge.of((record,), plant)
    assert judge is not None
    search = Search.begun([plant], (record,), judge)
    assert search is not None
    turned = lambda base, model: ("renewal",)  # noqa: E731
    monkeypatch.setattr("eoi_jax.discovery.free_run_trials.turned_terms", turned)
    cells = place(plant, effects.CellsInSeries(), 0, through=0)
    fit = search.fitted(
        augmented(search.base.refinement.plant, (cells,), {}), (cells,), search.base
    )
    assert fit is not None
    assert fit.placed == (cells,)
    assert fit.refinement.plant.fixed == ()


TANK = eoi.Plant(lambda t, x, u, p: p.gain * u - p.decay * x.y[0] + p.level,
                 {"gain": 1.0, "decay": 0.5, "level": 0.5}, 1, inputs=("flow",),
                 outputs=("height",))  # fmt: skip


def tank_search(cubic, level):
    """Two tanks whose outflow may grow with the cube of the height, and a search on them."""
    law, parts = place(TANK, effects.CubicDamping(), 0), []
    true = TANK.with_parameters({"gain": 2.0, "decay": 0.5, "level": level})
    true = augmented(true, (law,), {"cubic_damping": cubic})
    for seed in (1, 2):
        draw, time = np.random.default_rng(seed), 0.1 * np.arange(300)
        flow = np.repeat(draw.uniform(0.5, 2.0, 10), 30)
        height = eoi.simulate(true, time, flow, hold="zero").outputs
        noisy = height + 2e-3 * draw.standard_normal(height.shape)
        parts.append(eoi.Record(time, flow, noisy, hold="zero", input_names=("flow",),
                                output_names=("height",)))  # fmt: skip
    judge = Judge.of((parts[1],), TANK)
    assert judge is not None
    search = Search.begun([TANK], (parts[0],), judge)
    assert search is not None
    return search, law


def test_a_turned_term_stays_where_it_predicts_better(monkeypatch):
    # A level may have either sign: that effects have turned it is no reason to leave it out.
    search, law = tank_search(0.3, -0.4)
    turned = lambda base, model: ("level",)  # noqa: E731
    monkeypatch.setattr("eoi_jax.discovery.free_run_trials.turned_terms", turned)
    plant = augmented(search.base.refinement.plant, (law,), {"cubic_damping": 0.0})
    fit = search.fitted(plant, (law,), search.base)
    assert fit is not None
    assert fit.refinement.plant.fixed == ()
    assert fit.refinement.parameters["level"] == pytest.approx(-0.4, abs=0.05)


def test_a_term_is_there_again_when_the_effect_in_its_place_goes():
    search, law = tank_search(0.3, 0.8)
    offset = place(TANK, effects.ConstantOffset(), 0)
    plant = augmented(search.base.refinement.plant, (law, offset),
                      {"cubic_damping": 0.0, "constant_offset": 0.5})  # fmt: skip
    model = search.fitted(plant.declared_anew({"level": 0.0}, fixed=("level",)),
                          (law, offset), search.base)  # fmt: skip
    assert model is not None
    assert replaced_terms(TANK, model.refinement.plant) == ("level",)
    leanest = search.leanest(model)
    assert leanest.placed == (law,)
    assert leanest.refinement.plant.fixed == ()
    assert leanest.refinement.parameters["level"] == pytest.approx(0.8, abs=0.05)


ROOM = eoi.Plant(lambda t, x, u, p: p.heating * u[0] - p.loss * (x.y[0] - u[1]),
                 {"heating": 0.1, "loss": 0.05}, 1, inputs=("power", "outdoor"),
                 outputs=("indoor",), units={"indoor": "°C", "outdoor": "°C"})  # fmt: skip


def inhabited_room(seed, losses):
    """Eight days of a room by hours, heated twice a day; what people do is not recorded."""
    draw, time = np.random.default_rng(seed), np.arange(192.0)
    hour = time % 24.0
    heated = ((hour > 6.0) & (hour < 9.0)) | ((hour > 15.0) & (hour < 23.0))
    power = np.where(heated, 1.5 + 0.3 * draw.standard_normal(192), 0.0)
    outdoor = np.repeat(draw.uniform(0.0, 10.0, 16), 12)
    people = np.zeros(192)
    for k in range(1, 192):
        people[k] = 0.9 * people[k - 1] + 0.436 * draw.standard_normal()
    true = augmented(ROOM.with_parameters({"heating": 1.0, "loss": 0.05}), losses,
                     {"leak": 0.6, "constant_offset": 0.6 * 18.0})  # fmt: skip
    driven = np.column_stack([power + 0.3 * people, outdoor])
    indoor = eoi.simulate(true, time, driven, hold="zero", initial=[[17.0]]).outputs
    return eoi.Record(time, np.column_stack([power, outdoor]), indoor, hold="zero",
                      input_names=ROOM.inputs, output_names=ROOM.outputs,
                      units=ROOM.units)  # fmt: skip


@pytest.mark.slow
@pytest.mark.long
def test_a_loss_to_a_level_that_nothing_measures_is_no_second_store():
    # To the neighbours at 18 °C goes twelve times as much heat for each kelvin as to the outdoors.
    losses = [place(ROOM, kind(), 0) for kind in (effects.Leak, effects.ConstantOffset)]
    records = [inhabited_room(seed, losses) for seed in (2, 52)]
    tried = [effects.Leak(), effects.ConstantOffset(), effects.Radiation(), effects.InputRate(),
             effects.SecondNode(), effects.Product("u", "y"), effects.Product("y", "y"),
             effects.InputDelay(), effects.ActuatorLag()]  # fmt: skip
    answer = search_free_runs([ROOM], [((records[0],), (records[1],))], tried)
    assert answer is not None
    assert {at.effect.name for at in answer.best.placed} == {"leak", "constant_offset"}
    values = answer.best.refinement.parameters
    assert values["constant_offset"] / values["leak"] == pytest.approx(18.0, abs=1.0)


def furnished_room(seed, lacking, values):
    """150 hours of a room whose outdoor temperature changes slowly, with noise of half a kelvin."""
    draw, time = np.random.default_rng(seed), 0.5 * np.arange(300.0)
    power = np.repeat(draw.choice([0.0, 8.0, 20.0], 16), 20)[:300]
    outdoor = np.repeat(draw.uniform(0.0, 10.0, 13), 24)[:300]
    inputs = np.column_stack([power, np.convolve(outdoor, np.ones(8) / 8.0, mode="same")])
    true = augmented(ROOM, [place(ROOM, kind(), 0) for kind in lacking], values)
    indoor = eoi.simulate(true, time, inputs, hold="zero", initial=[[17.0]]).outputs
    noise = 0.5 * draw.standard_normal(indoor.shape)
    return eoi.Record(time, inputs, indoor + noise, hold="zero", input_names=ROOM.inputs,
                      output_names=ROOM.outputs, units=ROOM.units)  # fmt: skip


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize(
    ("lacking", "values", "names"),
    [
        # Its time constant is 200 hours: the injection takes it for a level.
        ([effects.SecondNode], {"second_node_exchange": 0.2, "second_node_rate": 0.005},
         {"second_node"}),
        ([effects.Leak, effects.ConstantOffset], {"leak": 0.3, "constant_offset": 5.4},
         {"leak", "constant_offset"}),
    ],
)  # fmt: skip
def test_a_store_that_warms_slowly_is_no_level_and_a_level_no_store(lacking, values, names):
    fit, held = (furnished_room(seed, lacking, values) for seed in (3, 53))
    found = eoi.discover(ROOM, fit, validation=held)
    assert set(found.effects) == names


def test_the_level_of_such_a_loss_is_told():
    def added(kind, name, value):
        return Added(kind(), "indoor", {name: value}, {name: 0.01 * value}, "")

    leak, offset = added(effects.Leak, "leak", 0.6), added(effects.ConstantOffset, "offset", 10.8)
    (note,) = level_notes(ROOM, [offset, leak])
    assert "a loss to a level of 18 °C" in note
    assert level_notes(ROOM, [leak]) == level_notes(ROOM, [offset]) == []


@pytest.mark.slow
def test_a_law_comes_in_place_of_a_term_that_held_out_records_do_not_need():
    best = searched(0.0, 0.05)
    assert [placed.effect.name for placed in best.placed] == ["cubic_damping"]
    assert replaced_terms(PLANT, best.refinement.plant) == ("damping",)
    assert best.refinement.parameters["cubic_damping"] == pytest.approx(0.05, rel=0.05)


@pytest.mark.slow
def test_beside_a_term_that_they_need_it_is_added():
    best = searched(0.1, 0.05)
    assert [placed.effect.name for placed in best.placed] == ["cubic_damping"]
    assert replaced_terms(PLANT, best.refinement.plant) == ()
    assert best.refinement.parameters["damping"] == pytest.approx(0.1, rel=0.1)


@pytest.mark.slow
def test_a_term_that_is_right_stays():
    best = searched(0.2, 0.0)
    assert best.placed == ()
    assert replaced_terms(PLANT, best.refinement.plant) == ()


CART = eoi.Plant(lambda t, x, u, p: p.gain * u, {"gain": 1.0}, 2, inputs=("drive",),
                 outputs=("position",))  # fmt: skip


def rolling_cart(seed, stiffness):
    """A cart whose drive has an offset, held back by friction; by SciPy, exact in each step."""
    draw, period, count = np.random.default_rng(seed), 0.05, 1200
    drive = np.repeat(draw.uniform(-1.0, 1.0, count // 12), 12) + 0.4
    pushed = 60.0 * drive - 23.0
    system = np.array([[0.0, 1.0, 0.0], [-stiffness, -8.0, 1.0], [0.0, 0.0, 0.0]])
    step, state = expm(system * period), np.zeros(3)
    position = np.zeros((count, 1))
    for k in range(count):
        position[k], state[2] = state[0], pushed[k]
        state = step @ state
    noise = 0.02 * draw.standard_normal((count, 1))
    return eoi.Record(period * np.arange(count), drive, position + noise, hold="zero",
                      input_names=CART.inputs, output_names=CART.outputs)  # fmt: skip


@pytest.mark.parametrize("stiffness", [0.0, 3.0])
def test_friction_and_an_offset_are_found_where_neither_alone_helps(stiffness):
    """Free runs of a double integrator under a biased drive say nothing of its gain."""
    true = {"gain": 60.0, "viscous_friction": 8.0, "constant_offset": -23.0}
    if stiffness:
        true["linear_stiffness"] = stiffness
    tried = [effects.ViscousFriction(), effects.ConstantOffset(), effects.LinearStiffness()]
    fit, judging = (rolling_cart(seed, stiffness) for seed in (1, 2))
    answer = search_free_runs([CART], [((fit,), (judging,))], tried)
    assert answer is not None
    assert answer.best.refinement.parameters == pytest.approx(true, rel=0.03)
