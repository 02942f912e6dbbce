"""Scripts that measure what the library claims, in a folder a question; run them by their path."""
