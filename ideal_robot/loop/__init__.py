"""The identified closed loop of controller and arm."""
