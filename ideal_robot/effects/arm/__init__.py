"""Effects as measured arm angles show them."""
