"""The search for the effect that a model lacks, over nested models, by evidence and by prediction."""
