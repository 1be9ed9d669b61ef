"""Effects that are not in the catalogue: free functions at places of the specimen, and their formulas."""
