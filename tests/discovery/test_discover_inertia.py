"""Friction of one of two masses that are coupled by inertia: a trolley with a load that swings."""

from dataclasses import replace
from functools import partial

import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import pytest
from problems import noisy, stiff_response

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery.confirm import as_good
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.equations.display import equation_latex, equation_text
from eoi_jax.models.plant import State
from eoi_jax.refinement.score_test import LinearisedRuns
from eoi_jax.refinement.spans import spans_of
from eoi_jax.report.discovery import candidate_rows, phrase

mpl.use("Agg")

STEP, SAMPLES, NOISE = 4e-3, 5000, 1e-3
DRY, WIDTH = 1.2, 1e-4  # N; m/s, of the tanh that stands for the sign
LOAD = 0.3  # kg
FEW = ("coulomb_friction", "stribeck_friction", "quadratic_drag", "constant_offset", "free_play")


def crane(t, x, u, p):
    (_, angle), (speed, turn) = x.y
    sine, cosine = jnp.sin(angle), jnp.cos(angle)
    push = u[0] - p.c * speed + LOAD * p.l * turn**2 * sine
    fall = -9.81 * LOAD * sine - p.d * turn
    inertia = LOAD * p.l * (p.m - LOAD * cosine**2)
    return (
        jnp.stack([LOAD * p.l * (push - cosine * fall), p.m * fall - LOAD * cosine * push])
        / inertia
    )


PLANT = eoi.Plant(
    crane,
    {"c": 1.5, "m": 1.1, "l": 0.5, "d": 0.02},
    2,
    inputs=("force",),
    outputs=("trolley", "angle"),
    units={"force": "N", "trolley": "m", "angle": "rad"},
)


def rate(x: np.ndarray, force: float, dry: float) -> list[float]:
    """Lagrange's equations of both, solved for the accelerations by Cramer's rule."""
    _, angle, speed, turn = x
    length, mass = 0.4, 1.3
    a, b, c = mass, LOAD * length * np.cos(angle), LOAD * length**2
    first = force - 2.0 * speed - dry * np.tanh(speed / WIDTH)
    first += LOAD * length * turn**2 * np.sin(angle)
    second = -LOAD * 9.81 * length * np.sin(angle) - 0.01 * length * turn
    size = a * c - b * b
    return [speed, turn, (c * first - b * second) / size, (a * second - b * first) / size]


def record(seed: int, dry: float = DRY) -> eoi.Record:
    """A force held over each sample; a stiff solver in between."""
    draw, time = np.random.default_rng(seed), STEP * np.arange(SAMPLES)
    lines = 2.0 * np.pi * draw.uniform(0.2, 2.0, 6)
    force = 1.5 * np.sum(np.sin(np.outer(time, lines) + draw.uniform(0.0, 6.3, 6)), axis=1)
    y = stiff_response(partial(rate, dry=dry), force, STEP, tolerance=1e-7)[:, :2]
    return eoi.Record(
        time, force[:, None], noisy(y, NOISE, draw), f"run {seed}", hold="zero",
        input_names=PLANT.inputs, output_names=PLANT.outputs,
    )  # fmt: skip


# Three joints, each with a dry friction: more than the simulator can hold at rest together.
INERTIA = np.array([[2.0, 0.9, 0.3], [0.9, 1.2, 0.5], [0.3, 0.5, 0.8]])
INVERSE = np.linalg.inv(INERTIA)
ROBOT = eoi.Plant(
    lambda t, x, u, p: jnp.linalg.solve(INERTIA, u - p.k * x.y[0] - p.c * x.y[1]),
    {"k": 4.0, "c": 0.3},
    2,
    inputs=("a", "b", "c"),
    outputs=("one", "two", "three"),
)


