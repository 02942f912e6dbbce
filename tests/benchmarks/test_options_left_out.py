"""A slice of the benchmark in which records say nothing of how they were made."""

import numpy as np
import pytest

from benchmarks.truth import effect_cases
from benchmarks.truth import options_left_out as benchmark


@pytest.fixture(scope="module")
def case():
    (made,) = effect_cases.cases("mass", (("cubic_stiffness",),), (3,), (1e-3,), samples=10_000)
    return made


def key(case):
    return benchmark.Key("single", "mass", case.truth, "open", case.noise, case.seed, 10_000)


@pytest.mark.slow
@pytest.mark.parametrize("trouble", ["gap", "late output"])
def test_the_effect_is_named_all_the_same(case, trouble, monkeypatch):
    monkeypatch.setattr(benchmark, "trouble_of", lambda _: trouble)
    row = benchmark.row(case, key(case))
    assert row.right, row
    assert row.trouble == trouble


def test_troubles_are_what_they_are_called(case):
    rng = np.random.default_rng(0)
    gap, only_output, slow, early = (
        benchmark.logged(case, trouble, False, rng)
        for trouble in ("gap", "output gap", "two rates", "early output")
    )
    assert np.isnan(gap.inputs).sum() == np.isnan(gap.outputs).sum() == 200
    assert np.isnan(only_output.inputs).sum() == 0
    assert np.isnan(only_output.outputs).sum() == 200
    assert np.isfinite(slow.outputs).sum() == -(-10_000 // benchmark.SLOW)
    near = 9.0 * (case.clean[1:-2] + case.clean[2:-1]) - case.clean[:-3] - case.clean[3:]
    noise = (case.outputs - case.clean)[1:-2]
    half_a_sample_on = early.outputs[1:-2] - noise
    np.testing.assert_allclose(half_a_sample_on, near / 16.0, atol=1e-6 * np.ptp(near))


def test_all_troubles_occur_equally_often():
    keys = [k for block in benchmark.blocks(["mass", "tank"], 1, 2, False) for k in block.listed()]
    counts = [sum(benchmark.trouble_of(k) == t for k in keys) for t in benchmark.TROUBLES]
    assert max(counts) < 1.3 * min(counts)


def test_the_judge_says_no(case):
    row = benchmark.Row(key(case), "gap", (), ("cubic_stiffness",), "complete", "", 1.0)
    assert row.right
    wrong = benchmark.Row(key(case), "gap", (), ("end_stop",), "complete", "", 1.0)
    failed = benchmark.Row(key(case), "gap", (), (), "error: ValueError", "", 1.0)
    assert not wrong.right
    assert not failed.right
    tables = benchmark.sections([row, wrong])
    assert "1 of 2 (50.0 %)" in tables[0]
    assert "end_stop" in tables[-1]
