"""Before step 3, for recordings without a cloud: adds a depth image to a truncated signed distance volume."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array, check_number

#: Voxels along a side of a block.
SIDE = 8
#: Sums of a voxel: distances, weights, and three colours.
CHANNELS = 5
#: A distance of one truncation in the sums.
UNIT = 2**14
#: A voxel ignores further images. So the sums fit 32 bits.
MAX_WEIGHT = 2**16


def integrate_depth(
    sums: Tensor,
    row: Tensor,
    block: Tensor,
    depth: Tensor,
    color: Tensor,
    intrinsics: Tensor,
    world_to_camera: Tensor,
    voxel_size: float,
    truncation: float,
    far: float,
) -> None:
    """Add what a depth image says of some blocks of voxels to their sums, in place (Curless and Levoy 1996).

    A voxel whose centre the camera sees, not farther than ``truncation`` behind the measured surface, gets the signed
    distance to it along the ray (positive in front, in units of ``truncation / UNIT``, at most ``UNIT``), a weight of
    one, and the colour of the pixel. All sums are of whole numbers: the order of images does not matter.

    Args:
        sums: ``[B, 512, 5]`` int32, contiguous: sums of distances, weights, red, green, blue of the voxels of each
            block, which are numbered as an array ``[8, 8, 8]``. Changed in place.
        row: ``[K]`` int64, ascending: the row in ``sums`` of each block to change.
        block: ``[K, 3]`` int64, position of these blocks in units of 8 voxels.
        depth: ``[H, W]`` float32 metres; pixels that are not in (0, ``far``], such as 0 and NaN, measured nothing.
        color: ``[H, W, 3]`` uint8 RGB.
        intrinsics: ``[3, 3]`` float64 pixels.
        world_to_camera: ``[4, 4]`` float64, a rigid transform.
        voxel_size: length of a voxel's side, metres.
        truncation: metres.
        far: metres.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, rows that do not ascend or do not exist, a size that is not positive.
    """
    check_array("sums", sums, torch.int32, (None, SIDE**3, CHANNELS), "[B, 512, 5]")
    check_array("row", row, torch.int64, (None,), "[K]")
    check_array("block", block, torch.int64, (row.shape[0], 3), f"[K, 3] = [{row.shape[0]}, 3]")
    check_array("depth", depth, torch.float32, (None, None), "[H, W]")
    check_array("color", color, torch.uint8, (*depth.shape, 3), f"[H, W, 3] = [{depth.shape[0]}, {depth.shape[1]}, 3]")
    check_array("intrinsics", intrinsics, torch.float64, (3, 3), "[3, 3]")
    check_array("world_to_camera", world_to_camera, torch.float64, (4, 4), "[4, 4]")
    for name, value in (("voxel_size", voxel_size), ("truncation", truncation), ("far", far)):
        check_number(name, value, (int, float))
    call(
        torch.ops.torchjoint.integrate_depth.default,
        *(sums, row, block, depth, color, intrinsics, world_to_camera, voxel_size, truncation, far),
    )


@torch.library.register_fake("torchjoint::integrate_depth")
def _fake(*_: object) -> None:
    return None
