"""The closed loop of controller and arm as it was identified."""
