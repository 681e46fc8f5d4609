"""Trials of the diagnosis in strangers' physics: closed loops, three engines, a strict score."""
