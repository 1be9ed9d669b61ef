"""How wrong the model is, and where it fails."""
