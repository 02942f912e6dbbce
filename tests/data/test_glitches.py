"""Samples that stand out alone are masked; what a plant may do is not."""

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax import Plant, Record, RecordWarning

DRAW = np.random.default_rng(5)
N, H = 400, 0.05
T = H * np.arange(N)
SWING = np.exp(-0.1 * T) * np.cos(2.0 * T)
NOISE = 0.01 * DRAW.standard_normal(N)
NO_INPUT = np.zeros((N, 0))


def record(y, u=NO_INPUT):
    return Record.from_period(H, u, y, output_names=["y"])


@pytest.mark.parametrize(("row", "value"), [(60, 5.0), (200, 0.0 + 3.0), (397, -4.0)])
def test_one_sample_off_the_course_is_masked_and_told(row, value):
    y = SWING + NOISE
    y[row] = value
    with pytest.warns(RecordWarning, match=f"{value:.4g} in row {row}, counted from 0"):
        made = record(y)
    assert np.flatnonzero(~made.output_valid[:, 0]).tolist() == [row]


def test_a_dropout_to_zero_within_the_range_is_masked():
    y = 20.0 + 180.0 * (1.0 - np.exp(-T / 8.0)) + 0.1 * DRAW.standard_normal(N)
    y[[150, 320]] = 0.0
    with pytest.warns(RecordWarning, match="2 samples of `y` leave their course"):
        made = record(y)
    assert np.flatnonzero(~made.output_valid[:, 0]).tolist() == [150, 320]


PULSES = np.zeros(N)
PULSES[100::90] = 1.0
BOUNCES = NOISE.copy()
BOUNCES[[40, 140, 220, 285]] = 5.0 * 0.7 ** np.arange(4)


@pytest.mark.parametrize(
    "y",
    [
        SWING,
        SWING + NOISE,
        np.cumsum(DRAW.standard_normal(N)),
        DRAW.standard_normal(N),
        DRAW.standard_t(2.5, N),  # heavy tails: no sample is unlike all others
        np.sign(SWING),
        np.where(T > 5.0, 1.0, 0.0) + NOISE,
        np.rint(8.0 * SWING) / 8.0,
        np.abs(SWING) + NOISE,
        (T % 2.0),
        BOUNCES,
        np.where(T < 10.0, 0.0, np.exp(-(T - 10.0))) + NOISE,  # leaps, and falls off
        np.where(T < 10.0, 0.0, np.exp(-4.0 * (T - 10.0))) + NOISE,
    ],
    ids=[
        "smooth", "noisy", "walk", "noise", "tails", "square", "step", "coarse", "corners", "saw",
        "bounces", "leap", "fast leap",
    ],
)  # fmt: skip
def test_what_signals_do_is_no_fault(y):
    assert record(y).output_valid.all()


def test_an_answer_to_a_pulse_of_the_input_is_no_fault():
    u = np.zeros(N)
    u[150] = 1.0
    assert record(3.0 * u + NOISE, u[:, None]).output_valid.all()


def test_one_faulty_sample_does_not_move_a_fit():
    def swing(t, x, u, p):
        return -p.stiffness * x.y[0] - p.damping * x.y[1]

    plant = Plant(swing, {"stiffness": 3.0, "damping": 0.1}, relative_degree=2, inputs=())
    y = SWING + NOISE
    y[60] = 5.0
    with pytest.warns(RecordWarning, match="leaves its course"):
        spoilt = record(y)
    fit = eoi.identify(plant, spoilt)
    assert fit.parameters["stiffness"] == pytest.approx(4.01, rel=0.02)


def test_such_a_sample_is_kept_where_it_can_be_true(tmp_path):
    y = SWING + NOISE
    y[60] = 5.0
    for made in (
        Record(T, NO_INPUT, y, output_names=["y"], mask_faults=False),
        Record.from_period(H, NO_INPUT, y, output_names=["y"], mask_faults=False),
    ):
        assert made.output_valid.all()
    np.savetxt(tmp_path / "run.csv", np.stack([T, y], 1), header="t,y", delimiter=",", comments="")
    made = eoi.read_record(tmp_path / "run.csv", "t", outputs="y", mask_faults=False)
    assert made.output_valid.all()
