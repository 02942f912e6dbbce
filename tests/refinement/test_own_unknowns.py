"""The space of a refined model's own unknowns against columns of all of them over all rows."""

import numpy as np
import pytest

from eoi_jax.estimation.regression.orthonormal import orthonormal
from eoi_jax.refinement.own_unknowns import OwnUnknowns


def wide(slopes, start_size):
    """Columns over all rows: those of a start in the rows of its run alone."""
    runs, rows, size = slopes.shape
    columns = np.zeros((runs * rows, runs * start_size + size - start_size))
    for i, part in enumerate(slopes):
        at = slice(i * rows, (i + 1) * rows)
        columns[at, i * start_size : (i + 1) * start_size] = part[:, :start_size]
        columns[at, runs * start_size :] = part[:, start_size:]
    return columns


@pytest.mark.parametrize("kind", ["regular", "a start without trace", "parameters that are one"])
def test_what_is_left_is_orthogonal_to_all_unknowns(kind):
    random = np.random.default_rng(0)
    slopes = random.normal(size=(6, 30, 5)) * np.array([1.0, 1e3, 1e-4, 1.0, 1e2])
    if kind == "a start without trace":
        slopes[2, :, 1] = 0.0
        slopes[4, :, 1] = 3.0 * slopes[4, :, 0]
    if kind == "parameters that are one":
        slopes[..., 4] = slopes[..., 3] + slopes[..., 0]
    own = OwnUnknowns.of(slopes, 2, 1e-9)
    columns = random.normal(size=(180, 4))
    basis = orthonormal(wide(slopes, 2), 1e-9)
    assert own.parameters.shape[1] == (2 if kind == "parameters that are one" else 3)
    expected = columns - basis @ (basis.T @ columns)
    assert own.removed_from(columns) == pytest.approx(expected, abs=1e-12)
    assert own.removed_from(wide(slopes, 2)) == pytest.approx(0.0, abs=1e-9)
