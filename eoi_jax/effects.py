"""Effects that a model may lack, and what one of your own must be (`eoi_jax.models.effects`)."""

from eoi_jax.models.effects import *  # noqa: F403
