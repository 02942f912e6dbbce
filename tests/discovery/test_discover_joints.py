"""Springs and stops between two masses: effects that see the difference of two outputs."""

import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import pytest
from problems import noisy

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.models.equations.display import equation_latex, equation_text
from eoi_jax.report.discovery import phrase

mpl.use("Agg")

STEP, SAMPLES, NOISE = 4e-3, 5000, 1e-3
HARD = 6e4  # N/m³, of the spring between masses of 1 and 0.6 kg
FEW = ("cubic_stiffness", "quadratic_stiffness", "free_play", "coulomb_friction", "quadratic_drag")


def pulled(t, x, u, p):
    (one, two), (v1, v2) = x.y
    pull = p.k * (one - two) + p.c * (v1 - v2)
    return jnp.stack([p.b * u[0] - p.k1 * one - p.c1 * v1 - pull, p.ratio * pull])


PLANT = eoi.Plant(
    pulled,
    {"b": 1.2, "k1": 50.0, "c1": 1.0, "k": 170.0, "c": 1.0, "ratio": 2.0},
    2,
    inputs=("F",),
    outputs=("near", "far"),
    units={"F": "N", "near": "m", "far": "m"},
)


def rate(x: np.ndarray, u: float, hard: float, rebound: float) -> np.ndarray:
    one, two, v1, v2 = x
    pull = 200.0 * (one - two) + hard * (one - two) ** 3
    pull += 1.2 * (v1 - v2) + rebound * abs(v1 - v2)
    return np.array([v1, v2, u - 60.0 * one - 0.8 * v1 - pull, pull / 0.6])


def record(seed: int, hard: float = HARD, rebound: float = 0.0) -> eoi.Record:
    """Inputs held over each sample; the classical Runge-Kutta rule, four steps a sample."""
    draw, time = np.random.default_rng(seed), STEP * np.arange(SAMPLES)
    lines = 2.0 * np.pi * draw.uniform(0.2, 5.0, 14)
    force = 3.0 * np.sum(np.sin(np.outer(time, lines) + draw.uniform(0.0, 6.3, 14)), axis=1)
    x, states, h = np.zeros(4), [], STEP / 4
    for u in force:
        states.append(x[:2])
        for _ in range(4):
            a = rate(x, u, hard, rebound)
            b = rate(x + 0.5 * h * a, u, hard, rebound)
            c = rate(x + 0.5 * h * b, u, hard, rebound)
            d = rate(x + h * c, u, hard, rebound)
            x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    return eoi.Record(
        time, force[:, None], noisy(np.asarray(states), NOISE, draw), f"run {seed}", hold="zero",
        input_names=PLANT.inputs, output_names=PLANT.outputs,
    )  # fmt: skip


@pytest.fixture(scope="module")
def found() -> eoi.Discovery:
    return eoi.discover(PLANT, record(1), record(2), FEW)


def test_spring_between_two_masses_is_named_at_both(found):
    assert found.effects == ("cubic_stiffness",)
    assert [(one.output, one.against) for one in found.added] in (
        [("near", "far"), ("far", "near")],
        [("far", "near"), ("near", "far")],
    )
    values = found.plant.parameters
    assert values["cubic_stiffness_near_far"] == pytest.approx(HARD, rel=0.01)
    assert values["cubic_stiffness_far_near"] == pytest.approx(HARD / 0.6, rel=0.01)
    assert values["k"] == pytest.approx(200.0, rel=0.01)
    noise = NOISE * np.std(record(2).outputs, axis=0)
    assert np.all(found.after.rmse < 1.2 * noise)


def test_it_is_told_as_one_between_two(found):
    near = next(one for one in found.added if one.output == "near")
    assert "at near towards far of 6" in phrase(found, near)
    assert "- cubic_stiffness_near_far·(near - far)³" in equation_text(PLANT, found.added)
    cube = r"\left(\mathrm{near} - \mathrm{far}\right)^{3}"
    assert cube in equation_latex(PLANT, [near])
    assert {one.against for one in found.ranking if one.effect == "free_play"} == {
        "", "near", "far",
    }  # fmt: skip
    assert {one.against for one in found.ranking if one.effect == "coulomb_friction"} == {""}


@pytest.mark.slow
def test_a_damper_with_two_rates_between_two_masses_is_named_at_both():
    """A shock absorber: what it takes when pulled differs from what it takes when pushed."""
    run, test = (record(seed, hard=0.0, rebound=0.7) for seed in (3, 4))
    answer = eoi.discover(PLANT, run, test, [*FEW, effects.AsymmetricViscousFriction()])
    assert answer.effects == ("asymmetric_friction",)
    assert {(one.output, one.against) for one in answer.added} == {("near", "far"), ("far", "near")}
    values = answer.plant.parameters
    assert values["asymmetric_friction_slope_near_far"] == pytest.approx(0.7, rel=0.03)
    assert values["asymmetric_friction_slope_far_near"] == pytest.approx(-0.7 / 0.6, rel=0.03)
    assert values["c"] == pytest.approx(1.2, rel=0.03)


def test_it_is_drawn_against_the_difference(found):
    figure = found.plot()
    labels = {axes.get_xlabel() for axes in figure.get_axes()}
    assert {"near - far [m]", "far - near [m]"} <= labels


@pytest.mark.slow
def test_the_free_run_shows_it_too():
    refined = eoi.refine(PLANT, record(1), window=2.0)
    left = eoi.remaining(refined, [effects.CubicStiffness(), effects.QuadraticDrag()])
    best = left.ranking[0].placed[0]
    assert (best.effect.name, best.against is None) == ("cubic_stiffness", False)
