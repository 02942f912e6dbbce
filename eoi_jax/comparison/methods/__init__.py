"""The methods of `eoi_jax.compare`, and the interface of your own."""

from eoi_jax.comparison.methods.comparator import AbstractComparator as AbstractComparator
from eoi_jax.comparison.methods.comparator import Estimate as Estimate
from eoi_jax.comparison.methods.instruments import Instruments as Instruments
from eoi_jax.comparison.methods.library import on_request as on_request
from eoi_jax.comparison.methods.library import standard as standard
from eoi_jax.comparison.methods.output_error import OutputError as OutputError
from eoi_jax.comparison.methods.output_error_optimistix import (
    OptimistixOutputError as OptimistixOutputError,
)
from eoi_jax.comparison.methods.plain import PlainExplicit as PlainExplicit
from eoi_jax.comparison.methods.plain import PlainImplicit as PlainImplicit
from eoi_jax.comparison.methods.refined import Refined as Refined
from eoi_jax.comparison.methods.svf import StateVariableFilter as StateVariableFilter
from eoi_jax.comparison.methods.svf_iv import StateVariableInstruments as StateVariableInstruments
from eoi_jax.comparison.methods.vss_direct import VSSDirect as VSSDirect
