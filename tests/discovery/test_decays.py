"""What a decay lacks is told from what imitates it: a kink, or a change with time."""

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.discovery.probability import Standing, beside_rival
from eoi_jax.discovery.result import Rival
from eoi_jax.models.augmented import place
from eoi_jax.models.effects import ConstantOffset, SecondNode

DECAY = eoi.Plant(lambda t, x, u, p: -x.y[0] / p.tau, {"tau": 0.6}, relative_degree=1, inputs=(),
                  outputs="signal", bounds={"tau": (0.02, np.inf)})  # fmt: skip


def counted(seed: int, amplitudes) -> list[eoi.Record]:
    """Light that decays fast, an eighth of it slowly, above a background; counted."""
    draw, time = np.random.default_rng(seed), 0.1 * np.arange(50)
    decay = np.exp(-time / 0.45) + 0.12 * np.exp(-time / 1.7)
    return [
        eoi.Record(time, np.zeros((50, 0)), draw.poisson(size * decay + 20.0)[:, None] * 1.0,
                   f"dose {size}", output_names="signal")
        for size in amplitudes
    ]  # fmt: skip


@pytest.mark.slow
def test_a_slow_part_of_a_decay_is_no_kink():
    found = eoi.discover(
        DECAY, counted(0, (400, 800, 1500, 250)), validation=counted(50, (600, 1100))
    )
    assert found.status.code == "complete"
    assert found.effects == ("constant_offset", "second_node")
    assert found.after is not None
    assert found.after.rmse[0] < 7.6  # √(counts): 7.1 on average


@pytest.mark.slow
def test_what_predicts_as_well_is_named_beside_a_kink():
    found = eoi.discover(
        DECAY, counted(6, (400, 800, 1500, 250)), validation=counted(56, (600, 1100))
    )
    (kink,) = found.added
    assert kink.label == "overflow"
    assert kink.is_doubtful
    assert [rival.effect for rival in kink.rivals[:2]] == ["constant_offset", "sensor_lag"]
    assert set(found.ambiguous_with) >= {"constant_offset", "sensor_lag"}
    assert "do not distinguish" in str(found)


def test_a_model_of_free_runs_shares_the_probability_of_an_effect():
    earlier = Standing(0.8, (Rival("leak", "", "signal", 0.2),))
    rivals = [place(DECAY, ConstantOffset(), 0), place(DECAY, SecondNode(), 0)]
    standing = beside_rival(DECAY, earlier, rivals, 3.0)
    # The model is three times as probable as the answer, whose share was 0.8.
    assert standing.probability == pytest.approx(0.8 / 3.4)
    found = {rival.effect: rival.probability for rival in standing.rivals}
    assert found == pytest.approx(
        {"constant_offset": 1.2 / 3.4, "second_node": 1.2 / 3.4, "leak": 0.2 / 3.4}
    )
