"""The best set of causes by one score: whitened rows, priors, and the search. See ``studies.one_score``."""
