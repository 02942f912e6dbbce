"""Engines: who compiles a pass over many lanes, for what machine (`eoi_jax.estimation.engines`)."""

from eoi_jax.estimation.engines import *  # noqa: F403
