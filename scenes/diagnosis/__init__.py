"""Pages about a diagnosis."""
