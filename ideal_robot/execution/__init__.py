"""Commands for an arm: limits, stops, monitoring, and the execution of paths."""
