"""A model as a file that other tools run: one tree of formulas, a printer for each language."""
