"""From desired positions over a horizon to the command: every way of correcting a path."""
