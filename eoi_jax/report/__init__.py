"""Results as tables and figures: no numerical work."""
