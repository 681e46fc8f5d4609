"""What the makers of arms say: kinematics, nominal inertias, drive data."""
