"""Scenes with contact: force on a surface, contours, camera and force together."""
