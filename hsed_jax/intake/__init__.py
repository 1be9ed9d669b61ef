"""What a file of a laboratory holds, before anybody declared it: its columns, what they are, the campaign they make."""
