"""Recordings, and the processing of their signals before a fit."""
