"""Which effect a model lacks: a search over nested models, by evidence and by prediction."""
