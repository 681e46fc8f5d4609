"""One linear Gaussian estimator: coloured noise, posterior of parameters, predictive score of blocks of time."""
