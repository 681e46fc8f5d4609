"""The line detector on a user's own pictures."""
