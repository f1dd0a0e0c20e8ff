"""torchjoint: joint, class-agnostic instance segmentation of a point cloud and posed images, on a CPU.

>>> import torchjoint as tj
>>> synthetic = tj.synthetic.make_scene(seed=0)
>>> result = tj.JointSegmenter()(synthetic.scene)
>>> result.points.shape, result.images[0].shape
(torch.Size([6000]), torch.Size([120, 160]))
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torchjoint import datasets, masks, metrics, ops, synthetic, transforms
    from torchjoint.config import Config, SuperpointsConfig
    from torchjoint.datasets import load_scene
    from torchjoint.joint import JointSegmenter
    from torchjoint.live import LiveResult, LiveSegmenter
    from torchjoint.oversegmentation import Superpoints, superpoints
    from torchjoint.recordings.batch import BatchReport, batch
    from torchjoint.recordings.segment import RecordingOptions
    from torchjoint.results.folder import load_result
    from torchjoint.results.result import Result
    from torchjoint.scene import Cloud, Frame, Hierarchy, LabelImages, Masks, Scene, Segmentation, Truth
    from torchjoint.scene.frame import PoseWarning
    from torchjoint.synthetic import SyntheticScene

__version__ = version("torchjoint")

__all__ = [
    "BatchReport", "Cloud", "Config", "Frame", "Hierarchy", "JointSegmenter", "LabelImages", "LiveResult",
    "LiveSegmenter", "Masks", "PoseWarning", "RecordingOptions", "Result", "Scene", "Segmentation", "Superpoints",
    "SuperpointsConfig", "SyntheticScene", "Truth", "batch", "datasets", "load_result", "load_scene", "masks",
    "metrics", "ops", "superpoints", "synthetic", "transforms",
]  # fmt: skip

#: Where each public name is; it is imported when it is first used, so that ``import torchjoint`` is quick.
_HOMES = {
    name: home
    for home, names in {
        "config": "Config SuperpointsConfig",
        "datasets": "load_scene",
        "joint": "JointSegmenter",
        "live": "LiveResult LiveSegmenter",
        "oversegmentation": "Superpoints superpoints",
        "recordings": "BatchReport RecordingOptions batch",
        "results.folder": "load_result",
        "results.result": "Result",
        "scene": "Cloud Frame Hierarchy LabelImages Masks Scene Segmentation Truth",
        "synthetic": "SyntheticScene",
        "scene.frame": "PoseWarning",
    }.items()
    for name in names.split()
}


def __getattr__(name: str) -> Any:
    """Imports a public name, or a module of the package, at its first use."""
    if name in _HOMES:
        value = getattr(import_module(f"torchjoint.{_HOMES[name]}"), name)
    elif name in __all__:
        value = import_module(f"torchjoint.{name}")
    else:
        raise AttributeError(f"module 'torchjoint' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """What completion offers after `tj.`: the public names alone."""
    return [*__all__, "__version__"]
