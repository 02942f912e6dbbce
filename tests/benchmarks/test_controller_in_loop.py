"""A slice of `benchmarks/truth/controller_in_loop.py`."""

import eoi_jax as eoi
from benchmarks.truth.controller_in_loop import Feedback, fitted, measured
from benchmarks.truth.unstable_plants import rigs


def test_a_rig_in_the_loop_of_its_feedback_is_found():
    rig = next(rig for rig in rigs() if rig.name == "second order, linear")
    (record,) = measured(rig, range(700, 701), 500, 1e-3, 0.0)
    refined = eoi.refine(rig.model, record, controller=Feedback(rig).controller())
    outcome = fitted(rig, refined, 0.0)
    assert outcome.status == "converged"
    assert (abs(outcome.relative) < 0.01).all()
    assert (abs(outcome.standard) < 4.0).all()
