"""From wrenches to positional deviations."""
