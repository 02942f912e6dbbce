"""Every result draws itself: the right numbers, units on the axes, no legend over data."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from found import DECLARED, HELD_OUT, discovery

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.data.clipping import Saturation
from eoi_jax.discovery.diagnosis import Confounded, Cross, Diagnosis
from eoi_jax.discovery.result import Discovery
from eoi_jax.models.augmented import place
from eoi_jax.refinement.remaining import Candidate, Remaining
from eoi_jax.report.health import health
from eoi_jax.report.tables import health_table, identification_answer


@pytest.fixture(scope="module")
def found() -> Discovery:
    return discovery()


def remaining() -> Remaining:
    def one(effect: Any, share: float, chance: float) -> Candidate:
        return Candidate((place(DECLARED, effect, 0),), {}, share, chance)

    ranking = (one(effects.CoulombFriction(), 0.6, 1e-9), one(effects.ConstantOffset(), 0.1, 0.4))
    return Remaining(DECLARED, ranking, (), np.array([0.01]), 0.01)


DRAWN: dict[str, Callable[[Discovery], Any]] = {
    "record": lambda found: HELD_OUT,
    "identification": lambda found: found.declared,
    "validation": lambda found: found.after,
    "diagnosis": lambda found: eoi.diagnose(found.found),
    "discovery": lambda found: found,
    "uncertainty": lambda found: eoi.uncertainty(found.found),
    "remaining": lambda found: remaining(),
}


@pytest.mark.parametrize("what", DRAWN)
def test_every_result_plots_itself_and_no_legend_covers_data(found, what):
    figure = DRAWN[what](found).plot()
    figure.canvas.draw()
    panels = [axes for axes in figure.axes if axes.get_visible()]
    assert panels
    for axes in panels:
        assert axes.has_data()
        legend = axes.get_legend()
        if legend is not None:
            box, data = legend.get_window_extent(), axes.get_window_extent()
            assert box.y0 >= data.y1 - 1.0  # [px]


def test_a_free_run_is_drawn_with_its_error_over_the_measurement(found):
    upper, lower = found.after.plot().axes
    measured, run = (np.asarray(line.get_ydata()) for line in upper.lines)
    assert np.nanmax(measured) == np.max(HELD_OUT.outputs)
    assert np.nanmax(run) == np.max(found.after.predictions[0].outputs)
    assert upper.get_ylabel() == "position [m]"
    assert lower.get_ylabel() == "error [m]"
    assert lower.get_xlabel() == "time [s], run 2"


def test_intervals_and_correlations_are_those_of_the_estimate(found):
    known = eoi.uncertainty(found.found)
    panels = {axes.get_title(loc="left").split("\n")[0]: axes for axes in known.plot().axes}
    for name, (low, high) in known.intervals().items():
        bar = panels[name].collections[0].get_paths()[0].vertices[:, 1]
        np.testing.assert_allclose(sorted(bar), [low, high], rtol=1e-12)
    matrix = panels[""]
    shown = [text.get_text() for text in matrix.texts]
    assert shown == [f"{value:.2f}" for value in np.ravel(known.correlation)]


def test_what_remains_is_drawn_in_order_and_chance_apart():
    (axes,) = remaining().plot().axes
    assert [one.get_text() for one in axes.get_yticklabels()] == [
        "coulomb friction", "constant offset",
    ]  # fmt: skip
    sure, chance = axes.containers
    assert sure[0].get_width() == pytest.approx(60.0)
    assert chance[0].get_width() == pytest.approx(10.0)
    assert sure[0].get_facecolor() != chance[0].get_facecolor()


# -- health -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fine(found) -> Diagnosis:
    """A diagnosis without a finding."""
    no, zero, one = np.array([False]), np.array([0.0]), np.array([1.0])
    return dataclasses.replace(
        eoi.diagnose(found.found), more_than_noise=no, white=~no, strongest=(None,), offset=zero,
        offset_error=one, cross=(), confounded=(), worst_combination="", windows=(), saturation=(),
        sliding_fraction=one, noise=1e-5 * one, quantum=zero,
    )  # fmt: skip


def test_a_residual_as_large_as_the_highest_derivative_is_a_hundred_percent(found):
    wrong = dataclasses.replace(found.found, unexplained=np.array([0.9996]))
    assert health_table(wrong).splitlines()[-1].split()[-2:] == ["100", "%"]
    assert "; 100 % of" in identification_answer(wrong)


LATE = Cross("position", "force", np.zeros(1), np.zeros(1), 0.5, 0.0, 0.5, 0.02, False)
FED_BACK = dataclasses.replace(LATE, delay=np.nan, feedback=True)
BAD: tuple[tuple[str, dict[str, Any], str], ...] = (
    ("Excitation", {"confounded": (Confounded("mass", "spring", 0.999),)}, "mass and spring"),
    (
        "Excitation",
        {"worst_combination": "mass"},
        "The least certain combination of parameters is mass",
    ),
    ("Sliding", {"sliding_fraction": np.array([0.5])}, "50%"),
    ("Residual", {"more_than_noise": np.array([True])}, "more than noise"),
    ("Residual", {"white": np.array([False])}, "coloured"),
    ("Noise", {"quantum": np.array([1e-4])}, "steps of 0.0001 m"),
    ("Saturation", {"saturation": (Saturation("run 1", "force", 2.0, 0.1),)}, "stops at 2 N"),
    ("Delay and feedback", {"cross": (LATE,)}, "0.02 s"),
    ("Delay and feedback", {"cross": (FED_BACK,)}, "computed from position"),
)


def test_where_nothing_is_wrong_every_check_says_so(fine):
    checks = health(fine)
    assert len(checks) == 6
    assert all(one.good and one.finding and not one.advice for one in checks)


@pytest.mark.parametrize(("name", "changes", "said"), BAD)
def test_what_is_wrong_fails_its_own_check_alone_which_says_what_to_do(fine, name, changes, said):
    checks = health(dataclasses.replace(fine, **changes))
    (failed,) = [one for one in checks if not one.good]
    assert failed.name == name
    assert said in failed.finding
    assert failed.advice


def test_a_search_that_was_made_is_not_advised_again(fine):
    bad = dataclasses.replace(fine, more_than_noise=np.array([True]))
    (before,) = [one for one in health(bad) if not one.good]
    (after,) = [one for one in health(bad, searched="unexplained") if not one.good]
    assert "Run `eoi discover`" in before.advice
    assert "Run `eoi discover`" not in after.advice


ANSWERS = {
    "complete": ("note", "The answer stands: the added effects explain 93 %"),
    "nothing_missing": ("note", "The answer stands"),
    "partial": ("attention", "As the answer says, more than noise is left"),
    "unexplained": ("attention", "As the answer says, none of the tested effects explains this"),
}


@pytest.mark.parametrize("code", ANSWERS)
@pytest.mark.parametrize("changes", [{"more_than_noise": [True]}, {"white": [False]}])
def test_what_is_left_of_the_residual_is_told_in_agreement_with_the_answer(fine, code, changes):
    bad = dataclasses.replace(fine, **{key: np.array(value) for key, value in changes.items()})
    (told,) = [one for one in health(bad, searched=code, explained=0.93) if not one.good]
    state, said = ANSWERS[code]
    assert told.state == state
    assert told.finding.startswith(said)
    assert "noise" in told.finding.removeprefix(said)  # the finding itself follows
    assert "none of the tested effects" not in told.finding or code == "unexplained"


def test_after_a_search_a_delay_is_looked_up_among_the_candidates(fine):
    late = dataclasses.replace(fine, cross=(LATE,))
    (before,) = [one for one in health(late) if not one.good]
    (after,) = [one for one in health(late, searched="complete") if not one.good]
    assert "let `eoi discover` try" in before.advice
    assert "table of other candidates" in after.advice
