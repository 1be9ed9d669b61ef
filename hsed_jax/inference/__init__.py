"""From measurements to parameters: priors, likelihood, MAP, NUTS."""
