"""The methods of `compare`: those that it runs by default, and those that are to be named."""

from eoi_jax.comparison.methods.comparator import AbstractComparator
from eoi_jax.comparison.methods.instruments import Instruments
from eoi_jax.comparison.methods.output_error import OutputError
from eoi_jax.comparison.methods.output_error_optimistix import OptimistixOutputError
from eoi_jax.comparison.methods.plain import PlainExplicit, PlainImplicit
from eoi_jax.comparison.methods.refined import Refined
from eoi_jax.comparison.methods.svf import StateVariableFilter
from eoi_jax.comparison.methods.svf_iv import StateVariableInstruments
from eoi_jax.comparison.methods.vss_direct import VSSDirect


def standard() -> tuple[AbstractComparator, ...]:
    """One instance of every method that runs by default: the paper's, its refinement, then others.

    Returns:
        Comparators in the order of a table.
    """
    return (
        PlainExplicit(),
        PlainImplicit(),
        Instruments(),
        Refined(),
        OutputError(),
        StateVariableFilter(),
        StateVariableInstruments(),
        VSSDirect(),
    )


def on_request() -> tuple[AbstractComparator, ...]:
    """One instance of every method that `compare` runs by name only, for it takes far longer.

    Returns:
        Comparators in the order of a table.
    """
    return (OptimistixOutputError(),)
