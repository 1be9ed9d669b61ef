"""The first study of a campaign: priors and values from the data, which a user can continue from."""
