"""Trains the boundary detector of images, and the model of boundaries between regions of points.

The detector: structured forests on images with human segmentations.

Modules in the order of the data flow: :mod:`channels` of an image, :mod:`features` of a patch, :mod:`patches` sampled
from all images, one :mod:`tree` grown from the samples, and :mod:`train` for all trees. :mod:`detect` runs a forest.

The model: :mod:`boundary_examples` makes examples of labelled scenes, :mod:`boundary_model` trains on them,
:mod:`boundary_model_file` writes it; :mod:`superpoint_graph_files` keeps prepared scenes.
"""

from torchjoint.segments.learned.boundary_model import load_boundary_model
from torchjoint_lab.training.boundary_examples import BoundaryModelOptions, labelled_evidence
from torchjoint_lab.training.boundary_model import fit_boundary_model, train_boundary_model
from torchjoint_lab.training.boundary_model_file import save_boundary_model
from torchjoint_lab.training.train import TrainingOptions, train_boundaries
from torchjoint_lab.training.tree import TreeOptions

__all__ = [
    "BoundaryModelOptions",
    "TrainingOptions",
    "TreeOptions",
    "fit_boundary_model",
    "labelled_evidence",
    "load_boundary_model",
    "save_boundary_model",
    "train_boundaries",
    "train_boundary_model",
]
