"""Reference paths, their speed, inverse kinematics, and the desired path over the horizon."""
