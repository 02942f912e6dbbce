"""A gain of an input that follows the past of an input, against closed forms and SciPy."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lfilter

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery.free_run_search import search_free_runs
from eoi_jax.estimation.online_inputs import DrivenInputs
from eoi_jax.models.augmented import augmented
from eoi_jax.models.equations.display import equation_text
from eoi_jax.models.placements import placed_label, placements
from eoi_jax.simulation.validate import validate

H, LAG, DEPTH = 1.0, 30.0, -0.05
EFFECT, SHARED = effects.InputModulation(), effects.InputModulation(shared=True)


def reservoir(t, x, u, p):
    return (p.runoff * u[0] + p.base - x.y[0]) / p.tau


PLANT = eoi.Plant(
    reservoir, {"runoff": 20.0, "base": 4.0, "tau": 6.0}, 1, ("rain", "warmth"), ("flow",),
    units={"rain": "mm/d", "warmth": "K", "flow": "m³/s"},
)  # fmt: skip


def weather(seed, count=700):
    """Showers, and a warmth with a season and days of its own."""
    draw = np.random.default_rng(seed)
    rain = draw.exponential(8.0, count) * (draw.uniform(size=count) < 0.3)
    season = 9.0 - 8.0 * np.cos(2.0 * np.pi * (np.arange(count) + draw.uniform(0, 365)) / 365.0)
    return rain, season + lfilter([1.0], [1.0, -0.8], draw.standard_normal(count))


def measured(seed, depth=DEPTH, noise=0.5, share=0.0):
    """Discharge of held rain, exact; the ground dries in warm weeks, and rain may wet it."""
    rain, warmth = weather(seed)
    decay, past = np.exp(-H / LAG), np.zeros(len(rain))
    drives = warmth + share * rain
    z = drives[0]
    for i, w in enumerate(drives):
        past[i] = w + (z - w) * LAG / H * (1.0 - decay)  # mean of the lag over the day
        z = w + (z - w) * decay
    pushed = 20.0 * rain * np.maximum(1.0 + depth * past, 0.0) + 4.0
    keep = np.exp(-H / 6.0)
    flow = lfilter([0.0, 1.0 - keep], [1.0, -keep], pushed - pushed[0]) + pushed[0]
    flow += noise * np.random.default_rng(seed + 100).standard_normal(len(flow))
    return eoi.Record.from_period(
        H, np.stack([rain, warmth], 1), flow, hold="zero", input_names=("rain", "warmth"),
        output_names=("flow",), units=dict(PLANT.units),
    )  # fmt: skip


@pytest.mark.parametrize("lag", [1e-3, 0.4, 30.0])
def test_along_a_record_numpy_and_jax_agree(lag):
    u = np.stack(weather(0, 200), axis=1)
    time, shapes = np.arange(200.0), np.array([[DEPTH, lag]])
    sampled = EFFECT.sampled(time, u, shapes)[0]
    along = EFFECT.along(jnp.asarray(time), jnp.asarray(u), shapes[0])
    np.testing.assert_allclose(along, sampled, rtol=1e-12, atol=1e-12)


def test_a_share_of_the_input_itself_moves_the_store_too():
    rain, warmth = weather(0, 200)
    time = np.arange(200.0)
    both = np.stack([rain, warmth - 3.0 * rain], axis=1)
    expected = EFFECT.sampled(time, both, np.array([[DEPTH, LAG]]))
    got = SHARED.sampled(time, np.stack([rain, warmth], axis=1), np.array([[DEPTH, LAG, -3.0]]))
    np.testing.assert_allclose(got, expected, rtol=1e-12)


def test_behind_a_driver_that_does_not_move_it_is_a_gain_that_ends_at_zero():
    time, u = np.arange(50.0), np.stack([np.arange(50.0), np.full(50, 4.0)], axis=1)
    for depth in (-0.1, 0.3, -0.5):
        changed = EFFECT.sampled(time, u, np.array([[depth, 7.0]]))[0]
        np.testing.assert_allclose(changed, max(1.0 + 4.0 * depth, 0.0) * u[:, 0])


def test_each_input_may_drive_each_one():
    placed = placements(PLANT, [EFFECT])
    assert [(item.channel, item.through) for item in placed] == [(0, 0), (0, 1), (1, 0), (1, 1)]
    shared = placements(PLANT, [SHARED])
    assert [(item.channel, item.through) for item in shared] == [(0, 1), (1, 0)]
    assert placed_label(PLANT, placed[1]) == "input_modulation at rain beside warmth"
    plant = augmented(PLANT, placed[1:2], dict(zip(placed[1].names, (DEPTH, LAG), strict=True)))
    depth, lag = placed[1].names
    assert (plant.units[depth], plant.units[lag]) == ("1/(K)", "s")


def test_the_simulated_plant_is_the_exact_one():
    """But for the start: the gain is held over a day, as the rain is, in both."""
    placed = placements(PLANT, [EFFECT])[1:2]
    plant = augmented(PLANT, placed, dict(zip(placed[0].names, (DEPTH, LAG), strict=True)))
    runs = validate(plant, measured(1, noise=0.0))
    assert runs.nrmse[0] < 1e-3


def searched(depth, share=0.0):
    tried = [EFFECT, effects.ConstantOffset(), effects.InputSaturation()]
    records = [(measured(seed, depth, share=share),) for seed in (1, 2)]
    answer = search_free_runs([PLANT], [(records[0], records[1])], tried)
    assert answer is not None
    return answer


@pytest.mark.slow
@pytest.mark.long
def test_it_is_found_with_its_size_in_free_runs():
    answer = searched(DEPTH)
    (placed,) = answer.best.placed
    assert (placed.effect.name, placed.channel, placed.through) == (EFFECT.name, 0, 1)
    depth, lag = (answer.best.refinement.parameters[name] for name in placed.names[:2])
    assert depth == pytest.approx(DEPTH, rel=0.05)
    assert lag == pytest.approx(LAG, rel=0.2)


@pytest.mark.slow
@pytest.mark.long
def test_the_form_in_which_both_move_the_store_is_found_from_the_first():
    answer = searched(DEPTH, share=-1.5)
    (placed,) = answer.best.placed
    assert placed.effect == SHARED
    values = [answer.best.refinement.parameters[name] for name in placed.names]
    assert values == pytest.approx([DEPTH, LAG, -1.5], rel=0.15)


@pytest.mark.slow
@pytest.mark.long
def test_a_gain_that_does_not_change_gets_none():
    assert searched(0.0).best.placed == ()


def test_an_equation_names_the_input_with_its_driver():
    placed = placements(PLANT, [EFFECT])[1]
    item = SimpleNamespace(
        effect=EFFECT, output="rain", against="", through="warmth",
        parameters=dict.fromkeys(placed.names, 1.0),
    )  # fmt: skip
    written = f"input_modulation(rain, warmth, {', '.join(placed.names)})"
    assert written in equation_text(PLANT, [item])


def test_it_is_not_run_sample_by_sample():
    placed = placements(PLANT, [EFFECT])[1:2]
    plant = augmented(PLANT, placed, dict(zip(placed[0].names, (DEPTH, LAG), strict=True)))
    with pytest.raises(ValueError, match="`effect input_modulation` must act on one input alone"):
        DrivenInputs(plant, np.asarray(plant.theta), H, np.eye(len(plant.names)), (True,))
