"""What a sweep is made of: its plan, the steps of its records, one chunk of it, its store.

Modules are imported at their first use (`lazy_loader`).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, submodules=["best", "sweep"])
