"""Motions in contact: pressing on a surface, following a contour, and when to stop."""
