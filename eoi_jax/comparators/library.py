"""The methods that `compare` knows."""

from eoi_jax.comparators.comparator import AbstractComparator
from eoi_jax.comparators.instruments import Instruments
from eoi_jax.comparators.output_error import OutputError
from eoi_jax.comparators.plain import PlainExplicit, PlainImplicit
from eoi_jax.comparators.refined import Refined
from eoi_jax.comparators.svf import StateVariableFilter
from eoi_jax.comparators.svf_iv import StateVariableInstruments
from eoi_jax.comparators.vss_direct import VSSDirect


def standard() -> tuple[AbstractComparator, ...]:
    """Every method of the library, one of each kind: the paper's, its refinement, then others.

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
