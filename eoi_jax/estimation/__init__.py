"""The estimator: observers, the pass over a record, its iteration (the paper's sections 3 to 5)."""
