"""Models of plants, what can be added to them, and their equations."""
