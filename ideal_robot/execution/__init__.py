"""What an arm has to offer to be commanded."""
