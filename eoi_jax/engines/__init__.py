"""Engines: who compiles the loop of a pass over many lanes, and for what machine."""

from eoi_jax.engines.automatic import Automatic as Automatic
from eoi_jax.engines.engine import AbstractEngine as AbstractEngine
from eoi_jax.engines.engine import Lanes as Lanes
from eoi_jax.engines.native import Native as Native
from eoi_jax.engines.one_kernel import OneKernel as OneKernel
from eoi_jax.engines.scan import Scan as Scan
