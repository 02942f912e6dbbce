"""Loops of many lanes as machine code; it knows no plant, observer or pass."""
