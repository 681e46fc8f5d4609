"""Effects as a measured TCP shows them."""
