"""The situations are well formed and reproducible; the judge serves right answers and no others."""

import io
import tomllib
from collections import Counter
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from benchmarks.situations import judge
from benchmarks.situations.situation import Situation
from benchmarks.situations.situations import ALL, QUICK

SLOW_TO_WRITE = "loudspeaker"  # 192 000 samples
BY_NAME = {situation.name: situation for situation in ALL}


def _rng() -> np.random.Generator:
    return np.random.default_rng(judge.SEED)


# -- the situations ---------------------------------------------------------------------------


def test_there_are_enough_of_them_and_few_of_a_kind():
    assert len(ALL) >= 40
    assert len(BY_NAME) == len(ALL)
    assert max(Counter(situation.kind for situation in ALL).values()) <= 5
    assert max(Counter(situation.plant for situation in ALL).values()) <= 5


@pytest.mark.parametrize("situation", ALL, ids=lambda situation: situation.name)
def test_a_situation_is_well_formed(situation):
    config = tomllib.loads(situation.config)
    data, model = config["data"], config["model"]
    assert situation.source
    assert situation.truth or situation.effects is not None or situation.refusal
    assert situation.tolerance <= 0.05 or situation.reason
    if situation.truth:
        assert set(model["parameters"]) <= set(situation.parameters) | set(model.get("fixed", ()))
    assert tuple(data["outputs"]) == tuple(model["outputs"])
    for name in situation.truth:
        assert judge.evaluated(name, situation.parameters) is not None
    if situation.name == SLOW_TO_WRITE:
        return
    tables = situation.tables(_rng())
    assert {*data["files"], *config.get("validation", {}).get("files", ())} == set(tables)
    for table in tables.values():
        text = pd.read_csv(io.StringIO(situation.write(table)))
        columns = {*data["inputs"], *data["outputs"], *([data["time"]] if "time" in data else [])}
        assert columns <= set(text)
        assert len(text) == len(table)
        assert all(text[output].notna().any() for output in data["outputs"])


def test_the_same_seed_gives_the_same_files():
    for name in ("patients", "house", "species_by_hand", "fermenter_dates"):
        assert BY_NAME[name].files(_rng()) == BY_NAME[name].files(_rng())


def test_the_simulation_of_a_staircase_is_exact():
    situation = BY_NAME["inner_loop"]
    table = situation.simulate({"tau": 0.2, "K": 1.5})["run.csv"]
    expected, decay = [0.0], np.exp(-0.02 / 0.2)
    for level in table["roll_ref"][:-1]:
        expected.append(1.5 * level + (expected[-1] - 1.5 * level) * decay)
    np.testing.assert_allclose(table["roll"], expected, atol=1e-7)


# -- the judge --------------------------------------------------------------------------------

ASKED = replace(
    BY_NAME["mass_from_force"], effects=(("quadratic_drag", "cubic_damping"), ("coulomb_friction",))
)
RIGHT = {
    "status": {"code": "complete", "message": ""},
    "parameters": {"m": 5.1, "d": 3.9, "c": 120.0},
    "effects": ["coulomb_friction", "cubic_damping"],
    "after": {"rmse": {"y": 2.2e-3}},
}


def _verdict(situation: Situation, summary: dict, status: int = 0, seconds: float = 5.0, errors=""):
    return judge.judged(situation, judge.Answer(status, summary, errors, seconds))


def test_a_right_answer_is_served():
    verdict = _verdict(ASKED, RIGHT)
    assert verdict.served, verdict.reason


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"parameters": {"m": 5.3, "d": 4.0, "c": 120.0}}, "m is +6 % off"),
        ({"parameters": {"m": None, "d": 4.0, "c": 120.0}}, "m is not a number"),
        ({"parameters": {}}, "not a number"),
        ({"effects": ["coulomb_friction"]}, "wrong effect: coulomb_friction"),
        ({"effects": ["coulomb_friction", "drift"]}, "wrong effect"),
        ({"effects": []}, "wrong effect: none"),
        ({"after": {"rmse": {"y": 2.6e-3}}}, "1.3 × noise"),
        ({"after": {"rmse": {"y": None}}}, "not finite"),
    ],
)
def test_a_wrong_answer_is_not_served(change, reason):
    verdict = _verdict(ASKED, {**RIGHT, **change})
    assert not verdict.served
    assert reason in verdict.reason


def test_no_answer_is_not_served():
    assert "traceback" in _verdict(ASKED, RIGHT, errors="Traceback (most recent call)").reason
    assert "traceback" in _verdict(ASKED, {}, status=2).reason
    assert "no answer: bad" in _verdict(ASKED, {**RIGHT, "status": {"message": "bad"}}, 1).reason
    assert "too slow" in _verdict(ASKED, RIGHT, seconds=61.0).reason
    assert "too slow" in judge.judged(ASKED, judge.Answer(None, {}, "", 360.0)).reason


def test_what_cannot_be_told_apart_must_be_said():
    situation = BY_NAME["setpoint_servo"]
    summary = {"parameters": {"J": 1.0, "kp": 275.0, "d": 22.5}}
    assert "cannot be told apart" in _verdict(situation, summary).reason
    sentence = "J, kp and d are only known up to a common factor: fix one of them"
    assert _verdict(situation, {**summary, "unclear": [sentence]}).served
    assert _verdict(situation, {**summary, "status": {"message": sentence}}, status=1).served
    assert not _verdict(situation, {**summary, "unclear": ["J is on its bound"]}).served


def test_a_refusal_must_say_why():
    situation = replace(ASKED, refusal=("unit", "angle"))
    assert _verdict(situation, {"error": "the unit of `angle` is degrees"}, status=2).served
    assert not _verdict(situation, {"error": "no"}, status=2).served
    assert not _verdict(situation, RIGHT).served


@pytest.mark.slow
@pytest.mark.parametrize("name", QUICK)
def test_a_cheap_situation_is_served_by_the_command(name):
    answer, verdict = judge.trial(BY_NAME[name])
    assert verdict.served, (verdict, answer.errors[-500:])
