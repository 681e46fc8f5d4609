"""Recordings with a hidden effect of a sensor: a device at the tool or behind the gears, a force sensor, a camera."""
