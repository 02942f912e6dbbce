"""Identify dynamical systems from the equivalent output injection of sliding-mode observers.

Names are imported at their first use (`lazy_loader`); the stub next to this file says from where.
"""

import lazy_loader

from eoi_jax import _display

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

_display.register_in("eoi_jax.models.storage", "eoi_jax.report.displays")
