"""The discrepancy of a model beyond its noise, learned with its parameters: over the inputs, or over the response cycles."""
