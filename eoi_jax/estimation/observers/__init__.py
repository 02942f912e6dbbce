"""Sliding-mode observers; one file each."""

from eoi_jax.estimation.observers.first_order import FirstOrder as FirstOrder
from eoi_jax.estimation.observers.gain_sets import GainSets as GainSets
from eoi_jax.estimation.observers.gain_sets import gains as gains
from eoi_jax.estimation.observers.high_order import HighOrder as HighOrder
from eoi_jax.estimation.observers.measurement import Measurement as Measurement
from eoi_jax.estimation.observers.observer import AbstractObserver as AbstractObserver
from eoi_jax.estimation.observers.observer import Observation as Observation
from eoi_jax.estimation.observers.per_output import PerOutput as PerOutput
from eoi_jax.estimation.observers.second_order import SecondOrder as SecondOrder
from eoi_jax.estimation.observers.super_twisting import SuperTwisting as SuperTwisting
