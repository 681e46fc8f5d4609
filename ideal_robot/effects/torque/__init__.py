"""Effects as motor torques show them."""
