"""The inner loop: models, feedforward, identification and diagnosis of a position-controlled arm."""
