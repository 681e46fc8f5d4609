"""Simulated devices: the other ends of the interfaces to real ones."""
