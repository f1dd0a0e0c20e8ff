"""torchjoint: joint, class-agnostic instance segmentation of a point cloud and posed images, on a CPU.

>>> import torchjoint as tj
>>> synthetic = tj.synthetic.make_scene(seed=0)
>>> result = tj.JointSegmenter()(synthetic.scene)
>>> result.points.shape, result.images[0].shape
(torch.Size([6000]), torch.Size([120, 160]))
"""

from importlib.metadata import version

from torchjoint import datasets, masks, metrics, ops, synthetic, transforms
from torchjoint.config import Config, SuperpointsConfig
from torchjoint.datasets import load_scene
from torchjoint.joint import JointSegmenter
from torchjoint.recordings import BatchReport, RecordingOptions, batch
from torchjoint.results.loading import load_result
from torchjoint.results.result import Result
from torchjoint.scene import Frame, Scene, Segmentation
from torchjoint.superpoints import Superpoints, superpoints

__version__ = version("torchjoint")

__all__ = [
    "BatchReport",
    "Config",
    "Frame",
    "JointSegmenter",
    "RecordingOptions",
    "Result",
    "Scene",
    "Segmentation",
    "Superpoints",
    "SuperpointsConfig",
    "batch",
    "datasets",
    "load_result",
    "load_scene",
    "masks",
    "metrics",
    "ops",
    "superpoints",
    "synthetic",
    "transforms",
]


def __dir__() -> list[str]:
    """What completion offers after `tj.`: the public names alone."""
    return [*__all__, "__version__"]
