"""Recordings with hidden effects, drawn from a seed, for blind trials of the diagnosis."""
