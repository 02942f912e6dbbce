"""Linear systems become plants that simulate as python-control simulates them."""

from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi

TIME = np.arange(0.0, 5.0, 2e-3)
DRIVE = eoi.excitation.multisine(TIME, 1.0, (0.2, 4.0), 15, 0)
TWO = np.stack([DRIVE, np.roll(DRIVE, 700)], axis=1)
COUPLED = [[0, 1, 0, 0], [-30, -1, 10, 0.1], [0, 0, 0, 1], [10, 0.1, -20, -2]]


def space(a, b, c, d: Any = 0.0, **more):
    """A state-space system of any package."""
    c = np.atleast_2d(c)
    d = np.zeros((len(c), np.shape(b)[1])) if np.isscalar(d) and d == 0 else np.atleast_2d(d)
    return SimpleNamespace(A=np.array(a), B=np.array(b), C=c, D=d, **more)


def transfer(num, den, **more):
    return SimpleNamespace(num=[[np.array(num)]], den=[[np.array(den)]], **more)


def cases(control):
    return {
        "an oscillator": (control.ss([[0, 1], [-20, -3]], [[0], [2]], [[1, 0]], 0), DRIVE),
        "states of no meaning": (
            control.similarity_transform(
                control.ss([[0, 1], [-20, -3]], [[0], [2]], [[1, 0]], 0), np.array([[2, 1], [1, 3]])
            ),
            DRIVE,
        ),
        "one zero": (control.tf([2, 3], [1, 4, 25]), DRIVE),
        "two zeros": (control.tf([2, 3, 7], [1, 4, 25, 30, 20]), DRIVE),
        "feed-through": (control.tf([2, 3, 7], [1, 4, 25]), DRIVE),
        "a dead time": (control.tf(*control.pade(0.2, 2)) * control.tf([2], [1, 1]), DRIVE),
        "feed-through of states": (
            control.ss([[0, 1], [-20, -3]], [[0], [2]], [[1, 0]], 0.5), DRIVE,
        ),
        "two of both": (
            control.ss(COUPLED, [[0, 0], [1, 0], [0, 0], [0, 2]],
                       [[1, 0, 0, 0], [0, 0, 1, 0]], np.zeros((2, 2))), TWO,
        ),
    }  # fmt: skip


@pytest.mark.parametrize(
    "case",
    [
        "an oscillator",
        "states of no meaning",
        "one zero",
        "two zeros",
        "feed-through",
        "a dead time",
        "feed-through of states",
        "two of both",
    ],
)
def test_a_plant_runs_as_the_system_that_it_is_made_from(case):
    control = pytest.importorskip("control", reason="python-control is not installed")
    system, drive = cases(control)[case]
    plant = eoi.plant_from_control(system)
    ours = eoi.simulate(plant, TIME, drive).outputs.T
    theirs = control.forced_response(system, TIME, drive.T).outputs.reshape(ours.shape)
    # Both take the input as straight lines; ours is Runge-Kutta of order four or more.
    np.testing.assert_allclose(ours, theirs, atol=1e-7 * np.max(np.abs(theirs)))


def test_names_and_values_are_those_of_the_highest_derivative():
    system = space(
        [[0, 1], [-20, -3]], [[0], [2]], [1, 0], input_labels=["force"], output_labels=["x"]
    )
    plant = eoi.plant_from_control(system)
    assert plant.parameters == pytest.approx({"a0": -20.0, "a1": -3.0, "b": 2.0})
    assert (plant.inputs, plant.outputs, plant.degrees) == (("force",), ("x",), (2,))
    x = eoi.State(jnp.array([[0.5], [2.0]]), jnp.zeros(0))
    value = plant.derivative(jnp.zeros(()), x, jnp.array([3.0]), jnp.asarray(plant.theta))
    assert float(value[0]) == pytest.approx(-20 * 0.5 - 3 * 2.0 + 2 * 3.0)


