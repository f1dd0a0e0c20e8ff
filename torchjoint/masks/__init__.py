"""Masks of a network for :class:`torchjoint.Frame`: converters from the outputs of networks and their tools.

From memory, each to the :class:`Masks` of one image: :func:`from_labels` (label maps), :func:`from_stack` (one image a
mask), :func:`from_sam` (lists of dicts of SAM's automatic mask generators), :func:`from_coco` (COCO annotations),
:func:`from_panoptic` (a label map and its segments), :func:`from_instances` (Detectron2, Mask2Former).
:func:`from_module` wraps a network itself.

From disk: :func:`read_masks` reads the masks of one frame, :func:`read_folder` those of all frames of a scene, by name.
:func:`save_masks` writes them.

Arguments may be tensors on any device, or NumPy arrays. Every error is a ValueError or TypeError that names the
argument or the file, says what was expected, and what came.
"""

from torchjoint.masks.arrays import from_labels, from_stack
from torchjoint.masks.coco import from_coco
from torchjoint.masks.folder import read_folder, read_masks, save_masks
from torchjoint.masks.module import from_module
from torchjoint.masks.networks import from_instances, from_panoptic, from_sam
from torchjoint.scene.masks import Masks

__all__ = [
    "Masks", "from_coco", "from_instances", "from_labels", "from_module", "from_panoptic", "from_sam", "from_stack",
    "read_folder", "read_masks", "save_masks",
]  # fmt: skip
