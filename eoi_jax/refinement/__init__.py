"""Output error: the free run itself is fitted to the measured outputs."""
