"""The simulated camera and the surface that it looks at."""
