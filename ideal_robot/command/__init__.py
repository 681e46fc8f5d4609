"""The command law: which command makes a joint move as desired, behind any controller."""
