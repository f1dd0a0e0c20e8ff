"""The text that is printed after a result is written."""

from __future__ import annotations

from pathlib import Path

from torchjoint.scene import Segmentation


def summarize(result: Segmentation, out: Path) -> None:
    """Prints the numbers of points, segments and images, the seconds per stage, and the written files."""
    seconds = ", ".join(f"{stage} {value:.1f}" for stage, value in result.seconds.items())
    print(f"{len(result.points)} points in {result.num_point_segments} segments, {len(result.images)} images")
    print(f"seconds by stage (added up over threads): {seconds}")
    levels = ", hierarchy.npz, pieces/" if result.hierarchy is not None else ""
    print(
        f"written to {out}: overview.png, points.ply, points.npz, segments.json, images/, images_color/, inputs/, "
        f"cameras.json, run.yaml{levels}"
    )
