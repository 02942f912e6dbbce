"""Engines: who compiles the loop of a pass over many lanes, and for what machine.

They are imported at their first use (`lazy_loader`): one pass of one record needs none of them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