def robot_record(seed: int) -> eoi.Record:
    draw, time = np.random.default_rng(seed), 5e-3 * np.arange(3000)
    lines = 2.0 * np.pi * draw.uniform(0.2, 2.0, (3, 6))
    phases = draw.uniform(0.0, 6.3, (3, 6))
    torques = 1.2 * np.sum(np.sin(time[:, None, None] * lines + phases), axis=2)

    def rate(x: np.ndarray, u: np.ndarray) -> list[float]:
        dry = np.array([0.8, 0.5, 0.4]) * np.tanh(x[3:] / WIDTH)
        return [*x[3:], *(INVERSE @ (u - 3.5 * x[:3] - 0.2 * x[3:] - dry))]

    y = stiff_response(rate, torques, 5e-3, states=6, tolerance=1e-7)[:, :3]
    return eoi.Record(
        time, torques, noisy(y, NOISE, draw), f"run {seed}", hold="zero",
        input_names=ROBOT.inputs, output_names=ROBOT.outputs,
    )  # fmt: skip


@pytest.fixture(scope="module")
def fit() -> eoi.Record:
    return record(1)


@pytest.fixture(scope="module")
def held_out() -> eoi.Record:
    return record(2)


@pytest.fixture(scope="module")
def found(fit, held_out) -> eoi.Discovery:
    return eoi.discover(PLANT, fit, held_out, FEW)


@pytest.mark.slow
def test_friction_of_the_trolley_acts_on_the_load_too(found, held_out):
    assert found.effects == ("coulomb_friction",)
    (one,) = found.added
    assert (one.output, one.against, one.through) == ("trolley", "", "force")
    assert found.plant.parameters["coulomb_friction_trolley_force"] == pytest.approx(DRY, rel=2e-3)
    for name, true in {"c": 2.0, "m": 1.3, "l": 0.4, "d": 0.01}.items():
        assert found.plant.parameters[name] == pytest.approx(true, rel=2e-3)
    # What is left is what a tanh of this width creeps while the plant sticks, and noise.
    assert np.all(found.after.rmse < 0.02 * found.before.rmse)
    assert np.all(found.windows_after.rmse < 2.0 * NOISE * np.std(held_out.outputs, axis=0))


@pytest.mark.slow
def test_it_is_told_as_a_force_beside_the_input(found):
    (one,) = found.added
    assert phrase(found, one).startswith("Coulomb (dry) friction at trolley beside force of 1.2")
    assert phrase(found, one).endswith(" N")
    assert found.plant.units["coulomb_friction_trolley_force"] == "N"
    line = "with force → force - coulomb_friction_trolley_force·sign(trolley')"
    assert line in equation_text(PLANT, found.added)
    assert r"\mathrm{force} \to \mathrm{force} - " in equation_latex(PLANT, found.added)
    places = {row[1] for row in candidate_rows(found)[1:] if row[0] == "coulomb_friction"}
    assert places == {"trolley", "angle", "angle beside force"}
    assert len(found.plot().get_axes()) > 0


def test_a_trolley_without_friction_gets_none():
    found = eoi.discover(PLANT, record(3, dry=0.0), record(4, dry=0.0), FEW)
    assert found.effects == ()
    assert found.status.code == "nothing_missing"


@pytest.mark.slow
def test_a_narrow_spike_is_no_better_than_one_level_in_free_runs(found):
    (spike,) = (
        one for one in found.ranking if one.effect == "stribeck_friction" and one.through
        and one.output == "trolley"
    )  # fmt: skip
    (level,) = (
        one for one in found.ranking if one.effect == "coulomb_friction" and one.through
        and one.output == "trolley"
    )  # fmt: skip
    assert spike.explained >= level.explained
    assert spike.remark == "in free runs no better than a simpler law"
    (note,) = (one for one in found.notes if one.endswith("do no better in free runs"))
    assert note.startswith("stribeck_friction would take ")
    assert 0.9 < found.explained <= spike.explained  # that of the level, not of the spike
    assert f"{found.explained:.1%}" in found.status.message


