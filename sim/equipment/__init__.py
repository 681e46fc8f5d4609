"""The simulated arm with its sensors, each behind its device's seam."""
