"""Friction beside a disturbance that no effect explains: a lead, with what free runs say of it."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from report_runs import job

import eoi_jax as eoi
from eoi_jax.cli import summary as summaries
from eoi_jax.report.contents import discovery_contents
from eoi_jax.report.discovery import lead

pytestmark = [pytest.mark.slow, pytest.mark.long]
PERIOD, FRICTION = 1e-2, 0.5
TRUE = {"k": 20.0, "c": 0.8, "b": 2.0}


def sprung(t, x, u, p):
    position, rate = x.y
    return -p.k * position - p.c * rate + p.b * u


def rubbing(t, x, u, p):
    return sprung(t, x, u, p) - FRICTION * jnp.sign(x.y[1])


DECLARED = eoi.Plant(sprung, {"k": 26.0, "c": 0.6, "b": 1.6}, 2, ("force",), ("position",))
TRIED = eoi.effects.standard()
RIG = eoi.Plant(rubbing, TRUE, 2, ("force",), ("position",))


def measured(seed: int, push: float) -> eoi.Record:
    """Of the rig with friction, pushed by a force that is not in the record."""
    draw = np.random.default_rng(seed)
    time = PERIOD * np.arange(6000)
    drive = eoi.excitation.multisine(time, 3.0, (0.1, 3.0), 16, seed=seed)
    unseen = np.convolve(draw.standard_normal(len(time) + 60), np.hanning(61), "valid")
    unseen *= push / np.std(unseen)
    made = eoi.simulate(RIG, time, drive + unseen, substeps=2, hold="linear").outputs
    noisy = made + 1e-4 * np.std(made) * draw.standard_normal(made.shape)
    return eoi.Record(time, drive, noisy, f"run {seed}", input_names=("force",),
                      output_names=("position",), hold="linear")  # fmt: skip


@pytest.fixture(scope="module")
def found():
    """The held-out record has such a force too: its free runs hardly get better."""
    return eoi.discover(DECLARED, measured(1, 0.15), measured(2, 0.15), TRIED)


def test_what_free_runs_on_a_quiet_record_confirm_is_an_answer():
    answer = eoi.discover(DECLARED, measured(1, 0.15), measured(2, 0.0), TRIED)
    assert answer.effects == ("coulomb_friction",)
    assert answer.status.code in ("partial", "complete")
    (value,) = answer.added[0].parameters.values()
    assert value == pytest.approx(FRICTION, rel=0.2)
    assert answer.after is not None
    assert answer.before is not None
    assert answer.after.rmse[0] < 0.5 * answer.before.rmse[0]


def test_what_takes_too_little_is_no_answer_but_a_lead_with_its_free_runs(found):
    assert found.status.code == "unexplained"
    assert found.effects == ()
    assert found.plant.names == DECLARED.names
    assert [one.effect.name for one in found.lead.added] == ["coulomb_friction"]
    assert 0.2 < found.lead.explained < 0.9
    (value,) = found.lead.added[0].parameters.values()
    assert value == pytest.approx(FRICTION, rel=0.2)
    assert found.lead.after.rmse[0] < found.before.rmse[0]
    again = eoi.validate(found.lead.found.plant, found.held_out)
    assert again.rmse[0] == pytest.approx(found.lead.after.rmse[0], rel=1e-6)


def test_the_lead_is_told_and_is_not_called_an_answer(found):
    text = str(found)
    assert text.startswith("The model lacks something that none of the tested effects explains")
    (line,) = [
        one
        for one in text.splitlines()
        if one.startswith("Best partial explanation, not an answer")
    ]
    assert "with Coulomb (dry) friction of 0." in line
    assert " before, " in line
    assert line in discovery_contents(found, {"diagnosis": found.diagnosis}).notes


def test_the_lead_is_in_the_summary_and_survives_a_file(found, tmp_path):
    summary = summaries.discovery_summary(job(DECLARED, found.declared.records), found)
    assert summary["lead"]["added"][0]["effect"] == "coulomb_friction"
    assert summary["lead"]["after"]["rmse"]["position"] == found.lead.after.rmse[0]
    found.save(tmp_path / "found.npz")
    again = eoi.load(tmp_path / "found.npz", plant=DECLARED)
    assert again.lead.found.parameters == found.lead.found.parameters
    alone = eoi.load(tmp_path / "found.npz")
    assert str(alone) == str(again) == str(found)
    assert lead(alone) == lead(found) != ""


def test_an_answer_has_no_lead(found):
    answer = eoi.discover(DECLARED, measured(1, 0.0), measured(2, 0.0))
    assert answer.effects == ("coulomb_friction",)
    assert answer.lead is None
    assert lead(replace(found, lead=None)) == ""
