"""Datasets: run folders of one kind under one manifest, made, judged and read.

from angler_mjx.learning import datasets

train = datasets.open("datasets/reef", split="train")
windows = train.windows(64, of="robot", neighbours=3)
"""

from angler_mjx.learning.datasets.reading.dataset import Dataset
from angler_mjx.learning.datasets.reading.dataset import open_dataset as open
from angler_mjx.learning.datasets.reading.episode import Episode
from angler_mjx.learning.datasets.reading.windows import Windows

__all__ = ["Dataset", "Episode", "Windows", "open"]
