"""What columns take beside those of a model, against least squares itself."""

import numpy as np
import pytest

from eoi_jax.discovery.candidates import CandidateColumns
from eoi_jax.discovery.screening import Terms
from eoi_jax.models.augmented import place
from eoi_jax.models.effects import AsymmetricFriction, LinearStiffness
from eoi_jax.models.library import pendulum

ROWS = 200


def left(columns, target):
    return float(np.sum((target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]) ** 2))


@pytest.mark.parametrize("size", [1.0, 1e-90])
def test_what_an_atom_takes_is_that_of_least_squares_in_any_unit(size):
    """The product of two squares of 1e-180 is zero; neither of them is."""
    draw = np.random.default_rng(0)
    model, target = draw.standard_normal((ROWS, 3)), draw.standard_normal(ROWS)
    one, two = draw.standard_normal((ROWS, 1)), draw.standard_normal((ROWS, 2))
    plant = pendulum()
    atoms = [
        CandidateColumns(place(plant, LinearStiffness(), 0), (), size * one),
        CandidateColumns(place(plant, AsymmetricFriction(), 0), (), size * two),
    ]
    terms = Terms(atoms, np.ones(ROWS))
    got = terms.by_atom(terms.project(model, target))
    want = [left(model, target) - left(np.hstack([model, own]), target) for own in (one, two)]
    np.testing.assert_allclose(got, want, rtol=1e-9)
