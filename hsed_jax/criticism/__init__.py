"""How wrong the model is, where it fails, and what it lacks."""
