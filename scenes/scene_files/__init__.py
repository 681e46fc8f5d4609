"""Scene files: the tables that a person writes, checked before a run."""
