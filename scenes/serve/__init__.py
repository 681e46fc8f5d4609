"""The simulated cell as devices in a process of its own, in real time."""
