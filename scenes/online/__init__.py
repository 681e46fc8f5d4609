"""The online job: what runs in each interpolation cycle, on devices as in simulation; it knows no simulator."""
