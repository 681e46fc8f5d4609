"""Pages, replays and films."""
