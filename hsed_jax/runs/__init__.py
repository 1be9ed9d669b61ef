"""The run of a study: its folder and journal, the conduct of its design, its steps in order."""
