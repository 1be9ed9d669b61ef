"""Files of a laboratory without a declaration: their columns, the meaning of these, and the resulting campaign."""
