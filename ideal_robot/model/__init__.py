"""What was identified of an arm, and its file."""
