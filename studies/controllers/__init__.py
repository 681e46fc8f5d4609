"""Arms behind joint controllers of many kinds, for the study of the command law."""
