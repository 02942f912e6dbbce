"""What an output is, and which effects fit it."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import eoi_jax as eoi
from eoi_jax.models.kinds import kind_of


@pytest.mark.parametrize(
    ("name", "unit", "degree", "kind"),
    [
        ("v", "m/s", 1, "speed"),
        ("x1", "km/h", 1, "speed"),
        ("x1", "kts", 1, "speed"),
        ("h", "m", 1, "level"),
        ("x", "m", 2, "position"),
        ("q", "rad", 2, "position"),
        ("Motordrehzahl", "", 1, ""),
        ("motor drehzahl", "", 1, "speed"),
        ("lower_level", "V", 1, "level"),
        ("y", "V", 1, ""),
        ("T_2", "°C", 1, "temperature"),
    ],
)
def test_unit_name_and_degree_tell_the_kind(name, unit, degree, kind):
    assert kind_of(name, unit, degree) == kind


def coasting(kinds=None, units=None):
    return eoi.Plant(
        lambda t, x, u, p: -(p.F0 + p.F1 * x.y[0]) / 1000.0,
        {"F0": 100.0, "F1": 5.0}, inputs=(), outputs=("v",), kinds=kinds, units=units,
    )  # fmt: skip


def coast_down(start, seed):
    time = np.arange(0.0, 60.0, 0.5)
    rate = lambda t, v: -(150.0 + 3.0 * v + 0.4 * v**2) / 1000.0  # noqa: E731
    v = solve_ivp(rate, (0.0, 60.0), [start], t_eval=time, rtol=1e-10).y[0]
    v += 0.01 * np.random.default_rng(seed).standard_normal(len(time))
    return eoi.Record(time, np.zeros((len(time), 0)), v, output_names=("v",))


@pytest.mark.parametrize("declared", [{"units": {"v": "m/s"}}, {"kinds": {"v": "speed"}}])
def test_drag_is_found_on_a_speed_that_never_reverses(declared):
    records = [coast_down(33.0, 1), coast_down(27.0, 2)]
    found = eoi.discover(coasting(**declared), records, coast_down(30.0, 3))
    assert found.effects == ("quadratic_drag",)
    assert found.plant.parameters["quadratic_drag"] == pytest.approx(0.4e-3, rel=0.1)
    tried = {candidate.effect for candidate in found.ranking}
    assert not tried & {"overflow", "coulomb_friction", "asymmetric_friction"}


def test_a_declared_kind_stays_with_the_plant_and_its_effects():
    plant = coasting(kinds={"v": "speed"})
    assert plant.kinds == {"v": "speed"}
    assert plant.declared_anew(fixed=("F1",)).kinds == {"v": "speed"}
    assert plant.with_parameters({"F0": 1.0}).kinds == {"v": "speed"}
    text = eoi.plant_from_text({"h": "-k*h"}, {"k": 1.0}, ["h"], kinds={"h": "level"})
    assert text.kinds == {"h": "level"}


@pytest.mark.parametrize(
    ("kinds", "units", "message"),
    [
        ({"w": "speed"}, {}, "`kinds` must be one of v, got 'w'"),
        ({"v": "velocity"}, {}, r"`kinds\[v\]` must be one of position, speed"),
        (
            {"v": "level"},
            {"v": "m/s"},
            r"`kinds\[v\]` must fit the unit m/s, .* a speed, got level",
        ),
    ],
)
def test_a_kind_that_is_none_is_named(kinds, units, message):
    with pytest.raises(ValueError, match=message):
        coasting(kinds=kinds, units=units)


def test_a_first_order_plant_of_unknown_kind_is_judged_by_its_signs():
    plant = eoi.Plant(lambda t, x, u, p: -p.a * x.y[0] + u[0], {"a": 1.0})
    assert plant.kinds == {"y": ""}
