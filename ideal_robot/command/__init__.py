"""The command channel: which command makes a joint move so, behind whatever controller."""
