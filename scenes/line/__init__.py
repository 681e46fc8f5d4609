"""Scenes that follow a drawn line with a camera."""
