"""What a study found, for people: figures, tables and the report."""
