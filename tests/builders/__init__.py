"""Studies, campaigns and results that several tests need."""
