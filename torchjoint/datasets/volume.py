"""A truncated signed distance volume into which depth images are fused (Curless and Levoy 1996)."""

import mmap
import os
from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from torchjoint.ops.internal import CHANNELS, SIDE, UNIT, integrate_depth
from torchjoint.runtime.groups import find
from torchjoint.runtime.store import OffloadFile
from torchjoint.runtime.threads import all_threads, parallel_map

#: Most blocks of a volume: 5 GB.
MOST_BLOCKS = 2**19
#: Bytes of a block.
BLOCK = SIDE**3 * CHANNELS * 4
#: Blocks whose surface is extracted at once.
AT_ONCE = 2048
#: Values farther from the surface, in units of the truncation, give no surface.
SURFACE = 0.98
#: Bits of a block's coordinate in its key.
_BITS = 21
_STEPS = torch.tensor([1 << 2 * _BITS, 1 << _BITS, 1], device="cpu")


class Volume:
    """Blocks of 8 x 8 x 8 voxels near the surface, which are found by their position.

    Each image adds whole numbers to the sums of the blocks that it sees, so the volume does not depend on the order of
    the images, as long as at most 2^16 of them see one voxel; it ignores further ones.

    Args:
        voxel_size: length of a voxel's side, metres.
        far: depth beyond this, metres, is ignored.
        memory: bytes; a larger volume is in a temporary file, of which about so much is in memory. None: no limit.
    """

    def __init__(self, voxel_size: float, far: float, memory: int | None = None) -> None:
        if not 1e-4 <= voxel_size <= 10:
            raise ValueError(f"voxel_size: expected 0.0001 to 10 metres, got {voxel_size}")
        self.voxel_size, self.far, self.memory = voxel_size, far, memory
        self.truncation = SIDE / 2 * voxel_size
        self._key = torch.zeros(0, dtype=torch.int64)  # [B] ascending: the blocks
        self._row = torch.zeros(0, dtype=torch.int64)  # [B] the row of each block in the sums
        self._sums = torch.zeros(0, SIDE**3, CHANNELS, dtype=torch.int32)
        self._file: OffloadFile | None = None
        self._map: mmap.mmap | None = None  # of the sums, if they are in the file
        self._used = 0  # bytes of the map since it was dropped

    def integrate(self, depth: Tensor, color: Tensor, intrinsics: Tensor, world_to_camera: Tensor) -> Tensor:
        """Adds an image.

        Args:
            depth: [H, W] float32 metres; values that are not positive and finite measured nothing.
            color: [H, W, 3] uint8 RGB.
            intrinsics: [3, 3] float64 pixels.
            world_to_camera: [4, 4] float64.

        Returns:
            the keys of the blocks that it sees, int64, ascending.
        """
        key = self.blocks_near(depth, intrinsics, world_to_camera)
        self._drop(0)
        self._add(key)
        row, order = self._row[torch.searchsorted(self._key, key)].sort()
        image, lengths = (depth, color, intrinsics, world_to_camera), (self.voxel_size, self.truncation, self.far)
        with all_threads():
            integrate_depth(self._sums, row, _position(key[order]), *image, *lengths)
        self._drop(len(key))
        return key

    def state(self) -> dict[str, Tensor]:
        """All tensors of the volume, copied, for :meth:`restore`."""
        self._drop(0)
        return {"key": self._key.clone(), "sums": self._sums[self._row]}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Takes the :meth:`state` of another volume with voxels of the same size."""
        key, sums = state["key"], state["sums"]
        is_key = key.dtype == torch.int64 and key.ndim == 1 and bool((key >= 0).all() & (key.diff() > 0).all())
        if not is_key or sums.dtype != torch.int32 or sums.shape != (len(key), SIDE**3, CHANNELS):
            raise ValueError(f"volume: expected ascending blocks and their sums, got {key.shape} and {sums.shape}")
        self._key, self._sums = key, sums.contiguous()
        self._file = self._map = None
        self._row = torch.arange(len(self._key))

    def surface(self) -> tuple[Tensor, Tensor]:
        """Returns the points where the distance changes its sign between neighbouring voxels, and their colours.

        Returns:
            points [N, 3] metres and colours [N, 3] in [0, 255], float64. Their order depends on the volume alone.
        """
        points, colors = torch.cat(parallel_map(self._crossings, self._key.split(AT_ONCE))).split(3, 1)
        return points, colors

    def blocks_near(self, depth: Tensor, intrinsics: Tensor, world_to_camera: Tensor) -> Tensor:
        """The keys, ascending, of all blocks that are not farther than the truncation from a measured point."""
        # So many pixels apart, neighbouring rays are at most half a block apart where depth is used.
        fx, fy, cx, cy = (float(intrinsics[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
        step = max(1, min(4, int(self.truncation * min(abs(fx), abs(fy)) / self.far)))
        z = depth[::step, ::step].double()
        row, column = torch.nonzero((z > 0) & (z <= self.far), as_tuple=True)
        z = z[row, column]
        # By columns, in half of the time of rows; and no matrix product, whose bits differ between machines.
        seen = (step * column.double() - cx) / fx * z, (step * row.double() - cy) / fy * z, z
        x, y, z = (one - float(at) for one, at in zip(seen, world_to_camera[:3, 3], strict=True))
        first, half = torch.zeros_like(row), 2 ** (_BITS - 1)
        for (a, b, c), factor in zip(world_to_camera[:3, :3].T.tolist(), _STEPS.tolist(), strict=True):
            # A block is as long as two truncations: a point is near two blocks along each axis.
            low = ((a * x + b * y + c * z - self.truncation) / (SIDE * self.voxel_size)).floor()
            if len(low) and not float(low.abs().max()) < half - 1:
                told = f"expected points at most {half * SIDE * self.voxel_size:.4g} m from the first camera"
                raise ValueError(f"world_to_camera: {told}, got others; choose a voxel_size above {self.voxel_size:g}")
            first += (low.long() + half) * factor
        first = first.unique_consecutive().unique()
        return (first[:, None] + (torch.cartesian_prod(*[torch.arange(2)] * 3) * _STEPS).sum(1)).flatten().unique()

    def _add(self, key: Tensor) -> None:
        """Adds those of these blocks that are not there yet."""
        new = key[~find(self._key, key)[1]]
        total = len(self._key) + len(new)
        if total > MOST_BLOCKS:
            told = f"{MOST_BLOCKS} blocks of {SIDE}^3 voxels of {self.voxel_size:g} m"
            raise ValueError(f"voxel_size: the surface needs more than {told}; choose a larger one")
        if total > len(self._sums):
            self._grow(min(max(total, 2 * len(self._sums)), MOST_BLOCKS))
        self._key, order = torch.cat([self._key, new]).sort()
        self._row = torch.cat([self._row, torch.arange(total - len(new), total)])[order]

    def _grow(self, length: int) -> None:
        """Makes room for so many blocks."""
        if self.memory is None or length * BLOCK <= self.memory:
            # NumPy's zeros take no memory before they are written; torch's do.
            grown = torch.from_numpy(np.zeros((length, *self._sums.shape[1:]), np.int32))
        else:
            self._file = self._file or OffloadFile()
            self._map = self._file.mapped(length * BLOCK)
            grown = torch.frombuffer(self._map, dtype=torch.int32).view(-1, *self._sums.shape[1:])
        grown[: len(self._sums)] = self._sums
        self._drop(len(self._sums))
        self._sums = grown

    def _drop(self, count: int) -> None:
        """Takes the blocks in the file out of memory if, with these `count` more, the limit is reached.

        A forked process would change, and see, those of the process that made the file: that is an error.
        """
        if self._file is not None and self._file.process != os.getpid():
            raise RuntimeError("memory: a forked process shares the temporary file; save before it, and restore there")
        self._used += count * BLOCK
        if self._map is not None and self.memory is not None and self._used > self.memory:
            self._map.madvise(mmap.MADV_DONTNEED)  # of a file: nothing is lost
            self._used = 0

    def _crossings(self, key: Tensor) -> Tensor:
        """Points of the surface and their colours, [N, 6], between voxels of these blocks and the next on each axis."""
        row, found = self._row[find(self._key, key)[0]], []
        sums = self._sums.view(-1, SIDE, SIDE, SIDE, CHANNELS)
        here = _distance(sums[row])
        for axis in range(3):
            place, there = find(self._key, key + _STEPS[axis])
            next_row = self._row[place]
            beyond = _distance(sums.narrow(axis + 1, 0, 1)[next_row])
            beyond[~there] = torch.inf
            following = torch.cat([here.narrow(axis + 1, 1, SIDE - 1), beyond], axis + 1)
            crossing = (here.abs() < SURFACE) & (following.abs() < SURFACE) & ((here < 0) != (following < 0))
            block, *inside = torch.nonzero(crossing, as_tuple=True)
            one, other = here[crossing], following[crossing]
            share = (one.abs() / (one - other).abs())[:, None]
            voxel = torch.stack(inside, 1)
            center = ((SIDE * _position(key[block]) + voxel).double() + 0.5) * self.voxel_size
            center[:, axis] += self.voxel_size * share[:, 0]
            following_row = torch.where(voxel[:, axis] == SIDE - 1, next_row[block], row[block])
            following_voxel = (voxel + torch.eye(3, dtype=torch.int64)[axis]) % SIDE
            ends = (row[block], voxel), (following_row, following_voxel)
            cells = (sums[rows, *voxels.unbind(1)].double() for rows, voxels in ends)
            first, second = (cell[:, 2:] / cell[:, 1:2] for cell in cells)
            found.append(torch.cat([center, torch.lerp(first, second, share)], 1))
        self._drop(len(row))
        return torch.cat(found)


def _position(key: Tensor) -> Tensor:
    """The positions [K, 3] of blocks in units of their length."""
    return (key[:, None] // _STEPS) % (1 << _BITS) - 2 ** (_BITS - 1)


def _distance(cells: Tensor) -> Tensor:
    """The mean distance of voxels to the surface, in units of the truncation; infinite where nothing was measured."""
    total, weight = cells[..., 0].double(), cells[..., 1].double()
    return torch.where(weight > 0, total / (UNIT * weight), torch.inf)
