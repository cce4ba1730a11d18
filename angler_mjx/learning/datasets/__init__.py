"""Datasets: run folders of one kind under one manifest; generation, verification, reading.

from angler_mjx.learning import datasets

train = datasets.open("datasets/reef", split="train")
windows = train.windows(64, of="robot", neighbours=3)
"""

from angler_mjx.learning.datasets.dataset import Dataset
from angler_mjx.learning.datasets.dataset import open_dataset as open
from angler_mjx.learning.datasets.episode import Episode
from angler_mjx.learning.datasets.windows import Windows

__all__ = ["Dataset", "Episode", "Windows", "open"]
