"""Samples taken by hand, at uneven times, of an output that is a function of the states."""

from dataclasses import replace

import numpy as np
from scipy.integrate import solve_ivp

import eoi_jax as eoi
from eoi_jax.discovery.confirm import is_undecided, leave_noise
from eoi_jax.discovery.doubts import leaves_open
from eoi_jax.discovery.remainder import with_poor_fit

UPTAKE, LOSS, VOLUME, DOSE, LASTS = 1.2, 0.2, 15.0, 500.0, 0.5  # 1/h, 1/h, L, mg/h, h
HOURS = np.array([0, 0.5, 1, 2, 4, 6, 8, 12, 12.5, 13, 14, 16, 20, 23.5, 24, 24.5, 25, 26, 28, 32,
                  36, 42.0])  # fmt: skip
DOSED = np.array([0.0, 12.0, 24.0])
MODEL = eoi.plant_from_text(
    {"gut": "rate/3600 - ka*gut", "central": "ka*gut - k*central"},
    {"ka": UPTAKE / 3600, "k": LOSS / 3600, "V": VOLUME},
    ["conc"],
    ["rate"],
    initial={"gut": 0.0, "central": 0.0},
    output={"conc": "central/V"},
    bounds={"ka": (0.0, 1.0), "k": (0.0, 1.0), "V": (0.1, 1000.0)},
)


def dosed(seed, half=np.inf):
    """A subject with a loss that saturates from a half concentration [mg/L] on, if finite."""

    def rate(t, x):
        given = DOSE * np.any((t >= DOSED) & (t < DOSED + LASTS))
        factor = 1.0 if np.isinf(half) else (half + 6.0) / (half + x[1] / VOLUME)
        return [given - UPTAKE * x[0], UPTAKE * x[0] - LOSS * factor * x[1]]

    run = solve_ivp(rate, (0.0, 42.0), [0.0, 0.0], t_eval=HOURS, max_step=0.05).y[1] / VOLUME
    values = run * np.exp(0.08 * np.random.default_rng(seed).standard_normal(len(HOURS)))
    given = DOSE * np.isin(HOURS, DOSED)
    return eoi.Record(3600.0 * HOURS, given, values, input_names=("rate",), output_names=("conc",),
                      hold="zero")  # fmt: skip


def test_a_right_model_lacks_nothing_at_scattered_samples():
    answer = eoi.discover(MODEL, [dosed(300), dosed(301)], validation=dosed(302))
    assert answer.status.code == "nothing_missing"
    assert "at the samples free runs" in answer.status.message
    assert answer.diagnosis is None


def test_a_model_that_lacks_something_leaves_more_than_noise():
    for half, is_noise in ((np.inf, True), (1.0, False)):
        records = [dosed(seed, half) for seed in (300, 301)]
        fit = eoi.refine(MODEL, records)
        assert leave_noise([eoi.validate(fit.plant, records)]) is is_noise


TIMES = np.array([0, 0.25, 0.5, 0.75, 1, 1.5, 2, 3, 4, 6, 8, 10, 12, 16, 24.0])  # h
LINEAR = eoi.plant_from_text(
    {"conc": "-decay*conc + gain*rate"},
    {"decay": 8.5e-5, "gain": 2.42e-5},
    ["conc"],
    ["rate"],
)


def infused(seed, dose):
    """A loss of 1.8 mg/L/h that is half of that at 0.6 mg/L, after an infusion of an hour."""

    def rate(t, c):
        return dose / 12.0 * (t < 1.0) - 1.8 * c / (0.6 + c)

    run = solve_ivp(rate, (0.0, 24.0), [0.0], t_eval=TIMES, max_step=0.02).y[0]
    values = run * np.exp(0.05 * np.random.default_rng(seed).standard_normal(len(TIMES)))
    return eoi.Record(3600.0 * TIMES, dose * (TIMES < 1.0), np.maximum(values, 0.0), hold="zero",
                      input_names=("rate",), output_names=("conc",))  # fmt: skip


def test_few_samples_far_apart_leave_it_open_what_is_noise():
    """That nothing is left beyond it is said with that doubt, after a search in free runs."""
    answer = eoi.discover(
        LINEAR, [infused(1, 100.0)], validation=infused(2, 80.0), effects=["drift"]
    )
    runs = eoi.validate(LINEAR, infused(23, 80.0))
    assert is_undecided(runs).tolist() == [True]
    status = eoi.Status("nothing_missing", "nothing is left beyond the noise")
    answer = replace(answer, status=status, after=runs, windows_after=None)
    assert leaves_open(answer)
    assert "samples so few and far apart" in with_poor_fit(answer).status.message
