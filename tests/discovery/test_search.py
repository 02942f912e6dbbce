"""The search over sets of effects, on columns made by hand; fits, candidates, noise model."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery.candidates import CandidateColumns, atoms, seen_at
from eoi_jax.discovery.cosine_modes import modal_record
from eoi_jax.discovery.noise_spectrum import expected_power, fitted_power, local_power
from eoi_jax.discovery.regression import (
    Base,
    Fit,
    Span,
    fitted,
    refined,
    solve,
    within_bounds,
)
from eoi_jax.discovery.search import RankedSets, Scores, SearchProblem, _span, search_sets
from eoi_jax.models.augmented import Placed
from eoi_jax.models.effects.effect import AbstractEffect
from eoi_jax.models.placements import placements

ROWS = 600
NOISE = 0.1  # of each row, standard deviation


def columns(seed: int, count: int) -> np.ndarray:
    """Columns of length one a row, orthogonal to each other."""
    q, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((ROWS, count)))
    return q * np.sqrt(ROWS)


def named(effect: AbstractEffect) -> Placed:
    return Placed(effect, 0, tuple(f"p{i}" for i in range(len(effect.parameters))))


def atom(
    effect: AbstractEffect, own: np.ndarray, shape: tuple[float, ...] = ()
) -> CandidateColumns:
    return CandidateColumns(named(effect), shape, np.reshape(own, (ROWS, -1)), None)


def base(target: np.ndarray, declared: np.ndarray, seed: int = 9) -> Base:
    """A declared model that lacks `target`, at wrong parameters, with noise in each row."""
    noise = NOISE * np.random.default_rng(seed).standard_normal(ROWS)
    whole = target + declared @ np.array([0.3, -0.2]) + noise
    return Base(
        whole,
        declared,
        np.arange(2),
        np.full(ROWS, NOISE**2),
        np.full(ROWS, 4.0),  # y^(r) is larger than what is lacking
        np.zeros(ROWS, int),
    )


def no_shapes(placed: Placed, shapes: np.ndarray) -> list[CandidateColumns]:
    raise AssertionError("an effect without shapes has nothing to refine")


def search_all(
    known: Base, grid: list[CandidateColumns], make: Callable, alpha: float = 0.01
) -> RankedSets:
    lacking = known.signal_power(fitted(known, [], np.ones(ROWS)).residual)
    return search_sets(SearchProblem(known, tuple(grid), alpha, 3, len(grid), lacking), make)


def search(
    known: Base, grid: list[CandidateColumns], make: Callable = no_shapes, alpha: float = 0.01
) -> tuple[Scores, Fit]:
    found = search_all(known, grid, make, alpha)
    return found.scores, found.sets[0]


def names(fit: Fit) -> set[str]:
    return {one.placed.effect.name for one in fit.atoms}


# -- one set --------------------------------------------------------------------------------------


def test_fit_is_the_weighted_least_squares_of_all_columns():
    parts = columns(0, 4)
    power = np.random.default_rng(1).uniform(0.5, 2.0, ROWS)
    known = base(0.7 * parts[:, 2], parts[:, :2])
    fit = fitted(known, [atom(effects.PositionRipple(), parts[:, 2:], (3.0,))], power)
    weight = 1.0 / np.sqrt(power)
    expected = np.linalg.lstsq(parts * weight[:, None], known.target * weight, rcond=None)[0]
    np.testing.assert_allclose(fit.theta, expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(fit.residual, known.target - parts @ expected, atol=1e-10)
    assert fit.cost == pytest.approx(float(np.sum(fit.residual**2 / power)))
    np.testing.assert_allclose(fit.gains[0], expected[2:])


def test_solution_leaves_a_direction_without_trace_alone():
    random = np.random.default_rng(0)
    matrix = random.standard_normal((50, 2)) @ np.array([[1.0, 0.0, 2.0], [0.0, 0.0, 1e6]])
    target = matrix @ np.array([1.0, 5.0, 1.0])
    theta = solve(matrix, target)
    assert theta[1] == 0.0
    np.testing.assert_allclose(matrix @ theta, target, rtol=1e-6)


def test_gain_outside_its_bounds_is_not_physical():
    parts = columns(0, 3)
    friction, spring = effects.CoulombFriction(), effects.CubicStiffness()
    known = base(-0.7 * parts[:, 2], parts[:, :2])
    assert not fitted(known, [atom(friction, parts[:, 2])], np.ones(ROWS)).physical
    assert fitted(known, [atom(spring, parts[:, 2])], np.ones(ROWS)).physical


def test_a_set_within_bounds_is_the_least_squares_of_what_they_leave():
    parts = columns(0, 3)
    known = replace(base(0.7 * parts[:, 2], parts[:, :2] + 0.3 * parts[:, 2:]),
                    room=(np.array([-1.0, -0.1]), np.ones(2)))  # fmt: skip
    fit = fitted(known, [atom(effects.CoulombFriction(), parts[:, 2])], np.ones(ROWS))
    np.testing.assert_allclose(fit.theta[:2], [0.3, -0.2], atol=0.02)
    kept = within_bounds(known, fit, np.ones(ROWS))
    assert kept.theta[1] == -0.1
    beside = np.stack([known.columns[:, 0], parts[:, 2]], axis=1)
    rest = known.target + 0.1 * known.columns[:, 1]
    want, (square,), *_ = np.linalg.lstsq(beside, rest)
    np.testing.assert_allclose(kept.theta[[0, 2]], want, rtol=1e-9)
    assert kept.cost == pytest.approx(square)
    assert within_bounds(replace(known, room=(-np.ones(2), np.ones(2))), fit, np.ones(ROWS)) is fit


def test_column_that_overflows_is_no_answer():
    parts = columns(0, 3)
    parts[5, 2] = np.inf
    fit = fitted(
        base(parts[:, 1], parts[:, :2]), [atom(effects.Drift(), parts[:, 2])], np.ones(ROWS)
    )
    assert fit.cost == np.inf
    assert not fit.physical


def test_input_effect_replaces_the_declared_columns_and_comes_first():
    parts = columns(0, 5)
    known = base(parts[:, 2], parts[:, :2])
    changed = 0.5 * parts[:, 3] + 2.0 * parts[:, 4]
    delay = CandidateColumns(
        named(effects.InputDelay()), (0.1,), np.zeros((ROWS, 0)), changed, parts[:, 3:]
    )
    friction = atom(effects.CoulombFriction(), parts[:, 2])
    fit = fitted(known, [friction, delay], np.ones(ROWS))
    assert [one.placed.effect.name for one in fit.atoms] == ["input_delay", "coulomb_friction"]
    np.testing.assert_allclose(fit.theta, [0.5, 2.0, 0.0], atol=1e-10)
    assert fit.cost == pytest.approx(0.0, abs=1e-12)
    assert [len(gains) for gains in fit.gains] == [0, 1]


def test_shape_is_refined_between_the_points_of_the_grid():
    time = np.linspace(0.0, 20.0, ROWS)
    effect = effects.SinusoidalDisturbance()

    def make(placed: Placed, shapes: np.ndarray) -> list[CandidateColumns]:
        return [
            atom(effect, np.stack([np.sin(s * time), np.cos(s * time)], axis=1), (float(s),))
            for (s,) in shapes
        ]

    known = base(0.5 * np.sin(1.2345 * time + 0.3), columns(0, 2))
    start = fitted(known, make(named(effect), np.array([[1.3]])), np.full(ROWS, NOISE**2))
    span = Span(np.array([0.2]), np.array([0.5]), np.array([2.5]), (np.arange(0.6, 2.5, 0.2),))
    found = refined(known, start, np.full(ROWS, NOISE**2), {named(effect): span}, make)
    # Cramér-Rao: σ√12/(A T √(N/2)), about 2e-3 rad/s here.
    assert found.atoms[0].shape[0] == pytest.approx(1.2345, abs=8e-3)
    assert found.cost < start.cost


def test_refinement_stays_within_the_grid():
    time = np.linspace(0.0, 20.0, ROWS)
    effect = effects.Overflow()

    def make(placed: Placed, shapes: np.ndarray) -> list[CandidateColumns]:
        return [atom(effect, -np.exp(-s * time), (float(s),)) for (s,) in shapes]

    known = base(-0.9 * np.exp(-3.0 * time), columns(0, 2))
    start = fitted(known, make(named(effect), np.array([[1.0]])), np.full(ROWS, NOISE**2))
    span = Span(np.array([0.5]), np.array([0.5]), np.array([1.25]), (np.array([0.5, 1.0]),))
    found = refined(known, start, np.full(ROWS, NOISE**2), {named(effect): span}, make)
    assert found.atoms[0].shape[0] == pytest.approx(1.25, abs=1e-9)


def test_a_shape_reaches_its_neighbours_where_these_are_further_than_the_usual_step():
    levels = (np.array([1.0, 1.1, 1.2, 4.0, 20.0]),)
    span = Span(np.array([0.1]), np.array([0.5]), np.array([28.0]), levels)
    for shape, (down, up) in {
        1.1: (0.1, 0.1),
        2.0: (0.8, 2.0),
        4.0: (2.8, 16.0),
        20.0: (16.0, 8.0),
        28.0: (8.0, 0.1),
    }.items():
        got = span.reach(np.array([shape]))
        assert np.concatenate(got) == pytest.approx([down, up])


# -- the search -----------------------------------------------------------------------------------

OTHERS = (effects.Drift(), effects.Gravity(), effects.LinearStiffness(), effects.CubicDamping())


def test_single_effect_is_found_among_others():
    parts = columns(1, 7)
    grid = [atom(one, parts[:, 3 + i]) for i, one in enumerate(OTHERS)]
    grid.append(atom(effects.CoulombFriction(), parts[:, 2]))
    found, best = search(base(0.5 * parts[:, 2], parts[:, :2]), grid)
    assert names(best) == {"coulomb_friction"}
    assert best.gains[0][0] == pytest.approx(0.5, abs=5 * NOISE / np.sqrt(ROWS))
    assert found.value(best) < found.value(found.fit([]))


def test_pair_of_which_neither_gains_alone_is_found():
    """Two columns that nearly cancel: their difference is what is lacking."""
    parts = columns(2, 8)
    signal, common = parts[:, 2], parts[:, 3]
    pair = (
        atom(effects.CubicStiffness(), 0.5 * signal + 40.0 * common),
        atom(effects.QuadraticStiffness(), -0.5 * signal + 40.0 * common),
    )
    grid = [atom(one, parts[:, 4 + i]) for i, one in enumerate(OTHERS)] + list(pair)
    found, best = search(base(0.3 * signal, parts[:, :2]), grid)
    alone = [found.fit([one]) for one in pair]
    assert min(found.value(one) for one in alone) > found.value(found.fit([]))
    assert names(best) == {"cubic_stiffness", "quadratic_stiffness"}


def test_third_effect_is_found_beside_two():
    parts = columns(3, 8)
    grid = [atom(one, parts[:, 2 + i]) for i, one in enumerate(OTHERS)]
    target = parts[:, 2:5] @ np.array([0.5, 0.4, -0.3])
    _, best = search(base(target, parts[:, :2]), grid)
    assert names(best) == {"drift", "gravity", "linear_stiffness"}


def test_nothing_is_found_in_noise():
    """α = 0.01 for each of forty: more than two would happen once in a hundred times."""
    parts = columns(4, 6)
    grid = [atom(one, parts[:, 2 + i]) for i, one in enumerate(OTHERS)]
    false = 0
    for seed in range(40):
        known = base(np.zeros(ROWS), parts[:, :2], seed)
        problem = SearchProblem(known, tuple(grid), 0.01, 3, len(grid), 1e-9)  # everything matters
        false += bool(search_sets(problem, no_shapes).sets[0].atoms)
    assert false <= 2


def stribeck(own: np.ndarray, rise: np.ndarray) -> Callable:
    def make(placed: Placed, shapes: np.ndarray) -> list[CandidateColumns]:
        return [
            atom(effects.StribeckFriction(), np.stack([own, rise * np.sqrt(s)], 1), (float(s),))
            for (s,) in shapes
        ]

    return make


@pytest.mark.parametrize(("rise", "expected"), [(0.0, "coulomb_friction"), (0.3, None)])
def test_family_is_named_by_its_simplest_member(rise: float, expected: str | None):
    parts = columns(5, 4)
    make = stribeck(parts[:, 2], parts[:, 3])
    grid = make(named(effects.StribeckFriction()), np.array([[0.5], [1.0]]))
    grid.append(atom(effects.CoulombFriction(), parts[:, 2]))
    known = base(0.5 * parts[:, 2] + rise * parts[:, 3], parts[:, :2])
    _, best = search(known, grid, make)
    assert names(best) == {expected or "stribeck_friction"}


def test_family_needs_more_than_significance_beside_its_simplest_member():
    """A rise worth 1/2500 of the residual is seen in little noise, and is no reason."""
    parts = columns(5, 4)
    make = stribeck(parts[:, 2], parts[:, 3])
    grid = make(named(effects.StribeckFriction()), np.array([[0.5], [1.0]]))
    grid.append(atom(effects.CoulombFriction(), parts[:, 2]))
    known = base(5.0 * parts[:, 2] + 0.1 * parts[:, 3], parts[:, :2])
    ranked = search_all(known, grid, make)
    found, best = ranked.scores, ranked.sets[0]
    family = next(fit for fit in ranked.sets if names(fit) == {"stribeck_friction"})
    assert names(best) == {"coulomb_friction"}
    assert found.value(family) < found.value(best)
    assert not found.material(family)


def in_units(known: Base, unit: float) -> Base:
    """The same modes, the second half of them an output in other units."""
    output = np.arange(ROWS) // (ROWS // 2)
    scale = np.where(output == 1, unit, 1.0)
    return replace(
        known, target=scale * known.target, columns=scale[:, None] * known.columns,
        noise=scale**2 * known.noise, local=scale**2 * known.local, output=output,
    )  # fmt: skip


def test_the_answer_does_not_depend_on_the_unit_of_an_output():
    every = columns(1, 8)
    of_first = np.where(np.arange(ROWS) < ROWS // 2, every[:, 4], 0.0)
    plain = base(0.3 * of_first, every[:, :2])
    shares = []
    for unit in (1.0, 1e6, 1e-6):
        known = in_units(plain, unit)
        scale = np.where(known.output == 1, unit, 1.0)
        grid = [
            atom(effect, scale * column)
            for effect, column in [
                (effects.CubicStiffness(), of_first),
                (effects.ViscousFriction(), every[:, 5]),
            ]
        ]
        scores, best = search(known, grid)
        assert names(best) == {"cubic_stiffness"}
        powers = known.signal_power(scores.fit([]).residual), known.signal_power(best.residual)
        shares.append((powers[1] / powers[0], powers[0] / known.output_power))
    np.testing.assert_allclose(shares, [shares[0]] * 3, rtol=1e-6)


def test_an_output_that_is_noise_alone_counts_little_beside_another():
    noise = np.random.default_rng(1).standard_normal(ROWS)
    first = np.arange(ROWS) < ROWS // 2
    known = in_units(base(np.zeros(ROWS), columns(1, 2)), 1.0)
    known = replace(known, local=np.where(first, 4.0, local_power(NOISE * noise)))
    of_noise = known.signal_power(np.where(first, 0.0, NOISE * noise))
    assert of_noise < 0.2 * known.output_power  # Y of 25 modes scatters about N by 0.28


def test_outputs_at_rest_have_no_power():
    known = in_units(base(np.zeros(ROWS), columns(1, 2)), 1.0)
    known = replace(known, noise=0.0 * known.noise, local=0.0 * known.local)
    assert known.output_power == 0.0
    np.testing.assert_array_equal(known.output_level, 1.0)


def test_wrong_sign_is_refused():
    parts = columns(6, 3)
    grid = [atom(effects.CoulombFriction(), parts[:, 2])]
    found, best = search(base(-0.5 * parts[:, 2], parts[:, :2]), grid)
    assert best.atoms == ()
    assert found.value(found.fit(grid)) == np.inf


def test_effect_of_the_declared_model_is_known():
    parts = columns(7, 4)
    declared = effects.ViscousFriction()
    grid = [atom(declared, parts[:, 0]), atom(effects.CoulombFriction(), parts[:, 2])]
    found, best = search(base(0.5 * parts[:, 2], parts[:, :2]), grid)
    assert found.known(named(declared))
    assert not found.known(named(effects.CoulombFriction()))
    assert names(best) == {"coulomb_friction"}


def test_significant_effect_that_does_not_matter_is_left_out():
    parts = columns(8, 4)
    grid = [atom(effects.Drift(), parts[:, 2]), atom(effects.CubicStiffness(), parts[:, 3])]
    small = 0.06  # half a per cent of the power
    found, best = search(base(parts[:, 2] + small * parts[:, 3], parts[:, :2]), grid)
    both = found.fit(grid)
    assert found.value(both) < found.value(best)
    assert names(best) == {"drift"}
    assert not found.material(both)


def test_small_effect_that_takes_all_of_the_rest_is_found():
    """One per cent of the power, but ten times the noise: without it the answer is wrong."""
    parts = columns(8, 4)
    grid = [atom(effects.Drift(), parts[:, 2]), atom(effects.CubicStiffness(), parts[:, 3])]
    _, best = search(base(3.0 * parts[:, 2] + 0.3 * parts[:, 3], parts[:, :2]), grid)
    assert names(best) == {"drift", "cubic_stiffness"}


def test_trace_of_an_effect_is_left_out_however_exact_the_rest():
    parts = columns(8, 4)
    grid = [atom(effects.Drift(), parts[:, 2])]
    trace = 1e-4  # of y^(r), whose power in each row is 4: a quarter of the least that matters
    target = trace * parts[:, 2]
    known = Base(
        target, parts[:, :2], np.arange(2), np.full(ROWS, 1e-20), np.full(ROWS, 4.0),
        np.zeros(ROWS, int),
    )  # fmt: skip
    found, best = search(known, grid)
    assert names(best) == set()
    assert not found.material(found.fit(grid))
    assert found.fit(grid).residual == pytest.approx(np.zeros(ROWS), abs=1e-12)


def test_common_twin_is_preferred():
    """The same column under two names: rarity decides."""
    parts = columns(10, 3)
    grid = [atom(effects.Gravity(), parts[:, 2]), atom(effects.LinearStiffness(), parts[:, 2])]
    _, best = search(base(0.5 * parts[:, 2], parts[:, :2]), grid)
    assert names(best) == {"linear_stiffness"}


def test_one_gain_costs_what_a_test_at_that_level_asks_for():
    parts = columns(11, 3)
    grid = [atom(effects.Drift(), parts[:, 2])]
    known = base(0.5 * parts[:, 2], parts[:, :2])
    costs = [search(known, grid, alpha=alpha)[0].penalty(grid) for alpha in (0.1, 0.001)]
    asked = [float(chi2.isf(alpha / 1, 1)) for alpha in (0.1, 0.001)]
    assert costs[1] - costs[0] == pytest.approx(asked[1] - asked[0])


def test_shapes_are_those_of_the_power_that_the_answer_leaves():
    """The first S is that of all that is lacking: under it half of the rows, noisy, count alike."""
    random, time = np.random.default_rng(14), np.linspace(0.0, 10.0, ROWS)
    effect = effects.Overflow()
    deviation = np.where(np.arange(ROWS) % 2 == 0, 0.001, 0.5)

    def make(placed: Placed, shapes: np.ndarray) -> list[CandidateColumns]:
        return [atom(effect, -np.sin(s * time), (float(s),)) for (s,) in shapes]

    target = -np.sin(1.03 * time) + deviation * random.standard_normal(ROWS)
    ones, one_output = np.full(ROWS, 4e-6), np.zeros(ROWS, int)
    known = Base(target, columns(15, 2), np.arange(2), deviation**2, ones, one_output)
    found, best = search(known, make(named(effect), np.linspace(0.5, 1.5, 6)[:, None]), make)
    # Cramér-Rao: σ√12/(A T √(N/2)), about 3e-5 rad/s from the quiet rows.
    assert best.atoms[0].shape[0] == pytest.approx(1.03, abs=1.5e-4)
    exact = found.fit(make(named(effect), np.array([[1.03]])))
    assert best.cost < exact.cost + 1.0


# -- the noise model ------------------------------------------------------------------------------


def test_power_of_the_residual_is_recovered():
    random = np.random.default_rng(12)
    omega = np.linspace(0.1, 40.0, 6000)
    noise, local = 1e-6 * omega**4, 50.0 / (1.0 + (omega / 5.0) ** 4)
    truth = 2.0 * noise + 0.05 + 1e-3 * local
    found = fitted_power(
        random.standard_normal(len(omega)) * np.sqrt(truth), noise, local, np.zeros(len(omega), int)
    )
    # Three parameters from six thousand squares; where one is a small part it is known less well.
    np.testing.assert_allclose(found, truth, rtol=0.1)


def test_power_never_falls_below_the_floor():
    local = np.linspace(1.0, 100.0, 500)
    found = fitted_power(np.zeros(500), np.full(500, 1e-12), local, np.zeros(500, int))
    floor = (2e-3) ** 2 * local + (1e-4) ** 2 * 50.5
    assert np.all(found >= floor)
    np.testing.assert_allclose(
        expected_power(np.full(500, 0.3), local, np.zeros(500, int)), 0.3 + floor
    )


def test_floor_of_an_output_does_not_know_the_unit_of_another():
    """One in metres, the other in micrometres: each as if it stood alone."""
    local = np.linspace(1.0, 100.0, 500)
    output = np.repeat([0, 1], 500)
    both = expected_power(np.zeros(1000), np.concatenate([local, 1e12 * local]), output)
    alone = expected_power(np.zeros(500), local, np.zeros(500, int))
    np.testing.assert_allclose(both, np.concatenate([alone, 1e12 * alone]))


def test_modes_in_which_nothing_happens_do_not_rule_the_fit():
    """Their errors are those of the others, in proportion to these and not to themselves."""
    local = np.where(np.arange(600) < 400, 1.0, 1e-8)
    found = fitted_power(1e-5 * np.sqrt(local), np.zeros(600), local, np.zeros(600, int))
    assert np.max(found) < 1000.0 * np.min(found)


def test_outputs_have_their_own_power():
    random = np.random.default_rng(13)
    output = np.repeat([0, 1], 3000)
    residual = random.standard_normal(6000) * np.where(output == 0, 1.0, 10.0)
    found = fitted_power(residual, np.ones(6000), np.ones(6000), output)
    np.testing.assert_allclose(found, np.where(output == 0, 1.0, 100.0), rtol=0.1)


def test_local_power_is_an_average_over_neighbours():
    np.testing.assert_allclose(local_power(np.full(100, 3.0)), 9.0)
    one = np.zeros(100)
    one[50] = 5.0
    spread = local_power(one)
    assert spread[50] == pytest.approx(1.0)  # 25 neighbours
    assert np.sum(spread) == pytest.approx(25.0)


# -- candidates -----------------------------------------------------------------------------------


def carts(t, x, u, p):
    return -p.k * x.y[0] - p.c * x.y[1] + u[0]


TWO = eoi.Plant(
    carts, {"k": 20.0, "c": 0.4}, relative_degree=2, inputs=("a", "b"), outputs=("y1", "y2")
)


def test_every_effect_is_tried_at_every_channel_that_it_fits():
    tried = placements(TWO, [effects.CoulombFriction(), effects.Leak(), effects.InputDelay()])
    # Input a pushes both carts: friction of each is tried beside it, too.
    assert [(one.effect.name, one.channel, one.through) for one in tried] == [
        ("coulomb_friction", 0, None),
        ("coulomb_friction", 1, None),
        ("coulomb_friction", 0, 0),
        ("coulomb_friction", 1, 0),
        ("input_delay", 0, None),
        ("input_delay", 1, None),
    ]


def alone(plant, effect):
    """Where an effect is tried without inertia passing it on."""
    return [one for one in placements(plant, [effect]) if one.through is None]


def test_springs_are_tried_between_outputs_of_one_kind_each_way_round():
    sites = [(one.channel, one.against) for one in alone(TWO, effects.CubicStiffness())]
    assert sites == [(0, None), (1, None), (0, 1), (1, 0)]
    angle = eoi.Plant(
        carts, {"k": 20.0, "c": 0.4}, relative_degree=2, inputs=("a", "b"),
        outputs=("y1", "y2"), units={"y1": "m", "y2": "rad"},
    )  # fmt: skip
    assert len(alone(angle, effects.CubicStiffness())) == 2
    unlike = eoi.Plant(
        carts, {"k": 20.0, "c": 0.4}, relative_degree=(2, 1), inputs=("a", "b"),
        outputs=("y1", "y2"),
    )  # fmt: skip
    assert [one.against for one in placements(unlike, [effects.CubicStiffness()])] == [None]


def test_columns_of_a_term_are_those_of_its_own_output():
    time = 0.01 * np.arange(1500)
    drive = np.stack([np.sin(3.0 * time), np.cos(time)], axis=1)
    record = eoi.simulate(TWO, time, drive, [[0.1, 0.2], [0.0, 0.0]], hold="linear")
    several = [modal_record(TWO, record, 15.0)]
    tried = alone(TWO, effects.CubicStiffness())
    first, second, joint, _ = tried
    size = len(several[0].omega)
    made = [atoms(TWO, one, np.zeros((1, 0)), several)[0].columns[:, 0] for one in tried]
    for own, other in ((0, 1), (2, 3)):
        assert not np.any(made[own][size:])
        assert np.any(made[own][:size])
        assert not np.any(made[other][:size])
        assert np.any(made[other][size:])
    assert not np.allclose(made[0], made[2])
    seen = seen_at(TWO, second, several, 10.0, np.ones(1), np.zeros(0))
    y = several[0].y[:, 0]
    np.testing.assert_array_equal(seen.y, y[:, 1])
    apart = seen_at(TWO, joint, several, 10.0, np.ones(1), np.zeros(0))
    np.testing.assert_array_equal(apart.y, y[:, 0] - y[:, 1])
    noise = several[0].state_noise
    assert apart.noise == pytest.approx(np.hypot(noise[0], noise[1]))
    assert atoms(TWO, first, np.zeros((0, 0)), several) == []


def test_a_shape_that_makes_a_divisor_zero_is_left_out_without_a_warning():
    """A dead zone of 2 makes all of the speed zero; NumPy's warnings are errors here."""
    turning = eoi.plant_from_text({"y": "-k*y/speed"}, {"k": 3.0}, ["y"], ["speed"])
    time = 0.01 * np.arange(1000)
    record = eoi.simulate(turning, time, 1.3 + 0.4 * np.sin(time), 1.0, hold="linear")
    several = [modal_record(turning, record, 15.0)]
    (placed,) = alone(turning, effects.InputDeadZone())
    made = atoms(turning, placed, np.array([[0.1], [2.0]]), several)
    assert [one.shape for one in made] == [(0.1,)]


def test_shape_at_which_a_term_is_not_finite_is_not_tried():
    time = 0.01 * np.arange(1000)
    record = eoi.simulate(TWO, time, np.stack([np.sin(time)] * 2, axis=1), hold="linear")
    several = [modal_record(TWO, record, 15.0)]
    (placed, _) = alone(TWO, effects.StribeckFriction())
    shapes = [one.shape for one in atoms(TWO, placed, np.array([[0.1], [np.nan]]), several)]
    assert shapes == [(0.1,)]


def test_a_scale_is_never_refined_down_to_nothing():
    """Half a step below the grid, but of a rate no less than a fifth of the smallest."""
    placed = Placed(effects.InternalOverflow(), 0, ("rate", "level"))
    span = _span(placed, np.array([[1.0, 1.0], [4.0, 4.0]]))
    np.testing.assert_allclose(span.low, [0.2, -0.5])
    np.testing.assert_allclose(span.high, [5.5, 5.5])
