"""The estimator: observers, the pass over a record, its iteration (the paper's sections 3 to 5)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__, submodules=["engines", "observers", "regression"]
)
