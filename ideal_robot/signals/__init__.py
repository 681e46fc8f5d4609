"""Recordings, and what is done to their signals before anything is fitted."""