def test_several_channels_carry_their_names_and_zeros_are_no_parameters():
    system = space(COUPLED, [[0, 0], [1, 0], [0, 0], [0, 2]], [[1, 0, 0, 0], [0, 0, 1, 0]])
    plant = eoi.plant_from_control(system)
    assert plant.degrees == (2, 2)
    assert plant.parameters["a0_y1_y2"] == pytest.approx(10.0)
    assert plant.parameters["b_y2_u2"] == pytest.approx(2.0)
    assert "b_y1_u2" not in plant.parameters


def test_zeros_become_internal_states():
    plant = eoi.plant_from_control(transfer([2, 3], [1, 4, 25]))
    assert plant.degrees == (1,)
    # (s² + 4 s + 25) = (s + 3/2)(s + 5/2) + 85/4, divided by hand.
    expected = {"a0": -2.5, "b": 2.0, "q0": 1.5, "c0": -21.25}
    assert plant.parameters == pytest.approx(expected)


def test_its_parameters_are_identified():
    plant = eoi.plant_from_control(space([[0, 1], [-20, -3]], [[0], [2]], [1, 0]))
    record = eoi.simulate(plant, TIME, DRIVE)
    start = plant.with_parameters({"a0": -16.0, "a1": -2.0, "b": 1.5})
    found = eoi.identify(start, record).parameters
    assert found == pytest.approx(plant.parameters, rel=1e-2)


def test_feed_through_and_a_zero_in_the_right_half_plane_are_refined_and_stored(tmp_path):
    for system in (transfer([2, 3, 7], [1, 4, 25]), transfer([-1, 5], [1, 4, 25])):
        plant = eoi.plant_from_control(system)
        record = eoi.simulate(plant, TIME, DRIVE)
        start = plant.with_parameters({key: 1.1 * v for key, v in plant.parameters.items()})
        found = eoi.refine(start, record)
        assert found.parameters == pytest.approx(plant.parameters, rel=1e-4)
        found.save(tmp_path / "found.npz")
        again = eoi.load(tmp_path / "found.npz")
        np.testing.assert_array_equal(
            eoi.simulate(again.plant, TIME, DRIVE).outputs,
            eoi.simulate(found.plant, TIME, DRIVE).outputs,
        )


@pytest.mark.parametrize(
    ("system", "message"),
    [
        (transfer([1], [1, 2], dt=0.1), "must be continuous in time, got a sample period of 0.1"),
        (3, "must have A, B, C, D or num, den, got a int"),
        (transfer([1, 2, 1], [1, 3]), "must have no more zeros than poles, got 2 zeros, 1 pole"),
        (
            space(np.diag([-1.0, -2.0]), np.eye(2), np.eye(2), np.eye(2)),
            "no direct feed-through where it has several .*, got D",
        ),
        (space([[-1.0]], [[0.0]], [1.0]), "must have an input that reaches `y`, got none"),
        (space(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0))), "must have states"),
        (space([[-1.0]], np.zeros((1, 0)), [1.0]), "must have an input, got none"),
        (transfer([1, -1], [1, 3, -4]), "no pole at a zero"),
        (transfer([1, -2], [1, 3, -4]), "stable poles where it has feed-through or zeros .*poles"),
        (transfer([1, 1], [1, 3, 2]), "no pole at a zero.*minimal realisation"),
        (space(np.diag([-1, -2]), [[1], [1]], [1, 0]), "no pole at a zero"),
        (
            space(np.diag([-1, -2, -3]), [[1, 0], [0, 1], [1, 1]], [[1, 1, 0], [0, 0, 1]]),
            "must have no zeros where it has several inputs or outputs, got 3 states, of which 2",
        ),
        (
            SimpleNamespace(num=[[[1.0], [2.0]]], den=[[[1.0, 2.0], [1.0, 3.0]]]),
            "must be one transfer function, got 2 channels",
        ),
        (
            space([[0, 1, 0, 0], [-3, -1, 0, 0], [0, 0, 0, 1], [0, 0, -3, -1]],
                  [[0, 0], [1, 0], [0, 0], [0, 1]], [[1, 0, 0, 0], [2, 0, 0, 0]]),
            "must have states that follow from its outputs",
        ),
    ],
)  # fmt: skip
def test_what_has_no_chain_form_is_refused_with_the_reason(system, message):
    with pytest.raises(ValueError, match=f"`system` .*{message}"):
        eoi.plant_from_control(system)
