"""From a clamped flange to a path: an arm without any device on its arm side learns what its gears give."""
