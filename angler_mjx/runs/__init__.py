"""One run: compiled programs, device batches, one scene step by step, and the results folder."""
