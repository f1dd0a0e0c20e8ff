"""What is printed when a result is written."""

from __future__ import annotations

from pathlib import Path

from torchjoint.scene import Segmentation


def summarize(result: Segmentation, out: Path) -> None:
    """Prints how many points, segments and images there are, the seconds by stage, and the files."""
    seconds = ", ".join(f"{stage} {value:.1f}" for stage, value in result.seconds.items())
    print(f"{len(result.points)} points in {result.num_point_segments} segments, {len(result.images)} images")
    print(f"seconds by stage (added up over threads): {seconds}")
    print(f"written to {out}: overview.png, points.ply, points.npz, images/, run.yaml")
