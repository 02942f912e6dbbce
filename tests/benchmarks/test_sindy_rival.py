"""The rival does what its benchmark says, or beating it would prove nothing."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

pytest.importorskip("pysindy", reason="the rival needs pysindy: the extra `benchmarks`")
from benchmarks.truth import sindy_library as lib
from benchmarks.truth import sindy_rival as rival

H = 1e-3
K, C, B = 120.0, 8.0, 2.0  # the mass of these tests
Force = Callable[[float, float, float], float]


@dataclass(frozen=True)
class Simple:
    """What the rival reads of a case."""

    declared: str
    time: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    start: dict[str, float]


def _input(seed: int, n: int) -> np.ndarray:
    """Five tones about the resonance, louder and quieter."""
    rng, t = np.random.default_rng(seed), np.arange(n) * H
    tones = sum(np.sin(w * t + rng.uniform(0, 6.28)) for w in (2.3, 5.1, 8.7, 11.9, 16.3))
    return 20.0 * tones * np.interp(t, np.linspace(0, t[-1], 9), rng.uniform(0.3, 1.0, 9))


def _mass(force: Force, seed: int = 0, n: int = 15_000, noise: float = 1e-3) -> Simple:
    """y'' = -K y - C v + B u + force(y, v, u), semi-implicit midpoint, four steps a sample."""
    u, h = _input(seed, n), H / 4
    y, v, out = 0.0, 0.0, np.empty(n)
    for k, held in enumerate(u.tolist()):
        out[k] = y
        for _ in range(4):
            middle = y + 0.5 * h * v
            half = v + 0.5 * h * (-K * middle - C * v + B * held + force(middle, v, held))
            v += h * (-K * middle - C * half + B * held + force(middle, half, held))
            y = middle + 0.5 * h * v
    out += noise * np.std(out) * np.random.default_rng(seed + 1).standard_normal(n)
    return Simple("mass", np.arange(n) * H, u, out, {"k": 100.0, "c": 10.0, "b": 2.4})


FORCES: dict[str, Force] = {
    "cubic_stiffness": lambda y, v, u: -60.0 * y**3,
    "quadratic_drag": lambda y, v, u: -1.5 * v * abs(v),
    "coulomb_friction": lambda y, v, u: -6.0 * float(np.sign(v)),
    "constant_offset": lambda y, v, u: 5.0,
    "input_dead_zone": lambda y, v, u: -B * min(max(u, -6.3), 6.3),
    "input_saturation": lambda y, v, u: B * (min(max(u, -26.3), 26.3) - u),
    "input_quadratic": lambda y, v, u: 0.01 * u * u,
}


@pytest.mark.parametrize("name", FORCES)
def test_single_effect_is_named(name: str):
    assert rival.name(_mass(FORCES[name])) == (name,)


def test_nothing_is_named_where_nothing_is_missing():
    assert rival.name(_mass(lambda y, v, u: 0.0)) == ()


def test_pair_is_named():
    both = _mass(lambda y, v, u: 5.0 - 60.0 * y**3)
    assert rival.name(both) == ("constant_offset", "cubic_stiffness")


def test_effect_of_impossible_sign_is_not_named():
    """A drag that drives: the library's drag brakes, so another name or none, never that one."""
    case = _mass(lambda y, v, u: 0.1 * v * abs(v))
    assert "quadratic_drag" not in rival.name(case)


def test_coefficients_and_free_run_are_those_of_the_plant():
    case, other = (_mass(FORCES["cubic_stiffness"], seed, noise=1e-4) for seed in (0, 7))
    found = rival.discover(case)
    # Least squares on 15 s of data with noise of 1e-4: the worst is the cubic term, some tenths of
    # a percent.
    np.testing.assert_allclose(found.coefficients, [-K, -C, B, -60.0], rtol=0.01)
    start = rival.start_of(other.time, other.outputs)
    after = rival.free_run(found, other.time, other.inputs, start) - other.outputs
    before = rival.free_run(found.bare(), other.time, other.inputs, start) - other.outputs
    assert np.std(after) < 0.03 * np.std(before)
    assert found.seconds > 0


def _model(terms: tuple[lib.Term, ...], coefficients: list[float]) -> rival.Found:
    values = np.array(coefficients)
    return rival.Found((), terms, values, 2, (0.0, 0.0), 0.0, values)


