"""What a user may say, and the objects that are built from it."""
