"""Fits and tests on blocks of time."""
