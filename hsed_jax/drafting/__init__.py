"""The first study of a campaign: priors and values from the data, for a user to go on from."""
