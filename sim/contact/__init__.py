"""The simulated contact: tip, force sensor, clamp, payload."""
