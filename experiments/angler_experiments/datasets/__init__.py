"""Dataset files, and what is measured of datasets."""
