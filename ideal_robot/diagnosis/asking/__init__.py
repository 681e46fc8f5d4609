"""What a diagnosis could not tell, and the motion that would."""
