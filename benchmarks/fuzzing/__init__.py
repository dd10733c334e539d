"""What fuzz.py does to files: values, fits (structure), files (everything else, and the door)."""
