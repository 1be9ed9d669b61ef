"""The behaviour of a fitted specimen: numerical experiments on it, and the engineering quantities from them."""
