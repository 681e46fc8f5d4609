"""The scene in a browser."""
