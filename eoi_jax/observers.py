"""Sliding-mode observers, and sets of gains (`eoi_jax.estimation.observers`)."""

from eoi_jax.estimation.observers import *  # noqa: F403
