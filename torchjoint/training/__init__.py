"""Trains the boundary detector: structured forests on images with human segmentations.

Modules in the order of the data flow: :mod:`channels` of an image, :mod:`features` of a patch, :mod:`patches` sampled
from all images, one :mod:`tree` grown from the samples, and :mod:`train` for all trees. :mod:`detect` runs a forest.
"""

from torchjoint.training.train import TrainingOptions, train_boundaries
from torchjoint.training.tree import TreeOptions

__all__ = ["TrainingOptions", "TreeOptions", "train_boundaries"]
