"""Free runs of a model."""
