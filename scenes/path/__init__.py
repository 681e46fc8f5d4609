"""Scenes of tool paths known beforehand."""
