"""The motion that a diagnosis asks for: what it left open, and what would tell."""
