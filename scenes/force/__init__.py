"""Scenes that press: force on a surface, contours, camera and force together."""
