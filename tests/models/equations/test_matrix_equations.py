"""Coupled inertia is shown as the matrix equation that it is, and its formulas are the model's."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.linalg import cho_factor, cho_solve

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.models.equations.display import equation_latex, equation_lines, equation_text
from eoi_jax.models.equations.expression import Symbol, value_of
from eoi_jax.models.equations.right_sides import right_sides
from eoi_jax.report.mathml import equation_mathml

VALUES = {"a": 2.0, "b": 0.5, "d": 0.7, "c1": 0.1, "c2": 0.2}
PARTS = [
    "where M11 = a + 2·b·cos(q2)",
    "where M12 = M21 = d + b·cos(q2)",
    "where M22 = d",
    "where F1 = t1 + b·sin(q2)·q2'·(2·q1' + q2') - c1·q1'",
    "where F2 = t2 - b·sin(q2)·q1'² - c2·q2'",
]


def sides(x, u, p):
    """Mass matrix and forces of a two-joint arm."""
    (_, q2), (v1, v2) = x.y[:2, :2]
    coupling, pull = p.b * jnp.cos(q2), p.b * jnp.sin(q2)
    mass = jnp.array([[p.a + 2.0 * coupling, p.d + coupling], [p.d + coupling, p.d]])
    inertial = jnp.stack([pull * v2 * (2.0 * v1 + v2), -(pull * v1**2)])
    return mass, u + inertial - jnp.stack([p.c1 * v1, p.c2 * v2])


def by_hand(mass, force):
    (m11, m12), (_, m22) = mass
    determinant = m11 * m22 - m12**2
    first, second = m22 * force[0] - m12 * force[1], m11 * force[1] - m12 * force[0]
    return jnp.stack([first / determinant, second / determinant])


SOLVED = {
    "solve": jnp.linalg.solve,
    "inv": lambda mass, force: jnp.linalg.inv(mass) @ force,
    "einsum": lambda mass, force: jnp.einsum("ij,j->i", jnp.linalg.inv(mass), force),
    "cholesky": lambda mass, force: cho_solve(cho_factor(mass), force),
    "cholesky_lower": lambda mass, force: cho_solve(cho_factor(mass, lower=True), force),
    "by_hand": by_hand,
    "half": lambda mass, force: 0.5 * jnp.linalg.solve(0.5 * mass, force),
}


def arm(solved: Callable[..., Any] = jnp.linalg.solve, **more):
    def dynamics(t, x, u, p):
        return solved(*sides(x, u, p))

    return eoi.Plant(dynamics, VALUES, 2, ("t1", "t2"), ("q1", "q2"), name="arm", **more)


def sensing(t, x, u, p):
    """The arm with an accelerometer at its first joint, and a motor that is not measured."""
    acceleration = jnp.linalg.solve(*sides(x, u, p))
    return jnp.stack([*acceleration, 3.0 * acceleration[0]])


def loaded(t, x, u, p):
    """One joint of the two is measured."""
    position, speed = jnp.stack([x.y[0, 0], x.z[0]]), jnp.stack([x.y[1, 0], x.z[1]])
    return jnp.linalg.solve(*sides(eoi.State(jnp.stack([position, speed]), x.z), u, p))


PLANTS = {
    **{name: (lambda solved=solved: arm(solved)) for name, solved in SOLVED.items()},
    "sensing": lambda: eoi.Plant(sensing, VALUES, (2, 2, 0), ("t1", "t2"), ("q1", "q2", "acc")),
    "loaded": lambda: eoi.Plant(
        lambda *args: loaded(*args)[:1], VALUES, 2, ("t1", "t2"), ("q1",),
        internal=lambda t, x, u, p: jnp.stack([x.z[1], loaded(t, x, u, p)[1]]),
        internal_initial=[0.0, 0.0],
    ),
}  # fmt: skip


@pytest.mark.parametrize("extended", [(), (0,)])
@pytest.mark.parametrize("name", PLANTS)
def test_the_formulas_that_are_shown_are_the_model(name, extended):
    plant = PLANTS[name]()
    shown = right_sides(plant, extended)
    assert shown is not None
    draw, theta = np.random.default_rng(5), jnp.asarray(plant.theta)
    y = draw.uniform(-1.0, 1.0, (plant.rows, len(plant.outputs))) * (
        np.arange(plant.rows)[:, None] < np.asarray(plant.degrees)
    )
    z, u = draw.uniform(-1.0, 1.0, len(plant.initial_internal)), draw.uniform(-1.0, 1.0, 2)
    values = {Symbol(key, parameter=True): value for key, value in plant.parameters.items()}
    for j, output in enumerate(plant.outputs):
        values |= {Symbol(output, i): y[i, j] for i in range(plant.degrees[j])}
    values |= {Symbol(f"z{i + 1}"): value for i, value in enumerate(z)}
    values |= dict(zip(map(Symbol, plant.inputs), u, strict=True))
    for symbol, tree in shown.definitions:
        values[symbol] = value_of(tree, values, np)
    for equation in shown.coupled:
        matrix = [[value_of(tree, values, np) for tree in row] for row in equation.matrix]
        right = [value_of(tree, values, np) for tree in equation.right]
        values |= dict(zip(equation.unknown, np.linalg.solve(matrix, right), strict=True))
    f = [
        values[Symbol(output, degree)] if tree is None else value_of(tree, values, np)
        for output, degree, tree in zip(plant.outputs, plant.degrees, shown.f, strict=True)
    ]
    state = eoi.State(jnp.asarray(y), jnp.asarray(z))
    arguments = jnp.asarray(0.0), state, jnp.asarray(u), theta
    np.testing.assert_allclose(f, plant.derivative(*arguments), rtol=1e-12)
    g = [value_of(tree, values, np) for tree in shown.g]
    np.testing.assert_allclose(g, plant.internal_rate(*arguments), rtol=1e-12)


@pytest.mark.parametrize("name", ["solve", "inv", "einsum", "cholesky", "cholesky_lower"])
def test_a_solved_system_is_shown_as_it_is_written_down(name):
    assert equation_text(arm(SOLVED[name])).splitlines() == ["M·[q1''; q2''] = F", *PARTS]


def test_values_stand_in_the_entries_too():
    lines = equation_text(arm(), numeric=True).splitlines()
    assert lines[1:4] == [
        "where M11 = 2 + 2·0.5·cos(q2)",
        "where M12 = M21 = 0.7 + 0.5·cos(q2)",
        "where M22 = 0.7",
    ]


def test_a_sensor_of_an_acceleration_shows_it_by_its_name():
    assert equation_text(PLANTS["sensing"]()).splitlines()[:2] == [
        "M·[q1''; q2''] = F",
        "acc = 3·q1''",
    ]


def test_where_only_a_part_is_measured_the_solution_has_names():
    assert equation_text(PLANTS["loaded"]()).splitlines()[:4] == [
        "M·[w1; w2] = F",
        "q1'' = w1",
        "z1' = z2",
        "z2' = w2",
    ]


def test_what_is_added_to_an_acceleration_stands_behind_the_solution():
    friction = SimpleNamespace(
        effect=effects.CoulombFriction(), output="q1", against=None, through=None,
        parameters={"level": 0.3},
    )  # fmt: skip
    lines = equation_text(arm(), [friction]).splitlines()
    assert lines == ["M·[w1; w2] = F", "q1'' = w1 - level·sign(q1')", "q2'' = w2", *PARTS]
    friction.through = "t1"  # as a force it leaves the equation as it is
    lines = equation_text(arm(), [friction]).splitlines()
    assert lines == ["M·[q1''; q2''] = F", *PARTS, "with t1 → t1 - level·sign(q1')"]


def test_letters_of_the_model_are_not_used_again():
    values = {"M": 2.0, "F2": 0.3}

    def dynamics(t, x, u, p):
        mass = jnp.array([[p.M, p.F2], [p.F2, 1.0]])
        return jnp.linalg.solve(mass, u)

    plant = eoi.Plant(dynamics, values, 2, ("t1", "t2"), ("q1", "q2"))
    assert equation_text(plant).splitlines() == [
        "A·[q1''; q2''] = b",
        "where A11 = M",
        "where A12 = A21 = F2",
        "where A22 = 1",
        "where b1 = t1",
        "where b2 = t2",
    ]


def test_masses_that_are_not_coupled_have_equations_of_their_own():
    def dynamics(t, x, u, p):
        return jnp.linalg.solve(jnp.diag(jnp.stack([p.a, p.b])), u)

    plant = eoi.Plant(dynamics, {"a": 2.0, "b": 3.0}, 2, ("t1", "t2"), ("q1", "q2"))
    assert equation_text(plant).splitlines() == ["q1'' = t1/a", "q2'' = t2/b"]


def test_an_inverse_by_hand_has_names_for_what_it_repeats():
    text = equation_text(arm(by_hand))
    assert "f1" not in text
    first, second, *parts = text.splitlines()
    assert first.startswith("q1'' = (")
    assert second.startswith("q2'' = (")
    assert len(parts) >= 3
    assert all(line.startswith("where w") for line in parts)
    assert max(map(len, text.splitlines())) < 90


def test_a_factor_that_is_no_part_of_a_solution_is_written_out():
    text = equation_text(arm(lambda mass, force: jnp.linalg.cholesky(mass) @ force))
    assert "M" not in text
    assert "f1" not in text
    assert "sqrt(" in text


def test_a_table_is_a_function_of_where_it_is_looked_up():
    def dynamics(t, x, u, p):
        return u - p.k * jnp.interp(x.y[0], jnp.array([-1.0, 0.0, 1.0]), jnp.array([2.0, 0.0, 1.0]))

    plant = eoi.Plant(dynamics, {"k": 1.0}, 2)
    assert equation_text(plant) == "y'' = u - k·interp(y)"


def test_an_exported_document_has_matrices(tmp_path):
    text = eoi.export(arm(), tmp_path / "arm.tex").read_text(encoding="utf-8")
    assert text.count(r"\begin{pmatrix}") == 3
    assert r"\begin{cases}" not in text  # no elimination with its pivots
    assert r"$c_{2}$ & $0.2$ &" in text


def test_latex_and_the_page_have_matrices():
    latex = equation_latex(arm())
    assert latex.count(r"\begin{pmatrix}") == latex.count(r"\end{pmatrix}") == 3
    assert r"\begin{pmatrix} \ddot{q_{1}} \\ \ddot{q_{2}} \end{pmatrix} &= \begin{pmatrix}" in latex
    assert r"a + 2\,b\,\cos\left(q_{2}\right) & d + b\,\cos\left(q_{2}\right) \\" in latex
    assert r"\text{where } w_{1} &= " in equation_latex(arm(by_hand))
    page = equation_mathml(*equation_lines(arm()))
    assert page is not None
    assert page.count("<mtable") == 4  # the lines, and three matrices
