"""What a user may say in a study."""
