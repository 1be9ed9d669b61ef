"""Where to experiment next: the discrepancy, its Kriging surrogate, the acquisition and the sequential loop."""
