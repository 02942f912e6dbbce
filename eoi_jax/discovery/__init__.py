"""What a model lacks: the residual, the effects that may explain it, and what decides."""
