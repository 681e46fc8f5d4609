"""What runs in each interpolation cycle, on real devices as in simulation, without any simulator."""
