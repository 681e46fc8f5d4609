"""Effects of force sensors and cameras."""
