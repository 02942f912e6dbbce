"""Least squares on the injection: batch and recursive form, and the index of a pass."""

from eoi_jax.estimation.regression.index import index as index
from eoi_jax.estimation.regression.least_squares import Solution as Solution
from eoi_jax.estimation.regression.least_squares import least_squares as least_squares
from eoi_jax.estimation.regression.least_squares import untraced as untraced
from eoi_jax.estimation.regression.recursive_least_squares import (
    RecursiveLeastSquares as RecursiveLeastSquares,
)
from eoi_jax.estimation.regression.recursive_least_squares import recursive as recursive
