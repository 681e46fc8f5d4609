"""Recordings in strangers' physics, for trials of the diagnosis."""
