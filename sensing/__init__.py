"""From raw sensor values to a positional deviation with its covariance."""
