"""Models from recordings."""
