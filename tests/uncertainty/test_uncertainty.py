"""How sure an estimate is: intervals, correlation, physical parameters, what cannot be told."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax._status import Status
from eoi_jax.estimation.degrees_of_freedom import freedom_notes, student
from eoi_jax.estimation.regression.identifiability import groups_of
from eoi_jax.refinement.result import Refinement, Start
from eoi_jax.report.estimate_figures import EstimateLayout, refinement_figure, uncertainty_figure
from eoi_jax.uncertainty.uncertainty import (
    Uncertainty,
    _on_bounds,
    _precision,
    uncertainty,
)

VALUES = {"inverse_mass": 2.0, "stiffness": 80.0, "damping": 3.0}
COVARIANCE = np.asarray([[0.01, 0.1, 0.0], [0.1, 4.0, 0.0], [0.0, 0.0, 0.09]])
NONE = np.zeros((3, 0))


def sure(**changes) -> Uncertainty:
    fields = {
        "parameters": VALUES,
        "covariance": COVARIANCE,
        "degrees_of_freedom": np.full(3, np.inf),
        "untraced": NONE,
        "unclear": (),
        "units": {"damping": "1/s"},
    }
    return Uncertainty(**{**fields, **changes})


# -- intervals --------------------------------------------------------------------------------


def test_intervals_are_those_of_tables():
    """1.960 of the normal, 2.093 of t with 19 degrees of freedom, 1.729 at 90 %: any textbook."""
    low, high = sure().intervals()["stiffness"]
    assert (low, high) == pytest.approx((80 - 1.95996 * 2, 80 + 1.95996 * 2), abs=1e-4)
    low, high = sure(degrees_of_freedom=np.asarray([5.0, 19.0, 5.0])).intervals()["stiffness"]
    assert high - 80 == pytest.approx(2.0930 * 2, abs=1e-3) == 80 - low
    assert student(0.9, np.asarray([19.0])) == pytest.approx([1.7291], abs=1e-4)


def test_a_level_outside_of_zero_and_one_is_named():
    for level in (0.0, 1.0, 95.0):
        with pytest.raises(ValueError, match="`level` must lie in"):
            sure().intervals(level)


def test_t_intervals_from_few_blocks_cover_and_normal_ones_do_not():
    """The mean of ten normal numbers, 4000 times: 95 % within three binomial sigma, or not."""
    draws = np.random.default_rng(0).normal(size=(4000, 10))
    variance = np.var(draws, axis=1, ddof=1) / 10
    covered = {}
    for freedom in (9.0, np.inf):
        half = student(0.95, np.asarray([freedom])) * np.sqrt(variance)
        covered[freedom] = np.mean(np.abs(np.mean(draws, axis=1)) < half)
    sigma = np.sqrt(0.95 * 0.05 / 4000)
    assert abs(covered[9.0] - 0.95) < 3 * sigma
    assert covered[np.inf] < 0.95 - 5 * sigma


def test_correlation_is_the_covariance_over_both_errors():
    correlation = sure().correlation
    np.testing.assert_allclose(np.diagonal(correlation), 1.0)
    assert correlation[0, 1] == pytest.approx(0.1 / (0.1 * 2.0))


def test_fixed_open_and_unknown_parameters_say_so():
    covariance = np.diag([0.0, 4.0, np.nan])
    known = sure(covariance=covariance, untraced=np.asarray([[0.0], [1.0], [0.0]]))
    intervals = known.intervals()
    assert intervals["inverse_mass"] == (2.0, 2.0)
    assert intervals["stiffness"] == (-np.inf, np.inf)
    assert np.all(np.isnan(intervals["damping"]))
    assert "fixed" in str(known)


def test_intervals_of_draws_are_their_quantiles():
    """Of a lognormal the interval is skew; freedom widens it."""
    draws = np.exp(np.random.default_rng(0).normal(size=(20_000, 3)))
    one = sure(draws=draws)
    low, high = one.intervals()["damping"]
    # Quantiles of 20 000 draws are within some 3 % in these tails.
    assert (low, high) == pytest.approx(tuple(np.exp([-1.96, 1.96])), rel=0.05)
    wide = sure(draws=draws, degrees_of_freedom=np.full(3, 9.0)).intervals()["damping"]
    expanded = float(student(0.95, np.asarray([9.0]))[0]) * np.sqrt(10 / 9)
    assert wide == pytest.approx(tuple(np.exp([-expanded, expanded])), rel=0.1)


# -- physical parameters ----------------------------------------------------------------------


def test_delta_method_is_that_of_hand():
    known = sure(degrees_of_freedom=np.asarray([30.0, 19.0, 5.0])).physical(
        lambda p: {"mass": 1.0 / p.inverse_mass, "spring": p.stiffness / p.inverse_mass},
        {"mass": "kg"},
    )
    assert known.parameters == pytest.approx({"mass": 0.5, "spring": 40.0})
    # dm = -dq/q²; dk = ds/q - s dq/q².
    slope = np.asarray([[-0.25, 0.0], [-20.0, 0.5]])
    np.testing.assert_allclose(known.covariance, slope @ COVARIANCE[:2, :2] @ slope.T, rtol=1e-12)
    # Of the spring the fewer of its two; the damping has no part in either.
    np.testing.assert_array_equal(known.degrees_of_freedom, [30.0, 19.0])
    assert abs(known.correlation[0, 1]) < 1.0
    assert "kg" in str(known)


def test_delta_method_agrees_with_simulated_scatter():
    draws = np.random.default_rng(1).multivariate_normal(
        list(VALUES.values()), 1e-4 * COVARIANCE, 50_000
    )
    spring = draws[:, 1] / draws[:, 0]
    known = sure(covariance=1e-4 * COVARIANCE).physical(
        lambda p: {"k": p.stiffness / p.inverse_mass}
    )
    # The standard deviation of 50 000 draws is within 0.3 %.
    assert known.standard_errors["k"] == pytest.approx(np.std(spring), rel=0.01)


def test_what_cannot_be_told_has_no_finite_error_and_ratios_may():
    together = np.asarray([[2.0], [80.0], [3.0]])  # all three scale together
    known = sure(untraced=together).physical(
        lambda p: {"k": p.stiffness / p.inverse_mass, "mass": 1.0 / p.inverse_mass}
    )
    assert np.isfinite(known.standard_errors["k"])
    assert known.standard_errors["mass"] == np.inf


def test_only_what_depends_on_an_unknown_error_is_unknown():
    covariance = COVARIANCE.copy()
    covariance[2] = covariance[:, 2] = np.nan
    known = sure(covariance=covariance).physical(
        lambda p: {"mass": 1.0 / p.inverse_mass, "rate": p.damping**2}
    )
    assert known.standard_errors["mass"] == pytest.approx(0.025)
    assert np.isnan(known.standard_errors["rate"])


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda p: 1.0 / p.inverse_mass, "`function` must return a dict"),
        (lambda p: {}, "`function` must return a dict"),
        (lambda p: {1: p.damping}, "`function` must return names"),
        (lambda p: {"m": jnp.ones(2) * p.damping}, r"`function\[m\]` must be a scalar"),
        (lambda p: {"m": 1.0 / (p.damping - 3.0)}, r"`function\[m\]` must be finite"),
        (lambda p: {"m": jnp.sqrt(p.damping - 3.0)}, r"`function\[m\]` must have finite deriv"),
        (lambda p: {"m": np.sqrt(p.damping)}, "`function` must be differentiable by JAX"),
        (lambda p: {"m": float(p.damping)}, "`function` must be differentiable by JAX"),
        (lambda p: {"m": p.inverse_mas}, "Did you mean `inverse_mass`"),
    ],
)
def test_a_function_that_does_not_do_is_named(function, message):
    with pytest.raises(ValueError, match=message):
        sure().physical(function)


# -- of results -------------------------------------------------------------------------------


def driven(t, x, u, p):
    """Known by two ratios only."""
    return (p.force * u - p.drag * x.y[0]) / p.mass


PLANT = eoi.Plant(
    driven, {"mass": 1.7, "drag": 2.6, "force": 4.1}, units={"mass": "kg", "u": "V", "y": "m/s"}
)
TIME = np.arange(400) * 0.01


def refined(**changes) -> Refinement:
    """As `refine` would answer, without its fit."""
    u = np.sin(3.0 * TIME)
    record = eoi.simulate(PLANT, TIME, u, hold="linear")
    noise = 1e-3 * np.random.default_rng(0).standard_normal((2, len(TIME), 1))
    slopes = []
    for name, value in PLANT.parameters.items():
        moved = (PLANT.with_parameters({name: value + sign * 1e-4}) for sign in (1, -1))
        runs = [eoi.simulate(one, TIME, u, hold="linear").outputs[:, 0] for one in moved]
        slopes.append((runs[0] - runs[1]) / 2e-4)
    phi = np.stack(slopes, axis=1)
    result = Refinement(
        parameters=PLANT.parameters, standard_errors=dict.fromkeys(VALUES, 0.1),
        covariance=np.diag([0.01, 0.02, 0.03]), plant=PLANT, nominal=PLANT,
        starts=(Start("r", 0.0, np.zeros((1, 1)), np.zeros(0)),), rmse=np.asarray([1e-3]),
        before=np.asarray([2e-3]), cost=-13.0, cost_before=-12.0, residual=[noise[0]], steps=3,
        window=None, status=Status("converged", "no step lowers the cost"), notes=(),
        information=phi.T @ phi / 1e-6, degrees_of_freedom=np.full(3, 19.0),
        residual_before=(2 * noise[1],), records=(record,),
    )  # fmt: skip
    return replace(result, **changes)


def test_errors_of_few_degrees_of_freedom_say_how_far_their_intervals_reach():
    """12.7 of t with one degree of freedom, 4.3 with two: any textbook."""
    errors = dict.fromkeys(PLANT.names, 0.1)
    few = refined(degrees_of_freedom=np.asarray([1.0, 19.0, 2.0]), standard_errors=errors)
    (note,) = freedom_notes(few)
    first, _, last = PLANT.names
    assert note.startswith(
        f"the ± of {first} and {last} rests on 1 to 2 degrees of freedom: the 95"
    )
    assert "reaches 4.3 to 13 times as far to each side" in note
    assert "holds zero" not in note
    vague = {**errors, last: abs(few.parameters[last]) / 4.0}  # 4 standard errors are 0.9 of 4.3
    (note,) = freedom_notes(replace(few, standard_errors=vague))
    assert note.endswith(f"; that of {last} holds zero")
    assert freedom_notes(refined()) == ()
    open_ones = {**errors, first: np.inf, last: 0.0}
    assert freedom_notes(replace(few, standard_errors=open_ones)) == ()
    assert freedom_notes(replace(few, degrees_of_freedom=None)) == ()


def test_notes_of_a_refinement_tell_of_few_degrees_of_freedom_and_its_text_once():
    time = 0.5 * np.arange(8)
    y = np.exp(-0.3 * time) + 0.02 * np.random.default_rng(1).standard_normal(8)
    decay = eoi.plant_from_text({"y": "-k*y"}, {"k": 0.2}, ["y"])
    result = eoi.refine(decay, eoi.Record(time, np.zeros((8, 0)), y))
    (note,) = freedom_notes(result)
    assert note in result.notes
    assert str(result).count(note) == 1


def test_ratios_that_can_be_told_are_named_and_the_rest_is_open():
    # Central differences err by 1e-8 of the slope: a thousand times the rounding that is no
    # information. The null direction is put in by hand, where automatic derivatives have it.
    information, theta = np.asarray(refined().information), np.asarray(PLANT.theta)
    off = np.eye(3) - np.outer(theta, theta) / (theta @ theta)
    known = uncertainty(refined(information=off @ information @ off))
    assert known.unclear == (
        "only mass/force and drag/force can be told, not mass, drag and force",
    )
    assert set(known.standard_errors.values()) == {np.inf}
    ratios = known.physical(lambda p: {"rate": p.drag / p.mass})
    assert np.isfinite(ratios.standard_errors["rate"])


def test_what_left_no_trace_alone_is_named_alone():
    information = np.diag([1.0, 0.0, 2.0])
    known = uncertainty(refined(information=information))
    assert known.unclear == ("drag left no trace in the data",)
    assert known.intervals()["drag"] == (-np.inf, np.inf)
    assert np.isfinite(known.standard_errors["mass"])


def test_intervals_end_at_the_bounds():
    limits = np.array([0.0, -np.inf, 2.9]), np.array([2.05, np.inf, np.inf])
    known = sure(lower=limits[0], upper=limits[1])
    open_ended, plain = known.intervals(), sure().intervals()
    assert open_ended["inverse_mass"] == (plain["inverse_mass"][0], 2.05)
    assert open_ended["stiffness"] == plain["stiffness"]
    assert open_ended["damping"] == (2.9, plain["damping"][1])
    untraced = np.array([[1.0], [0.0], [0.0]])
    assert replace(known, untraced=untraced).intervals()["inverse_mass"] == (0.0, 2.05)


def test_what_ended_on_a_bound_is_not_taken_for_what_left_no_trace():
    """Its information is left out, and its error NaN: `refine`."""
    plant = PLANT.declared_anew(bounds={"drag": (1.0, 2.6)})
    covariance, information = np.diag([0.01, np.nan, 0.03]), np.diag([100.0, 0.0, 30.0])
    known = uncertainty(refined(plant=plant, covariance=covariance, information=information))
    (sentence,) = known.unclear
    assert sentence.startswith("drag ended on its bound, 2.6: it has no error")
    assert sentence in str(known)
    assert np.all(np.isnan(known.intervals()["drag"]))
    assert known.standard_errors["mass"] == pytest.approx(0.1)


def test_an_identification_on_a_bound_says_so_and_no_interval_leaves_the_bounds():
    record = refined().records[0]
    start = {"gain": 2.0, "rate": 1.0}
    rates = eoi.Plant(
        lambda t, x, u, p: p.gain * u - p.rate * x.y[0], start, bounds={"rate": (0.0, 1.2)}
    )
    known = uncertainty(eoi.identify(rates, record))  # the truth is 2.6/1.7
    (sentence,) = known.unclear
    assert sentence.startswith("rate ended on its bound, 1.2: ")
    assert np.all(np.isnan(known.intervals()["rate"]))
    assert np.isfinite(known.standard_errors["gain"])


def test_a_direction_without_whole_numbers_is_told_in_weights():
    direction = np.asarray([1.0, 0.37, 0.0])
    information = np.eye(3) - np.outer(direction, direction) / (direction @ direction)
    (sentence,) = uncertainty(refined(information=information)).unclear
    assert sentence == "a change of +1·mass +0.37·drag leaves no trace in the data"


def test_what_noise_hides_is_told_with_what_is_surer():
    """A common scale known to 30 %, ratios to 0.1 %."""
    theta = np.asarray(PLANT.theta)
    covariance = 0.3**2 * np.outer(theta, theta) + np.diag((1e-3 * theta) ** 2)
    (sentence,) = uncertainty(refined(covariance=covariance, information=None)).unclear
    assert "can hardly be told apart, only to within 30%" in sentence
    assert sentence.endswith("mass/force and drag/force are surer")


def test_what_noise_hides_is_told_whatever_the_units():
    """Beside a parameter of 1e-10 in its unit, of which the information is 1e22."""
    at = [PLANT.names.index(name) for name in ("mass", "drag", "force")]
    pair = np.asarray(PLANT.theta)[at[:2]]
    covariance, information = np.zeros((2, 3, 3))
    covariance[np.ix_(at[:2], at[:2])] = np.outer(pair, pair) + np.diag((1e-3 * pair) ** 2)
    information[np.ix_(at[:2], at[:2])] = np.linalg.inv(covariance[np.ix_(at[:2], at[:2])])
    covariance[at[2], at[2]], information[at[2], at[2]] = 1e-22, 1e22
    (sentence,) = uncertainty(refined(covariance=covariance, information=information)).unclear
    assert sentence.startswith("mass and drag can hardly be told apart, only to within 100%")


def test_what_is_known_well_is_not_told_with_what_noise_hides():
    """Mass and drag to 30 %, force to 0.5 %, all of them along one direction."""
    theta = np.asarray(PLANT.theta)
    names = PLANT.names
    direction = theta * [0.005 if name == "force" else 0.3 for name in names]
    covariance = np.outer(direction, direction) + np.diag((1e-4 * theta) ** 2)
    (sentence,) = uncertainty(refined(covariance=covariance, information=None)).unclear
    assert sentence.startswith("mass and drag can hardly be told apart, only to within 30%: a")
    assert "force" not in sentence
    direction = theta * [0.3 if name == "mass" else 0.005 for name in names]
    covariance = np.outer(direction, direction) + np.diag((1e-4 * theta) ** 2)
    assert not uncertainty(refined(covariance=covariance, information=None)).unclear


def test_a_parameter_by_itself_is_no_surer_combination():
    """Beside one that is told to 300 %, one to 12 % looked like a combination that stays."""
    theta = np.asarray(PLANT.theta)
    direction = theta * [{"mass": 0.12, "drag": 3.0}.get(name, 0.0) for name in PLANT.names]
    covariance = np.outer(direction, direction) + np.diag((1e-3 * theta) ** 2)
    (sentence,) = uncertainty(refined(covariance=covariance, information=None)).unclear
    assert sentence.startswith("mass and drag can hardly be told apart, only to within 12% to 300%")
    assert "surer" not in sentence


def test_what_noise_hides_without_whole_numbers_is_told_in_weights():
    direction = np.asarray([1.0, 0.37, 0.0])
    covariance = np.outer(direction, direction) + 1e-6 * np.eye(3)
    (sentence,) = uncertainty(refined(covariance=covariance, information=None)).unclear
    assert sentence.endswith("a change of +1·mass +0.37·drag hardly shows")


def test_information_says_what_is_weak_where_the_covariance_has_too_few_sums():
    """Of rank one, from a single cosine, all estimates look like one: that says nothing."""
    theta = np.asarray(PLANT.theta)
    covariance = np.outer(theta, theta)
    assert not uncertainty(
        refined(covariance=covariance, information=None, degrees_of_freedom=np.ones(3))
    ).unclear
    assert not uncertainty(refined(covariance=covariance, information=np.eye(3))).unclear
    weak = np.linalg.inv(np.outer(theta, theta) + 1e-4 * np.diag(theta**2))
    (sentence,) = uncertainty(refined(covariance=covariance, information=weak)).unclear
    assert sentence.endswith("mass/force and drag/force are surer")


def test_errors_that_are_merely_large_are_not_called_confounded():
    theta = np.asarray(PLANT.theta)
    assert not uncertainty(refined(covariance=np.diag(theta**2), information=None)).unclear


def test_an_estimate_without_an_answer_is_refused():
    with pytest.raises(ValueError, match="`estimate` must be one with an answer"):
        uncertainty(refined(status=Status("diverged", "it does not stay finite")))


def test_an_identification_has_its_intervals_too():
    time = np.arange(4000) * 0.01
    record = eoi.simulate(PLANT, time, np.sin(0.3 * time**1.3), hold="linear")
    noise = 1e-4 * np.random.default_rng(0).standard_normal(record.outputs.shape)
    noisy = record.with_outputs(record.outputs + noise, "noisy")
    rates = eoi.Plant(lambda t, x, u, p: p.gain * u - p.rate * x.y[0], {"gain": 2.0, "rate": 1.0})
    known = uncertainty(eoi.identify(rates, noisy))
    low, high = known.intervals(0.9999)["gain"]
    assert low < 4.1 / 1.7 < high
    assert "95 % interval" in str(known)


# -- the figure -------------------------------------------------------------------------------


def labels(figure):
    return [axes.get_ylabel() for axes in figure.axes if axes.get_visible()]


def test_figure_shows_runs_residuals_and_a_panel_for_each_parameter(tmp_path):
    result = refined()
    figure = result.plot()
    assert labels(figure)[:2] == ["y [m/s]", "error [m/s]"]
    upper, lower, *panels = [axes for axes in figure.axes if axes.get_visible()]
    assert [one.get_label() for one in upper.get_lines()] == ["measured", "before", "refined"]
    assert len(lower.get_lines()) == 2
    assert [one.get_title(loc="left") for one in panels] == ["mass\n[kg]", "drag", "force"]
    figure.savefig(tmp_path / "figure.png")
    assert figure.get_size_inches()[0] * figure.dpi == 1000


@pytest.mark.parametrize(
    "figure",
    [
        refinement_figure,
        lambda one, layout: uncertainty_figure(uncertainty(one), layout=layout),
    ],
)
def test_panels_in_several_rows_are_as_high_as_in_one(figure):
    def height(per_row):
        drawn = figure(refined(), layout=EstimateLayout(per_row=per_row))
        drawn.draw_without_rendering()
        (axes,) = [axes for axes in drawn.axes if axes.get_title(loc="left").startswith("mass")]
        return axes.get_window_extent().height

    assert height(1) > 0.8 * height(6)


def test_figure_of_a_result_that_kept_less_shows_what_there_is():
    bare = refined(records=(), residual_before=())
    assert len([one for one in refinement_figure(bare).axes if one.get_visible()]) == 3
    some = refined(residual_before=())
    lines = refinement_figure(some).axes[0].get_lines()
    assert [one.get_label() for one in lines] == ["measured", "refined"]


def test_kept_fields_come_back_from_a_file(tmp_path):
    result = refined()
    result.save(tmp_path / "r.npz")
    back = eoi.load(tmp_path / "r.npz", plant=PLANT)
    np.testing.assert_array_equal(back.information, result.information)
    np.testing.assert_array_equal(back.degrees_of_freedom, 19.0)
    assert uncertainty(back).intervals() == uncertainty(result).intervals()


def test_precision_is_the_inverse_of_what_is_known():
    """A fixed parameter has no variance, and no part in it; too few degrees of freedom, nothing."""
    covariance = np.array([[4.0, 0.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 2.5]])
    exact = np.zeros((3, 3))
    exact[::2, ::2] = np.linalg.inv(covariance[::2, ::2])
    known = np.array([50.0, np.inf, 30.0])
    np.testing.assert_allclose(_precision(covariance, known), exact, atol=1e-15)
    np.testing.assert_array_equal(_precision(covariance, np.array([50.0, np.inf, 4.0])), 0.0)


def test_a_parameter_on_a_bound_is_left_out_only_where_its_error_is_not_known():
    plant = eoi.Plant(
        lambda t, x, u, p: -p.a * x.y[0] + p.b * u + p.c, {"a": 1.0, "b": 2.0, "c": 0.0}, 1,
        bounds={"a": (1.0, 3.0), "b": (0.0, 2.0)}, fixed=("c",),
    )  # fmt: skip
    covariance = np.diag([np.nan, 0.1, np.nan])
    found = _on_bounds(np.array([1.0, 2.0, 0.0]), plant, covariance)
    np.testing.assert_array_equal(found, [True, False, False])
    assert not np.any(_on_bounds(np.array([1.5, 1.0, 0.0]), plant, covariance))


def test_what_is_fixed_or_open_has_no_correlation():
    untraced = np.array([[0.0], [0.0], [0.0], [1.0]])
    covariance = np.zeros((4, 4))
    covariance[:2, :2] = [[4.0, 1.0], [1.0, 1.0]]
    names = dict.fromkeys("abcd", 1.0)
    known = Uncertainty(names, covariance, np.full(4, np.inf), untraced, (), {})
    expected = np.full((4, 4), np.nan)
    expected[:2, :2] = [[1.0, 0.5], [0.5, 1.0]]
    np.testing.assert_array_equal(known.correlation, expected)


def test_directions_that_share_a_parameter_are_told_together():
    shared = np.array([[1.0, 0.0, 0.0, 0.0], [1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 2.0, 0.0],
                       [0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0]])  # fmt: skip
    assert sorted(map(sorted, groups_of(shared))) == [[0, 1, 3], [2]]
