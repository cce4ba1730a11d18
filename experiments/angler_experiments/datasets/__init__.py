"""Dataset files, and measurements of datasets."""
