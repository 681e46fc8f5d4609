"""Planning, playing and reporting identification motions."""