def test_free_run_sticks_below_the_level_of_dry_friction_and_slides_above():
    terms = (lib.Term("input"), lib.Term("coulomb_friction"))
    found = _model(terms, [1.0, -2.0])
    time = np.arange(1000) * H
    held = rival.free_run(found, time, np.full(1000, 1.9), (0.3, 0.0))
    np.testing.assert_array_equal(held, 0.3)
    slides = rival.free_run(found, time, np.full(1000, 3.0), (0.0, 0.0))
    np.testing.assert_allclose(slides, 0.5 * time**2, atol=1e-12)  # net acceleration 1


def test_free_run_that_diverges_is_infinite_not_an_exception():
    found = _model((lib.Term("cubic_stiffness"),), [1e3])
    out = rival.free_run(found, np.arange(3000) * H, np.zeros(3000), (1.0, 1.0))
    assert np.isinf(out[-1])


def test_tank_that_leaks_is_named():
    n, period = 10_000, 0.2
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(2.0, 8.0, n // 200), 200)
    y, out = 0.35, np.empty(n)
    for k, held in enumerate(u.tolist()):
        out[k] = y
        for _ in range(4):
            y += period / 4 * (-0.0268 * y**0.5 + 0.003 * held - 0.006 * y)
    out += 1e-3 * np.std(out) * rng.standard_normal(n)
    case = Simple("tank", np.arange(n) * period, u, out, {"alpha": 0.03, "beta": 0.003})
    assert rival.name(case) == ("leak",)


@pytest.mark.parametrize(("optimiser", "form"), [("stlsq", "weak"), ("frols", "derivative")])
def test_weaker_set_ups_run_and_see_the_plain_case(optimiser: str, form: str):
    found = rival.discover(_mass(FORCES["constant_offset"]), optimiser, form)  # pyright: ignore
    assert "constant_offset" in found.effects


# -- the parts ------------------------------------------------------------------------------------


def test_rows_integrate_by_parts_exactly():
    """On y = sin(wt): the rows of y'' are -w² those of y, those of y'''s slope w cos(wt)'s."""
    t, w = np.arange(4000) * H, 7.0
    s = lib.signals(t, np.zeros(4000), np.sin(w * t))
    rows = lib.weak_rows(s, 2, 100)
    # The trapezoid's error on a bump with five continuous derivatives at its ends is far below.
    np.testing.assert_allclose(rows.left, -(w**2) * rows.level, atol=1e-8 * w**2)
    cosine = lib.weak_rows(lib.signals(t, np.zeros(4000), w * np.cos(w * t)), 2, 100).level
    np.testing.assert_allclose(rows.slope, cosine, atol=1e-8)


def test_smoothing_knows_the_noise_and_takes_most_of_it_out():
    rng, t = np.random.default_rng(5), np.arange(20_000) * H
    clean = np.sin(3.0 * t) + 0.3 * np.sin(17.0 * t)
    s = lib.signals(t, np.zeros(len(t)), clean + 0.01 * rng.standard_normal(len(t)))
    assert s.sigma == pytest.approx(0.01, rel=0.05)  # 10 000 coefficients: 2 % at one sigma
    inner = slice(200, -200)
    assert np.std((s.y - clean)[inner]) < 0.003


def test_lag_is_the_mean_of_the_exact_response():
    u = np.r_[np.zeros(3), np.ones(40)]
    fine = np.arange(40 * 1000) / 1000 + 0.0005
    mean = (1.0 - np.exp(-fine / 6.5)).reshape(40, 1000).mean(axis=1)
    np.testing.assert_allclose(lib._lag(u, 6.5)[3:], mean, atol=1e-7)


@pytest.mark.parametrize("start", [-0.15, 0.0, 0.15])
@pytest.mark.parametrize("step", [-0.1, 0.1])
def test_bouc_wen_step_is_that_of_its_equation(start: float, step: float):
    largest, share = 0.2, 0.8
    beta, gamma, z, fine = share / largest, (1 - share) / largest, start, 20_000
    for _ in range(fine):  # explicit Euler: its error is about 1 / fine
        dy = step / fine
        z += dy - beta * abs(dy) * z - gamma * dy * abs(z)
    same_side = start * step >= 0
    got = float(lib.bouc_wen(start, step, largest, share))
    # A step that crosses zero takes the rate of the side where it began.
    assert got == pytest.approx(z, abs=1e-4 if same_side else 0.02)
