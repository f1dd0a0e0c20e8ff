"""Training the boundary detector: structured forests on images that people have segmented.

In the order in which data moves: :mod:`channels` of an image, :mod:`features` of a patch, :mod:`patches` drawn from
all images as samples, one :mod:`tree` grown from them, and :mod:`train` for all trees. :mod:`detect` runs a forest.
"""

from torchjoint.training.train import TrainingOptions, train_boundaries
from torchjoint.training.tree import TreeOptions

__all__ = ["TrainingOptions", "TreeOptions", "train_boundaries"]
