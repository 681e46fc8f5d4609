"""Following a line that a camera sees: fusion of its fields to a map of deviations over arc length."""
