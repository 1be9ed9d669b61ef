"""What leaves the package for other programs and for papers: a calibrated law as an OpenSees script, its parameters as a table."""
