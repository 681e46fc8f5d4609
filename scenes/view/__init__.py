"""Shows scenes in a browser."""
