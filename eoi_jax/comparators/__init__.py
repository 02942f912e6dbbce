"""Methods that `eoi_jax.compare` puts beside each other, and what one of your own must be."""

from eoi_jax.comparators.comparator import AbstractComparator as AbstractComparator
from eoi_jax.comparators.comparator import Estimate as Estimate
from eoi_jax.comparators.instruments import Instruments as Instruments
from eoi_jax.comparators.library import standard as standard
from eoi_jax.comparators.output_error import OutputError as OutputError
from eoi_jax.comparators.plain import PlainExplicit as PlainExplicit
from eoi_jax.comparators.plain import PlainImplicit as PlainImplicit
from eoi_jax.comparators.refined import Refined as Refined
from eoi_jax.comparators.svf import StateVariableFilter as StateVariableFilter
from eoi_jax.comparators.svf_iv import StateVariableInstruments as StateVariableInstruments
from eoi_jax.comparators.vss_direct import VSSDirect as VSSDirect