@pytest.mark.slow
def test_a_wider_law_is_kept_where_a_free_run_is_better_with_it(found):
    before, after = ((found.before, None), (found.after, found.windows_after))
    assert as_good(after, after)
    assert as_good((found.after, None), before)
    assert not as_good(before, (found.after, None))
    # Whole runs that diverge with both laws say nothing; the short ones decide.
    lost = replace(found.after, rmse=np.full(2, np.inf))
    assert as_good((lost, found.windows_after), (lost, found.windows_after))
    assert not as_good((lost, found.windows_before), (lost, found.windows_after))


@pytest.mark.slow
def test_frictions_without_a_free_run_are_told_and_not_added():
    found = eoi.discover(ROBOT, robot_record(1), robot_record(2), ["coulomb_friction"])
    assert found.status.code == "unexplained"
    assert "no free run has them" in found.status.message
    assert found.effects == ()
    (note,) = (one for one in found.notes if one.startswith("refused"))
    assert "no more than two outputs whose dry frictions act on each other" in note
    at = {(one.output, one.through) for one in found.ranking if "cannot be sim" in one.remark}
    assert at == {("one", "a"), ("two", "b"), ("three", "c")}


@pytest.mark.slow
def test_free_runs_show_it_too(fit):
    refined = eoi.refine(PLANT, fit, window=1.0)
    left = eoi.remaining(refined, [effects.CoulombFriction(), effects.QuadraticDrag()])
    best = left.ranking[0].placed[0]
    assert (best.effect.name, best.output, best.through) == ("coulomb_friction", 0, 0)


def test_it_is_a_change_of_the_input():
    one = place(PLANT, effects.QuadraticDrag(), 0, None, 0)
    assert one.names == ("quadratic_drag_trolley_force",)
    whole = augmented(PLANT, [one], {one.names[0]: 0.7})
    y, force = jnp.array([[0.1, 0.4], [-0.3, 0.8]]), jnp.array([1.1])
    x = State(y, jnp.zeros(0))
    changed = force + 0.7 * 0.3 * 0.3  # the trolley goes backwards
    ours = whole.derivative(jnp.zeros(()), x, force, jnp.asarray(whole.theta))
    theirs = PLANT.derivative(jnp.zeros(()), x, changed, jnp.asarray(PLANT.theta))
    np.testing.assert_allclose(ours, theirs, rtol=1e-12)


@pytest.mark.parametrize(
    ("effect", "through", "small"),
    [(effects.QuadraticDrag(), 0, 1e-5), (effects.InputDeadZone(), None, 1e-5)],
    ids=["drag of the trolley", "dead zone of the force"],
)
def test_a_small_force_moves_both_outputs_of_a_free_run(effect, through, small):
    """The response to it against the difference of two simulations."""
    plant = PLANT.with_parameters(np.array([2.0, 1.3, 0.4, 0.01]))
    time = STEP * np.arange(500)
    force = 2.0 * np.sin(3.0 * time) + 0.5 * np.sin(9.0 * time + 1.0)
    straight = eoi.simulate(plant, time, force, substeps=2, hold="zero")
    refined = eoi.refine(plant, straight, substeps=2)
    one = place(plant, effect, 0, None, through)
    changed = augmented(refined.plant, [one], {one.names[0]: small})
    moved = eoi.simulate(changed, time, force, substeps=2, hold="zero").outputs
    along = LinearisedRuns.of(refined, refined.records, spans_of(refined.records, None), 2)
    shape = np.zeros(0) if effect.gains else np.array([small])
    (own,) = along.forces(one, np.atleast_2d(shape))
    slopes = np.sum([along.response.to(own[..., k, None], k) for k in range(2)], axis=0)[0, ..., 0]
    expected = (moved - straight.outputs) / (small if effect.gains else 1.0)
    assert np.all(
        np.max(np.abs(slopes - expected), axis=0) < 0.01 * np.max(np.abs(expected), axis=0)
    )
    assert np.all(np.max(np.abs(expected), axis=0) > 0.0)
