"""Engines: who compiles the loop of a pass over many lanes, and for what machine."""

from eoi_jax.estimation.engines.automatic import Automatic as Automatic
from eoi_jax.estimation.engines.engine import AbstractEngine as AbstractEngine
from eoi_jax.estimation.engines.engine import Lanes as Lanes
from eoi_jax.estimation.engines.native import Native as Native
from eoi_jax.estimation.engines.pallas import OneKernel as OneKernel
from eoi_jax.estimation.engines.scan import Scan as Scan
