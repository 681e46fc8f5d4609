"""The identified model of an arm, and its file."""
