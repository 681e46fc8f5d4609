"""Regressions of what a recording has: motor torques, arm angles, TCP, force sensor, camera."""
