"""Whether a dataset is what it says: its files, its values, and some of its flights flown again."""
