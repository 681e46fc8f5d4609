"""Plans the motion that resolves the open questions of a diagnosis."""
