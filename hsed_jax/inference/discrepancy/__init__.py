"""How wrong a model is beyond its noise, learned with its parameters: over the inputs, or over the cycles of the response."""
