"""From the pixels of a field to points of a line with standard deviations."""
