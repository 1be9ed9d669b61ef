"""What a fitted specimen does: numerical experiments on it, and what an engineer reads from them."""
