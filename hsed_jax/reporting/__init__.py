"""The results of a study for readers: figures, tables and the report."""
