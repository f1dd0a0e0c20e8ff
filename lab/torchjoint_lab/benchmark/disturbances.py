"""What may happen to a scene between two recordings of the same things: noise, other light, fewer points, bad poses."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import torch
from torch import Generator, Tensor

from torchjoint.cloud.neighbors import SPACING_NEIGHBORS, nearest_neighbors
from torchjoint.runtime.threads import LazySequence
from torchjoint.scene import Frame, Scene
from torchjoint.scene.scene import voxel_subsample

#: Points move by this share of their spacing, a standard deviation along each axis.
SHARE_OF_SPACING = 0.3
#: Side of other voxels, in units of the spacing.
VOXEL = 1.5
#: Share of red, green and blue in the brightness of a colour (Rec. 601).
BRIGHTNESS = (0.299, 0.587, 0.114)


class Disturbed(NamedTuple):
    """A disturbed scene. It has no truth: compare its labels with those of the original points."""

    scene: Scene
    original: Tensor  #: [M] int64, the original point of each point, -1 = added


Disturb = Callable[[Scene, Generator], Disturbed]
#: Changes RGB [..., 3] in [0, 1].
Change = Callable[[Tensor, Generator], Tensor]


class Disturbance(NamedTuple):
    """One disturbance."""

    title: str
    applies: Callable[[Scene], bool]  #: whether the scene has what it disturbs
    function: Disturb  #: pure: the same scene and state of the generator give the same result

    def __call__(self, scene: Scene, generator: Generator) -> Disturbed:
        """Disturbs a scene, which stays as it is."""
        return self.function(replace(scene, truth=None), generator)


def moved(points: Tensor, deviation: float | Tensor, generator: Generator) -> Tensor:
    """Points [N, 3] with normal noise; `deviation`: metres along each axis, for all points or for each [N, 1]."""
    noise = torch.randn(points.shape, generator=generator, dtype=torch.float64) * deviation
    return points + noise.to(points.dtype)


def _seeded(seed: int) -> Generator:
    return torch.Generator().manual_seed(seed)


def _all(scene: Scene) -> Disturbed:
    return Disturbed(scene, torch.arange(len(scene.points)))


def _nothing(scene: Scene, _: Generator) -> Disturbed:
    return _all(scene)


def _spacing(scene: Scene) -> Tensor:
    """[N, 1] metres."""
    centered = (scene.points - scene.points.mean(0)).float()  # float32 rounds points far from the origin
    return nearest_neighbors(centered, SPACING_NEIGHBORS).spacing[:, None]


def _jitter(scene: Scene, generator: Generator) -> Tensor:
    return moved(scene.points, SHARE_OF_SPACING * _spacing(scene), generator)


def _move(scene: Scene, generator: Generator) -> Disturbed:
    return _all(replace(scene, points=_jitter(scene, generator)))


def _half_of_the_points(scene: Scene, generator: Generator) -> Disturbed:
    count = len(scene.points)
    kept = torch.randperm(count, generator=generator)[: math.ceil(count / 2)].sort().values
    return Disturbed(scene.select_points(kept), kept)


def _other_voxels(scene: Scene, generator: Generator) -> Disturbed:
    """One point in each cell of a grid, as if the cloud had been fused at another voxel size."""
    side = VOXEL * float(_spacing(scene).median())
    shift = side * torch.rand(3, generator=generator, dtype=scene.points.dtype)
    corner = scene.points.amin(0) - shift  # the grid begins at the lowest point
    kept = voxel_subsample(torch.cat([corner[None], scene.points]), side)
    kept = kept[kept > 0] - 1
    return Disturbed(scene.select_points(kept), kept)


def _shuffle(scene: Scene, generator: Generator) -> Disturbed:
    order = torch.randperm(len(scene.points), generator=generator)
    return Disturbed(scene.select_points(order), order)


def _twice(scene: Scene, generator: Generator) -> Disturbed:
    return _with_added(scene, _jitter(scene, generator), scene.colors, scene.normals)


def _outliers(scene: Scene, generator: Generator, share: float) -> Disturbed:
    """Adds points of random colours, anywhere in the bounding box."""
    count = max(1, round(share * len(scene.points)))
    low, high = scene.points.aminmax(dim=0)
    points = low + (high - low) * torch.rand((count, 3), generator=generator, dtype=scene.points.dtype)
    colors = as_8_bits(torch.rand((count, 3), generator=generator))
    normals = torch.nn.functional.normalize(torch.randn((count, 3), generator=generator))
    return _with_added(
        scene, points, None if scene.colors is None else colors, None if scene.normals is None else normals
    )


def _with_added(scene: Scene, points: Tensor, colors: Tensor | None, normals: Tensor | None) -> Disturbed:
    both = replace(
        scene,
        points=torch.cat([scene.points, points]),
        colors=None if scene.colors is None or colors is None else torch.cat([scene.colors, colors]),
        normals=None if scene.normals is None or normals is None else torch.cat([scene.normals, normals]),
    )
    return Disturbed(both, torch.cat([torch.arange(len(scene.points)), torch.full((len(points),), -1)]))


def _blacken(scene: Scene, generator: Generator) -> Disturbed:
    assert scene.colors is not None
    black = torch.rand(len(scene.points), generator=generator) < 0.3
    return _all(replace(scene, colors=scene.colors.masked_fill(black[:, None], 0.0)))


def as_8_bits(colors: Tensor) -> Tensor:
    """Colours in [0, 1], rounded as a camera rounds them; darker and lighter ones are clipped."""
    return (colors.clamp(0, 1) * 255).round() / 255


def _recolor(scene: Scene, generator: Generator, change: Change, points_too: bool = True) -> Disturbed:
    """Changes the colours of the images and of the points."""

    def of_frame(frame: Frame, own: Generator) -> Frame:
        return replace(frame, image=change(frame.image.movedim(0, -1), own).movedim(-1, 0).contiguous())

    colors = scene.colors if scene.colors is None or not points_too else change(scene.colors, generator)
    return _with_frames(replace(scene, colors=colors), generator, of_frame)


def _with_frames(scene: Scene, generator: Generator, change: Callable[[Frame, Generator], Frame]) -> Disturbed:
    """Changes each frame when it is read, so that no more images are in memory than without a change."""
    frames = scene.frames
    seeds = torch.randint(1 << 62, (len(frames),), generator=generator).tolist()
    changed = LazySequence(len(frames), lambda index: change(frames[index], _seeded(seeds[index])))
    return _all(replace(scene, frames=changed))


def _light(colors: Tensor, _: Generator, factor: float | tuple[float, float, float]) -> Tensor:
    return as_8_bits(colors * torch.tensor(factor))


def _exposure(colors: Tensor, generator: Generator) -> Tensor:
    return as_8_bits(colors * (0.6 + 0.8 * torch.rand((), generator=generator)))


def _gamma(colors: Tensor, _: Generator, power: float) -> Tensor:
    return as_8_bits(colors**power)


def _in_16_bits(colors: Tensor, _: Generator) -> Tensor:
    return colors / 257  # 255 of 65535


def _grey(colors: Tensor, _: Generator) -> Tensor:
    return as_8_bits(colors @ torch.tensor(BRIGHTNESS))[..., None].expand(colors.shape)


def _noise(colors: Tensor, generator: Generator) -> Tensor:
    return as_8_bits(colors + 0.05 * torch.randn(colors.shape, generator=generator))


def _half_of_the_frames(scene: Scene, generator: Generator) -> Disturbed:
    """Every second frame, from the first or from the second on."""
    start = int(torch.randint(2, (), generator=generator))
    return _all(scene.select_frames(range(start, len(scene.frames), 2)))


def _one_frame(scene: Scene, generator: Generator) -> Disturbed:
    return _all(scene.select_frames([int(torch.randint(len(scene.frames), (), generator=generator))]))


def _pose(frame: Frame, generator: Generator, shift: float, degrees: float) -> Frame:
    """The camera at another place, `shift` metres away in any direction, and turned by `degrees` about any axis."""
    away, axis = torch.nn.functional.normalize(torch.randn((2, 3), generator=generator, dtype=torch.float64))
    error = torch.eye(4, dtype=torch.float64)
    turn = torch.linalg.cross(torch.eye(3, dtype=torch.float64), axis.expand(3, 3))
    error[:3, :3] = torch.linalg.matrix_exp(turn * math.radians(degrees))
    error[:3, 3] = shift * away
    return replace(frame, world_to_camera=error @ frame.world_to_camera)


def _always(_: Scene) -> bool:
    return True


def _has_colors(scene: Scene) -> bool:
    return scene.colors is not None or len(scene.frames) > 0


def _has_colored_points(scene: Scene) -> bool:
    return scene.colors is not None


def _has_frames(scene: Scene) -> bool:
    return len(scene.frames) > 0


def _has_several_frames(scene: Scene) -> bool:
    return len(scene.frames) > 1


def _colors(title: str, change: Change) -> Disturbance:
    return Disturbance(title, _has_colors, partial(_recolor, change=change))


def _poses(title: str, shift: float = 0.0, degrees: float = 0.0) -> Disturbance:
    change = partial(_pose, shift=shift, degrees=degrees)
    return Disturbance(title, _has_frames, partial(_with_frames, change=change))


#: The one with which all others are compared.
CLEAN = "nothing"
DISTURBANCES = {
    CLEAN: Disturbance("nothing", _always, _nothing),
    "moved": Disturbance("points moved by .3 of the spacing", _always, _move),
    "half-points": Disturbance("half of the points", _always, _half_of_the_points),
    "voxels": Disturbance("another voxel size", _always, _other_voxels),
    "outliers-1": Disturbance("1 % outliers", _always, partial(_outliers, share=0.01)),
    "outliers-5": Disturbance("5 % outliers", _always, partial(_outliers, share=0.05)),
    "twice": Disturbance("each point twice, with noise", _always, _twice),
    "shuffled": Disturbance("points in another order", _always, _shuffle),
    "light-0.1": _colors("light x .1", partial(_light, factor=0.1)),
    "light-0.25": _colors("light x .25", partial(_light, factor=0.25)),
    "light-0.5": _colors("light x .5", partial(_light, factor=0.5)),
    "light-2": _colors("light x 2, clipped", partial(_light, factor=2.0)),
    "gamma-0.5": _colors("gamma .5", partial(_gamma, power=0.5)),
    "gamma-2": _colors("gamma 2", partial(_gamma, power=2.0)),
    "warm": _colors("warm light", partial(_light, factor=(1.0, 0.85, 0.6))),
    "cold": _colors("cold light", partial(_light, factor=(0.6, 0.85, 1.0))),
    "exposure": Disturbance(
        "exposure of each image x .6 to 1.4", _has_frames, partial(_recolor, change=_exposure, points_too=False)
    ),
    "16-bit": _colors("8-bit values in 16 bits", _in_16_bits),
    "grey": _colors("grey", _grey),
    "color-noise": _colors("noise of .05 in colours", _noise),
    "black": Disturbance("30 % of the points black", _has_colored_points, _blacken),
    "half-frames": Disturbance("half of the frames", _has_several_frames, _half_of_the_frames),
    "one-frame": Disturbance("one frame", _has_several_frames, _one_frame),
    "poses-1cm": _poses("poses 1 cm off", shift=0.01),
    "poses-3cm": _poses("poses 3 cm off", shift=0.03),
    "poses-1deg": _poses("poses 1 degree off", degrees=1.0),
}
