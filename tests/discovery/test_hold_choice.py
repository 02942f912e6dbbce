"""Which of the answers under several holds counts."""

from dataclasses import replace

import pytest
from found import HELD_OUT, discovery

from eoi_jax._status import Status
from eoi_jax.data.holds import HoldChoice
from eoi_jax.discovery import hold_choice
from eoi_jax.discovery.hold_choice import Searched, _best, _Trial
from eoi_jax.estimation.hold import HoldIndices

INDICES = HoldIndices(
    HoldChoice("smooth", {"zero": 1.03, "linear": 1.0, "smooth": 1.0}, HELD_OUT.input_names),
    "zero",
    discovery().found.lowpass,
)


def best_of(monkeypatch, trials, powers):
    monkeypatch.setattr(hold_choice, "_powers", lambda fits: powers)
    return _best(trials).hold


def trial(hold, answer):
    return _Trial(hold, Searched(answer), (HELD_OUT.with_hold(hold),), INDICES)


@pytest.mark.parametrize(("power", "chosen"), [(1.004, "zero"), (1.05, "smooth")])
def test_of_answers_that_fit_alike_the_samples_suggest_the_hold(monkeypatch, power, chosen):
    """What suits the declared model best is tried first, and that lacks something."""
    trials = [trial(hold, discovery()) for hold in ("smooth", "zero")]
    assert best_of(monkeypatch, trials, [1.0, power]) == chosen


@pytest.mark.parametrize(("growth", "chosen"), [(1.01, "linear"), (1.2, "zero")])
def test_an_effect_that_makes_up_for_a_hold_goes_where_free_runs_are_as_good(
    monkeypatch, growth, chosen
):
    both = discovery()
    assert both.after is not None
    assert both.windows_after is not None
    runs = [replace(run, rmse=growth * run.rmse, nrmse=growth * run.nrmse)
            for run in (both.after, both.windows_after)]  # fmt: skip
    plain = replace(both, added=both.added[:1], effects=both.effects[:1],
                    after=runs[0], windows_after=runs[1])  # fmt: skip
    trials = [trial("zero", both), trial("linear", plain)]
    assert best_of(monkeypatch, trials, [1.0, 1.05]) == chosen
    open_answer = replace(plain, status=Status("unexplained", "Nothing explains it."))
    assert best_of(monkeypatch, [trials[0], trial("linear", open_answer)], [1.0, 1.05]) == "zero"
