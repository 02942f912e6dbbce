"""Plants: models that come along, `Plant` and `State` (`eoi_jax.models.library`)."""

from eoi_jax.models.library import *  # noqa: F403
