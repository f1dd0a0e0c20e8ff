"""How often does the check of the poses warn? Right and wrong poses of generated scenes of all kinds.

    python lab/studies/poses.py --seeds 6

For each scene the poses as they are, and wrong ones of six kinds, each with the depth images of the scene, if it has
any, and without. Prints how many scenes got a warning. Poses of a single frame cannot be reversed.
"""

from __future__ import annotations

import argparse
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import torch
from torch import Tensor
from torchjoint_lab.synthetic import DOMAINS, make_domain_scene

import torchjoint as tj
from torchjoint.scene import Scene
from torchjoint.scene.frame import PoseWarning
from torchjoint.views.pose_check import PoseCheck, frames_to_check

HALF_A_METRE = 0.5
OPENGL = torch.diag(torch.tensor([1.0, -1, -1, 1], dtype=torch.float64))
OTHER_SIZE = torch.tensor([[2.0, 1, 2], [1, 2, 2], [1, 1, 1]], dtype=torch.float64)


def with_poses(scene: Scene, poses: list[Tensor]) -> Scene:
    frames = [replace(frame, world_to_camera=pose) for frame, pose in zip(scene.frames, poses, strict=True)]
    return replace(scene, frames=frames)


def variants(scene: Scene) -> Iterator[tuple[str, Scene]]:
    """What is wrong, and the scene."""
    poses = [frame.world_to_camera for frame in scene.frames]
    yield "right", scene
    yield "inverted", with_poses(scene, [torch.linalg.inv(pose) for pose in poses])
    if len(poses) > 1:
        yield "reversed order", with_poses(scene, poses[::-1])
    for axis in range(3):
        offset = torch.eye(4, dtype=torch.float64)
        offset[axis, 3] = HALF_A_METRE
        yield "half a metre off", with_poses(scene, [pose @ offset for pose in poses])
    yield "OpenGL axes", with_poses(scene, [OPENGL @ pose for pose in poses])
    thousandfold = torch.ones(4, 4, dtype=torch.float64)
    thousandfold[:3, 3] = 1000
    yield "millimetres", with_poses(scene, [pose * thousandfold for pose in poses])
    frames = [replace(frame, intrinsics=frame.intrinsics * OTHER_SIZE) for frame in scene.frames]
    yield "intrinsics of twice the size", replace(scene, frames=frames)


def warned(segmenter: tj.JointSegmenter, scene: Scene) -> bool:
    """Whether the segmenter, which has the scene's cloud, would warn of the poses."""
    graph = segmenter.graph
    cloud = Scene(graph.points, colors=graph.colors)
    check = PoseCheck(cloud, graph.spacing, segmenter.config.visibility, graph.local)
    check.check_all(frames_to_check(scene).values())
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check.warn()
    return any(issubclass(one.category, PoseWarning) for one in caught)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--domains", nargs="+", choices=DOMAINS, default=list(DOMAINS))
    arguments = parser.parse_args()
    seen, all_cases = Counter[tuple[str, str]](), Counter[tuple[str, str]]()
    for domain in arguments.domains:
        for seed in range(arguments.seeds):
            scene = make_domain_scene(domain, seed).scene
            segmenter = tj.JointSegmenter()
            segmenter.reset(scene.points, scene.colors)
            for name, one in variants(scene):
                kinds = [("scan" if domain == "street" else "colours", False)]
                kinds += [("depth", True)] * (one.frames[0].depth is not None)
                for kind, has_depth in kinds:
                    frames = one.frames if has_depth else [replace(frame, depth=None) for frame in one.frames]
                    all_cases[name, kind] += 1
                    seen[name, kind] += warned(segmenter, replace(one, frames=frames))
    columns = ("depth", "colours", "scan")
    print("| poses | with depth images | colours alone | LiDAR, no colours |\n|---|---:|---:|---:|")
    for name in dict.fromkeys(name for name, _ in all_cases):
        print(f"| {name} | " + " | ".join(f"{seen[name, kind]} of {all_cases[name, kind]}" for kind in columns) + " |")


if __name__ == "__main__":
    main()
