"""The choice of the next experiment: the discrepancy, its Kriging surrogate, the acquisition and the sequential loop."""
