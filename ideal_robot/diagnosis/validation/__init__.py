"""Transfer of a diagnosis to other data, and its results."""
