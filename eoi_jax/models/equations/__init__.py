"""Models whose equations are text: a grammar without code, and the plant that such a text is."""
