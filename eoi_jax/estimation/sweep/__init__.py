"""What a sweep is made of: its plan, the steps of its records, one chunk of it, its store."""
