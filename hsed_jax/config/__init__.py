"""The allowed content of a study."""
