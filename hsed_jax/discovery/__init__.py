"""What the catalogue does not hold: free functions at places of the specimen, and the formulas that they turn out to be."""
