"""Regression tests on path error: suites of runs, paired comparison with a baseline, verdicts, and their reports."""
