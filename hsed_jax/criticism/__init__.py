"""The size of the model's error, and where the model fails."""
