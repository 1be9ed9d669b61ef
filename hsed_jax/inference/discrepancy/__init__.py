"""The model discrepancy beyond the noise, learned with the parameters: over the inputs, or over the response cycles."""
