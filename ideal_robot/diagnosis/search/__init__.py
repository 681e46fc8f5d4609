"""Selection of effects."""
