"""Running a study: its folder and journal, its design as it is conducted, its steps in order."""
