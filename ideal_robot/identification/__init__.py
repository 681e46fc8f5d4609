"""Identifies models from recordings."""
