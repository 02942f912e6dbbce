"""The estimator: observers, the pass over a record, its iteration (sections 3 to 5 of the paper).

Read `identify` (the estimator), `iteration` (section 4), `kernel` (one pass over a record) and
`observers/` (section 3), in this order.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__, submodules=["engines", "observers", "regression"]
)
