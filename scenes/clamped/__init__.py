"""Scenes with the flange held: clamped recordings, and the stiffness that follows from them."""
