"""Cases of the discovery benchmark: their physics by other routes, and what they promise."""

from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks import independent
from benchmarks.truth import effect_cases as cases
from benchmarks.truth import effect_simulator as simulator

PERIOD = 1e-3


def _lanes(effects: tuple[dict, ...], u: np.ndarray, tank: bool = False, **base: float):
    """Open loop, from rest (a tank: from level 0.3), the same input in every lane."""
    count, n = len(effects), len(u)
    zero = np.zeros(count)
    names = ("stiffness", "gravity", "damping", "dry", "outflow", "gain")
    return simulator.Lanes(
        tank,
        {name: zero + base.get(name, 0.0) for name in names},
        effects,
        np.repeat(u[:, None], count, axis=1),
        np.zeros((n, count)),
        np.zeros((n, count)),
        {name: zero + (name == "tf") for name in ("kp", "ki", "kd", "tf", "bias")},
        zero + (0.3 if tank else 0.0),
        0.0,
        PERIOD,
    )


def _square(n: int, size: float = 1.0) -> np.ndarray:
    return size * np.where(np.arange(n) // 400 % 2 == 0, 1.0, -0.7)


def test_linear_plant_equals_its_matrix_exponential():
    u = _square(3000, 10.0)
    time = np.arange(3000) * PERIOD
    exact = independent.one_mass({"alpha": 140.0, "beta": 10.0, "rho": 2.0}, time, u, "zero")
    ours = simulator.simulate(_lanes(({},), u, stiffness=140.0, damping=10.0, gain=2.0))
    # Runge-Kutta at 0.5 ms: (ω h)^4 / 120 is 1e-11 of y, and y is about 0.1.
    np.testing.assert_allclose(ours.y, exact, atol=1e-11, rtol=0)


def test_pendulum_with_dry_friction_equals_the_solution_by_events():
    u = _square(4000, 0.2)
    time = np.arange(4000) * PERIOD
    truth = {"a": 81.0, "b": 1.7, "c": 3.0, "d": 99.0}
    exact = independent.pendulum(truth, time, u, "zero")
    base: dict[str, Any] = {"gravity": 81.0, "damping": 1.7, "gain": 99.0}
    by_effect, declared = (
        simulator.simulate(_lanes((effects,), u, dry=dry, **base)).y
        for effects, dry in (({"coulomb_friction": {"c": 3.0}}, 0.0), ({}, 3.0))
    )
    # The promise for half the step is 1e-5 of y; against the truth it holds with room.
    np.testing.assert_allclose(by_effect, exact, atol=2e-6, rtol=0)
    np.testing.assert_array_equal(by_effect, declared)


def test_stuck_plant_stays_exactly_put_and_leaves_when_the_force_passes_the_level():
    n = 2000
    u = np.linspace(0.0, 2.0, n)  # passes 1.0 in the middle
    history = simulator.simulate(_lanes(({"coulomb_friction": {"c": 1.0}},), u, gain=1.0))
    moving = np.flatnonzero(history.y[:, 0])
    assert moving[0] == pytest.approx(n / 2, abs=2)
    # Then y'' = u - 1, a ramp from zero: y = slope t^3 / 6, up to the ramp's steps of a sample.
    left = (n - 1 - moving[0]) * PERIOD
    slope = 2.0 / (n * PERIOD)
    assert history.y[-1, 0] == pytest.approx(slope * left**3 / 6, rel=5e-3)


_ODE: dict[str, dict[str, float]] = {
    "quadratic_drag": {"c": 0.8},
    "cubic_damping": {"c": 0.6},
    "cubic_stiffness": {"k": 90.0},
    "end_stop": {"k": 200.0, "side": -1.0, "s": -0.05},
    "free_play": {"k": 140.0, "g": 0.03},
    "position_ripple": {"a": 0.5, "kappa": 60.0, "phi": 1.0},
    "sinusoidal_disturbance": {"a": 1.0, "w": 9.0, "phi": 0.4},
    "input_dead_zone": {"g": 1.3},
    "input_delay": {"tau": 0.0234},
    "actuator_lag": {"time": 0.031},
    "hysteresis": {"A": 1.0, "beta": 9.0, "gamma": 3.0, "k": 40.0},
    "outside:second_resonance": {"w": 9.0, "zeta": 0.05, "k": 20.0},
}


def _right_hand_side(name: str, p: dict, u):
    """The equations a third time, one plant, plain floats: x = (y, v, memory, memory)."""

    def field(t: float, x: np.ndarray) -> list[float]:
        y, v, m, w = x
        push, dm, dw, extra = u(t), 0.0, 0.0, 0.0
        match name:
            case "quadratic_drag":
                extra = -p["c"] * abs(v) * v
            case "cubic_damping":
                extra = -p["c"] * v**3
            case "cubic_stiffness":
                extra = -p["k"] * y**3
            case "end_stop":
                extra = p["k"] * (p["s"] - y) if y < p["s"] else 0.0
            case "free_play":
                extra = p["k"] * (y if abs(y) < p["g"] else p["g"] * np.sign(y))
            case "position_ripple":
                extra = p["a"] * np.sin(p["kappa"] * y + p["phi"])
            case "sinusoidal_disturbance":
                extra = p["a"] * np.sin(p["w"] * t + p["phi"])
            case "input_dead_zone":
                push = 0.0 if abs(push) < p["g"] else push - p["g"] * np.sign(push)
            case "input_delay":
                push = u(t - p["tau"])
            case "actuator_lag":
                push, dm = m, (push - m) / p["time"]
            case "hysteresis":
                dm = p["A"] * v - p["beta"] * abs(v) * m - p["gamma"] * v * abs(m)
                extra = -p["k"] * m
            case "outside:second_resonance":
                dm, dw = w, -(p["w"] ** 2) * (m - y) - 2 * p["zeta"] * p["w"] * w
                extra = p["k"] * (m - y)
        return [v, -140.0 * y - 6.0 * v + 2.0 * push + extra, dm, dw]

    return field


@pytest.mark.parametrize("name", list(_ODE))
def test_effect_equals_an_adaptive_solver_on_its_equation(name: str):
    n, p = 1200, _ODE[name]
    u = _square(n, 8.0)

    def held(t: float) -> float:
        return float(u[min(int(t / PERIOD + 1e-9), n - 1)]) if t >= 0 else 0.0

    time, x, exact = np.arange(n) * PERIOD, np.zeros(4), [0.0]
    edges = [0, 400, 800, n - 1]
    shift = p["tau"] if name == "input_delay" else 0.0
    cuts = sorted({0.0, *(time[edges] + shift), time[-1]})
    for first, last in pairwise(cuts):
        if last > time[-1]:
            break
        inside = time[(time > first + 1e-12) & (time <= last + 1e-12)]
        middle = held(0.5 * (first + last) - shift)
        field = _right_hand_side(name, p, lambda _t, middle=middle: middle)
        leg = solve_ivp(
            field, (first, last), x, "DOP853", rtol=1e-11, atol=1e-13, max_step=5e-3,
            t_eval=[*inside[inside < last], last],
        )  # fmt: skip
        exact += list(leg.y[0][: len(inside)])
        x = leg.y[:, -1]
    base: dict[str, Any] = {"stiffness": 140.0, "damping": 6.0, "gain": 2.0}
    ours = simulator.simulate(_lanes(({name: p},), u, **base)).y[:, 0]
    np.testing.assert_allclose(ours, exact, atol=1e-6 * float(np.std(ours)), rtol=0)


def test_tank_equals_its_taylor_series():
    n, base = 3000, {"outflow": 0.6, "gain": 0.05}
    u = 6.0 + _square(n, 4.0)
    exact = independent.level_tank(
        {"alpha": 0.6 / np.sqrt(2 * independent.GRAVITY), "beta": 0.05},
        np.arange(n) * PERIOD, u, "zero", 0.3,
    )  # fmt: skip
    ours = simulator.simulate(_lanes(({},), u, tank=True, **base)).y
    # The series is of third order: about 1e-14 a step here.
    np.testing.assert_allclose(ours, exact, atol=1e-10, rtol=0)


# -- what a case promises ---------------------------------------------------------------------

_TRUTHS = {
    "mass": [(), ("stribeck_friction",), ("linear_stiffness",), ("coulomb_friction", "end_stop")],
    "tank": [(), ("overflow",), ("input_dead_zone",), ("outside:random_shocks",)],
}
_SAMPLES = 2400


@cache
def _cases(plant: str) -> list:
    return cases.cases(
        plant, _TRUTHS[plant], (4,), (0.0, 1e-2), ("open", "feedback"), samples=_SAMPLES
    )


@pytest.mark.parametrize("plant", ["mass", "tank"])
def test_a_case_keeps_its_promises(plant: str):
    made = _cases(plant)
    assert len(made) == len(_TRUTHS[plant]) * 4
    for case in made:
        assert case.declared == cases.declared_for(plant, case.truth)
        assert cases.declared_model(case.declared).startswith("y'")
        assert set(case.start) == set(case.parameters)
        ratios = np.array([case.start[key] / v for key, v in case.parameters.items()])
        assert np.all((ratios >= 0.7) & (ratios <= 1.3))
        assert np.any(ratios != 1.0)
        assert len(case.strength) == len(case.truth)
        # Drawn from 5 to 20 %; short records reach it roughly.
        assert all(0.03 < one < 0.3 for one in case.strength)
        for clean, seen in (
            (case.clean, case.outputs), (case.held_out_clean, case.held_out_outputs),
        ):  # fmt: skip
            # The standard deviation of 2400 draws is known to 1.5 %. Feedback noise was sized on
            # the coarse run, which is a little another one.
            room = 0.06 if case.loop == "open" else 0.3
            size = case.noise * np.std(clean)
            assert np.std(seen - clean) == pytest.approx(size, rel=room, abs=1e-15)
        assert np.max(np.abs(case.inputs - case.held_out_inputs)) > 0
        assert case.time.shape == case.inputs.shape == case.outputs.shape == (_SAMPLES,)


def test_noise_levels_share_one_trajectory_in_open_loop_only():
    quiet, noisy = (
        {case.loop: case for case in _cases("mass") if case.truth == () and case.noise == level}
        for level in (0.0, 1e-2)
    )
    np.testing.assert_array_equal(quiet["open"].clean, noisy["open"].clean)
    assert quiet["feedback"].parameters == noisy["feedback"].parameters
    # The controller sees the noise, and its input is what the record holds.
    assert np.std(quiet["feedback"].inputs - noisy["feedback"].inputs) > 0


def test_a_case_does_not_depend_on_its_company():
    truth = ("stribeck_friction",)
    alone = cases.cases("mass", [truth], (4,), (0.0,), samples=_SAMPLES)[0]
    same = next(
        case for case in _cases("mass")
        if case.truth == truth and case.loop == "open" and case.noise == 0.0
    )  # fmt: skip
    # Vectorised exponentials may round otherwise in another place of an array.
    np.testing.assert_allclose(
        alone.clean, same.clean, atol=1e-9 * float(np.std(same.clean)), rtol=0
    )
    other = cases.cases("mass", [truth], (5,), (0.0,), samples=_SAMPLES)[0]
    assert other.parameters != same.parameters


def test_halving_the_step_changes_nothing_that_matters():
    rng = np.random.default_rng(0)
    u = cases.excitation("steps", rng, 2000, PERIOD, 12.0) * 8.0
    names = ("stribeck_friction", "asymmetric_friction", "hysteresis", "end_stop", "input_delay")
    own = {
        "stribeck_friction": {"fc": 1.0, "fs": 2.0, "vs": 0.02},
        "asymmetric_friction": {"c_plus": 1.0, "c_minus": 0.4},
    }
    lanes = _lanes(
        tuple({name: own.get(name) or _ODE[name]} for name in names),
        u, stiffness=140.0, damping=6.0, gain=2.0,
    )  # fmt: skip
    coarse, fine = (simulator.simulate(lanes, halves=halves).y for halves in (1, 2))
    change = np.sqrt(np.mean((fine - coarse) ** 2, axis=0)) / np.std(fine, axis=0)
    assert np.all(change < 1e-5)
    assert np.any(change > 0)


def test_a_lane_that_diverges_leaves_the_others_alone():
    u = _square(800, 5.0)
    effects = ({"linear_stiffness": {"k": -1e6}}, {"linear_stiffness": {"k": 10.0}})
    both = simulator.simulate(_lanes(effects, u, gain=1.0)).y
    alone = simulator.simulate(_lanes(effects[1:], u, gain=1.0)).y
    assert not np.all(np.abs(both[:, 0]) < 1e6)
    np.testing.assert_array_equal(both[:, 1], alone[:, 0])


def test_dry_friction_with_a_small_offset_has_another_exact_name():
    level, offset = {"c_plus": 1.3, "c_minus": 0.7}, {"offset": -0.3}
    u = _square(2000, 4.0)
    lanes = _lanes(
        (
            {"asymmetric_friction": level},
            {"coulomb_friction": {"c": 1.0}, "constant_offset": offset},
        ),
        u, stiffness=140.0, damping=6.0, gain=2.0,
    )  # fmt: skip
    y = simulator.simulate(lanes).y
    np.testing.assert_allclose(y[:, 0], y[:, 1], atol=1e-9 * float(np.std(y)), rtol=0)
    made = cases.cases("mass", [("asymmetric_friction",)], samples=400)[0]
    assert made.equivalent == ("coulomb_friction", "constant_offset")


def test_every_truth_has_a_term_in_the_simulator():
    known = {
        *simulator.FORCES, *simulator.DRY, *simulator.INPUTS, *simulator.SIGNALS, *simulator.MEMORY
    }  # fmt: skip
    for table in (cases.SINGLES, cases.PAIRS, cases.OUTSIDE):
        for truths in table.values():
            assert {name for truth in truths for name in truth} <= known
