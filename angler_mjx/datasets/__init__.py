"""Datasets: run folders of one kind under one manifest, made, judged and read."""
