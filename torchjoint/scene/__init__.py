"""The data of all steps: a :class:`Scene` of points and posed :class:`Frame` s, and its :class:`Segmentation`.

Conventions of the whole package (:mod:`torchjoint.datasets` converts other conventions once, when it reads data):

========================  =====================  ==========================================================
name                      shape, dtype           meaning
========================  =====================  ==========================================================
``points``                [N, 3] float32         metres, world frame
``colors``                [N, 3] float32         RGB in [0, 1]
``normals``               [N, 3] float32         unit length, world frame
``image``                 [3, H, W] float32      RGB in [0, 1]
``intrinsics``            [3, 3] float64         pixels; pixel *centres* have integer coordinates
``world_to_camera``       [4, 4] float64         rigid; OpenCV axes (x right, y down, z forward)
``depth``                 [H, W] float32         metres along z; 0 = unknown
``labels``                int64                  -1 = none
========================  =====================  ==========================================================
"""

from torchjoint.scene.cloud import Cloud
from torchjoint.scene.frame import Frame
from torchjoint.scene.hierarchy import Hierarchy
from torchjoint.scene.masks import Masks
from torchjoint.scene.scene import Scene, Truth
from torchjoint.scene.segmentation import LabelImages, Segmentation

__all__ = ["Cloud", "Frame", "Hierarchy", "LabelImages", "Masks", "Scene", "Segmentation", "Truth"]
