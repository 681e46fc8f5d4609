"""Plans, runs and reports identification motions."""
