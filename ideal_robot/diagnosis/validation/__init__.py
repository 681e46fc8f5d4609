"""What carries over to other data, and the results."""
