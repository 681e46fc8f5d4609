"""How the clocks of devices relate to this computer's."""
