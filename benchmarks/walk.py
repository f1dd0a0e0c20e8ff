"""Memory of live segmentation over a long walk: `python benchmarks/walk.py [MINUTES] [--rooms 4]`.

A camera walks through a generated flat at about .4 m/s: one round of each furnished room after the other, again and
again, by another way each time. Each frame, one a second, has a new pose, far enough from the last for a keyframe; what
lies between keyframes leaves nothing in memory. Images are textures without light, with noise, and so are the depths.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from itertools import chain

import numpy as np
import report
import torch
from torch.nn.functional import interpolate
from torchjoint_lab.synthetic.furnished import trajectory
from torchjoint_lab.synthetic.furnished.render import Renderer
from torchjoint_lab.synthetic.furnished.room import make_world
from torchjoint_lab.synthetic.furnished.world import World

import torchjoint as tj
from torchjoint.runtime.memory import peak_memory, reset_peak_memory

HEIGHT, WIDTH = 480, 640
#: Frames a second, and frames of a round: 25 seconds.
RATE, ROUND = 1, 25
#: Minutes between rows of the table.
EVERY = 5
#: Metres between the middles of rooms.
APART = 8.0


class Room(Renderer):
    """What a camera sees of a room whose middle is `place` metres along x: rays for every second row and column."""

    def __init__(self, world: World, place: float) -> None:
        super().__init__(world)
        self.world, self.place = world, np.eye(4)
        self.place[0, 3] = -place
        lens = trajectory.intrinsics(HEIGHT // 2, WIDTH // 2)
        row, column = np.mgrid[: HEIGHT // 2, : WIDTH // 2].reshape(2, -1)
        self.ahead = np.stack([(column - lens[0, 2]) / lens[0, 0], (row - lens[1, 2]) / lens[1, 1], 1.0 + 0 * row], 1)
        self.lens = torch.from_numpy(trajectory.intrinsics(HEIGHT, WIDTH))

    def frame(self, pose: np.ndarray, noise: torch.Generator) -> tj.Frame:
        """A frame of a camera with this pose in the room."""
        eye, ray = -pose[:3, :3].T @ pose[:3, 3], self.ahead @ pose[:3, :3]
        triangle, depth, place = self._rays.cast(np.concatenate([0 * ray + eye, ray], 1).astype(np.float32))
        corners, (u, v) = self._world.corners[triangle, :, 3:], place.T[:, :, None]
        places = corners[:, 0] * (1 - u - v) + corners[:, 1] * u + corners[:, 2] * v
        color = self._albedo(self._world.material_ids[triangle], places) ** (1 / 2.2)
        image = _doubled(color.T, mode="bilinear")
        image = (image + 0.015 * torch.randn(image.shape, generator=noise)).clamp(0, 1)
        metres = _doubled(np.where(np.isfinite(depth), depth, 0)[None])[0]
        metres = (metres + 0.0015 * metres**2 * torch.randn(metres.shape, generator=noise)).clamp(min=0)
        return tj.Frame((image * 255).byte(), self.lens, torch.from_numpy(pose @ self.place), depth=metres)


def _doubled(values: np.ndarray, **options: str) -> torch.Tensor:
    small = torch.from_numpy(values).float().view(1, -1, HEIGHT // 2, WIDTH // 2)
    return interpolate(small, scale_factor=2, **options)[0]


def walk(minutes: float, num_rooms: int) -> Iterator[tj.Frame]:
    """The frames of the walk."""
    rooms = [Room(make_world(np.random.default_rng(k)), APART * k) for k in range(num_rooms)]
    noise, count = torch.Generator().manual_seed(0), round(60 * minutes * RATE)
    for first in range(0, count, ROUND):
        visit = first // ROUND
        room = rooms[visit % num_rooms]
        for pose in trajectory.walk(np.random.default_rng(1000 + visit), room.world, ROUND)[: count - first]:
            yield room.frame(pose, noise)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("minutes", type=float, nargs="?", default=30)
    parser.add_argument("--rooms", type=int, default=4)
    parser.add_argument("--memory", default="200MB", help="for the keyframes")
    arguments = parser.parse_args()
    frames = walk(arguments.minutes, arguments.rooms)
    ahead, segmenter, rows = next(frames), tj.LiveSegmenter(memory=arguments.memory), []
    reset_peak_memory()
    before = (peak_memory() or 0) / 1000
    for number, frame in enumerate(chain([ahead], frames), start=1):
        segmenter.update(frame)
        if number % 100 == 0:
            print(number, len(segmenter.names), f"{peak_memory() or 0:.0f} MB", flush=True)
        if number % (EVERY * 60 * RATE) == 0:
            sizes = len(segmenter.names), len(segmenter._volume._key)
            rows.append([f"{number // (60 * RATE)}", number, *sizes, (peak_memory() or 0) / 1000])
    start = time.perf_counter()
    result = segmenter.result(images=False)
    seconds = time.perf_counter() - start
    about = (
        f"{before:.2f} GB of the memory are the program, its rooms and the segmenter before the first frame; at most "
        f"{arguments.memory} are keyframes, the others are on the disk."
    )
    columns = {"minutes": 0, "frames": 0, "keyframes": 0, "blocks of surface": 0, "peak memory, GB": 2}
    last = ["at the end", len(result.cloud.points), seconds, (peak_memory() or 0) / 1000]
    ends = report.Table({"a result": 0, "points": 0, "s": 1, "peak with it, GB": 2}, [last])
    report.save("walk", [report.Table(columns, rows), ends], about=about)


if __name__ == "__main__":
    main()
