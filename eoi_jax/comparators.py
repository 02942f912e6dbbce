"""Methods of comparison, and what one of your own must be (`eoi_jax.comparison.methods`)."""

from eoi_jax.comparison.methods import *  # noqa: F403
