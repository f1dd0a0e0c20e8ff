"""A generated city of any size as LAZ, and superpoints of it in tiles: time, memory, and likeness to one piece.

    python benchmarks/tiles.py generate city.laz --points 5000000
    python benchmarks/tiles.py compare city.laz out.laz      # the call in memory and tiles: time per point, peak memory
    python benchmarks/tiles.py run city.laz out.laz          # tiles alone
    python benchmarks/tiles.py likeness city.laz out.laz city.npy --tile 25 --buffer 2  # after compare with these

The city is a grid of blocks, made one by one: it takes no memory, and block i, j is the same in a city of any size.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from pathlib import Path

import laspy
import numpy as np

#: Side of a block with its streets, metres, and mean distance of points on a surface.
BLOCK, SPACING = 40.0, 0.05
#: Standard deviation of the points' error, metres.
NOISE = 0.006
#: In the zone 32 of UTM, with 6 and 7 digits before the point.
ORIGIN = np.array([691_000.0, 5_334_000.0, 515.0])


def patch(rng, corner, u, v, color, density):
    """Points on a parallelogram."""
    count = rng.poisson(density * np.linalg.norm(np.cross(u, v)))
    s, t = rng.random((2, count, 1))
    points = np.asarray(corner) + s * np.asarray(u) + t * np.asarray(v)
    return points, np.tile(np.asarray(color, float), (count, 1))


def box(rng, low, size, color, density, turn=0.0):
    """Four sides and the top of a box that is turned about its vertical axis."""
    (x, y, z), (a, b, h) = low, size
    cos, sin = np.cos(turn), np.sin(turn)
    u, v, up = np.array([cos * a, sin * a, 0]), np.array([-sin * b, cos * b, 0]), np.array([0, 0, h])
    corner = np.array([x, y, z])
    sides = [(corner, u, up), (corner, v, up), (corner + u, v, up), (corner + v, u, up), (corner + up, u, v)]
    return [patch(rng, *side, color, density) for side in sides]


def house(rng, low, size, color, density):
    """Walls with windows set back, and a gabled roof."""
    (x, y, z), (a, b, h) = low, size
    keep = []
    for points, colors in box(rng, low, (a, b, h), color, density)[:4]:  # windows: every 2.5 m, 1.2 x 1.4 m, 15 cm deep
        along = np.where(np.ptp(points[:, 0]) > np.ptp(points[:, 1]), points[:, 0] - x, points[:, 1] - y)
        inside = (
            (along % 2.5 > 0.7) & (along % 2.5 < 1.9) & ((points[:, 2] - z) % 3 > 1) & ((points[:, 2] - z) % 3 < 2.4)
        )
        middle = np.array([x + a / 2, y + b / 2, 0])
        normal = (points - middle)[:, :2] / np.array([a, b])
        axis = np.abs(normal).argmax(1)
        points[inside, axis[inside]] -= 0.15 * np.sign(normal[inside, axis[inside]])
        colors[inside] = [0.2, 0.25, 0.3]
        keep.append((points, colors))
    ridge, roof = 0.35 * b, [0.55, 0.25, 0.2]
    corner, along = np.array([x - 0.3, y - 0.3, z + h]), np.array([a + 0.6, 0, 0])
    rise = np.array([0, b / 2 + 0.3, ridge])
    keep.append(patch(rng, corner, along, rise, roof, density))
    keep.append(patch(rng, corner + np.array([0, b + 0.6, 0]), along, rise * [1, -1, 1], roof, density))
    return keep


def tree(rng, x, y, z, density):
    """A trunk and a crown of leaves."""
    radius, height = rng.uniform(1.2, 2.5), rng.uniform(2.5, 4)
    count = rng.poisson(density * 2 * np.pi * 0.2 * height)
    angle, up = rng.uniform(0, 2 * np.pi, count), rng.uniform(0, height, count)
    trunk = np.stack([x + 0.2 * np.cos(angle), y + 0.2 * np.sin(angle), z + up], 1)
    count = rng.poisson(density * 4 * np.pi * radius**2 * 0.7)
    ball = rng.normal(size=(count, 3))
    ball *= (radius * rng.uniform(0.75, 1, (count, 1))) / np.linalg.norm(ball, axis=1, keepdims=True)
    crown = ball + np.array([x, y, z + height + 0.7 * radius])
    return [(trunk, np.tile([0.35, 0.25, 0.2], (len(trunk), 1))), (crown, np.tile([0.2, 0.45, 0.15], (count, 1)))]


def block(i, j, seed=0, density=SPACING**-2):
    """Points [n, 3] metres and colours [n, 3] of one block."""
    rng = np.random.default_rng([seed, i, j])
    x, y = i * BLOCK, j * BLOCK
    street, walk = 4.0, 6.5  # half the width of the street, and with the pavement
    inner, road = BLOCK - 2 * street, [0.35, 0.35, 0.37]
    parts = [
        patch(rng, (x, y, 0), (BLOCK, 0, 0), (0, street, 0), road, density),
        patch(rng, (x, y + BLOCK - street, 0), (BLOCK, 0, 0), (0, street, 0), road, density),
        patch(rng, (x, y + street, 0), (street, 0, 0), (0, inner, 0), road, density),
        patch(rng, (x + BLOCK - street, y + street, 0), (street, 0, 0), (0, inner, 0), road, density),
    ]
    parts += box(rng, (x + street, y + street, 0), (inner, inner, 0.14), [0.5, 0.5, 0.48], density)
    for _ in range(2 + int(rng.integers(3))):
        a, b, h = rng.uniform(7, 13), rng.uniform(7, 11), 3.0 * rng.integers(2, 6)
        low = x + rng.uniform(walk, BLOCK - walk - a), y + rng.uniform(walk, BLOCK - walk - b), 0.14
        parts += house(rng, low, (a, b, h), rng.uniform(0.45, 0.9, 3), density)
    for _ in range(int(rng.integers(3, 8))):  # cars at the kerb
        along = rng.uniform(street + 1, BLOCK - street - 5.5)
        low, turn = ((x + along, y + 1.5, 0.25), 0.0) if rng.integers(2) else ((x + 3.4, y + along, 0.25), np.pi / 2)
        paint = rng.uniform(0.1, 0.9, 3)
        parts += box(rng, low, (4.2, 1.8, 0.7), paint, density, turn)
        up = np.array([np.cos(turn) - 0.2 * np.sin(turn), np.sin(turn) + 0.2 * np.cos(turn), 0.7])
        parts += box(rng, np.add(low, up), (2.2, 1.5, 0.55), [0.15, 0.15, 0.2], density, turn)
    for _ in range(int(rng.integers(2, 7))):
        parts += tree(rng, x + rng.uniform(walk, BLOCK - walk), y + rng.uniform(4.5, walk), 0.14, density)
    points = np.concatenate([part[0] for part in parts])
    colors = np.concatenate([part[1] for part in parts])
    points[:, 2] += 0.8 * np.sin(points[:, 0] / 60) + 0.6 * np.cos(points[:, 1] / 47)  # gentle hills
    return points + rng.normal(0, NOISE, points.shape), (colors + rng.normal(0, 0.02, colors.shape)).clip(0, 1)


def generate(path: Path, num_points: int, seed: int = 0) -> None:
    """Writes a city of about `num_points`, cut off at exactly that number."""
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.offsets, header.scales = np.floor(ORIGIN), np.full(3, 1e-3)
    columns = max(1, round((num_points / 1.4e6) ** 0.5))
    written, index = 0, 0
    with laspy.open(path, "w", header=header) as writer:
        while written < num_points:
            points, colors = block(index % columns, index // columns, seed)
            points, colors = points[: num_points - written], colors[: num_points - written]
            record = laspy.ScaleAwarePointRecord.zeros(len(points), header=writer.header)
            record.x, record.y, record.z = (points + ORIGIN).T
            record.red, record.green, record.blue = (colors * 65535).astype(np.uint16).T
            record.gps_time = (written + np.arange(len(points))) * 1e-6
            record.intensity = (colors.mean(1) * 65535).astype(np.uint16)
            writer.write_points(record)
            written, index = written + len(points), index + 1


def memory(process: int) -> int:
    """Bytes of a process and all below it; pages that they share count once, those of files that can go do not."""
    total = 0
    try:
        for line in Path(f"/proc/{process}/smaps_rollup").read_text().splitlines():
            if line.startswith(("Pss_Anon:", "Pss_Shmem:")):
                total += 1024 * int(line.split()[1])
        for thread in Path(f"/proc/{process}/task").iterdir():
            total += sum(memory(int(child)) for child in (thread / "children").read_text().split())
    except OSError:  # it has ended meanwhile
        pass
    return total


def measured(arguments: list[str]) -> dict[str, float]:
    """Runs this file with other arguments; seconds by the clock and of the processors, and peak memory in GB."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    process, peak = subprocess.Popen([sys.executable, __file__, *arguments]), 0
    while process.poll() is None:
        peak = max(peak, memory(process.pid))
        time.sleep(0.2)
    if process.returncode:
        sys.exit(f"{arguments} failed")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"seconds": time.perf_counter() - start, "cpu": cpu, "peak_gb": peak / 1e9}


def in_one_piece(path: Path, out: Path) -> None:
    """The call in memory, from file to file: reads the cloud and writes the labels."""
    import torch

    import torchjoint as tj
    from torchjoint.datasets.files.las import read_las

    start = time.perf_counter()
    points, colors = read_las(path)[:2]
    read = time.perf_counter()
    labels = tj.superpoints(points, colors)
    print(f"  read {read - start:.1f} s, superpoints {time.perf_counter() - read:.1f} s")
    np.save(out, labels.to(torch.int32).numpy())


def in_tiles(path: Path, out: Path, tile: float | None, buffer: float | None) -> None:
    from torchjoint.tiles import superpoints_of_files

    print(" ", superpoints_of_files(path, out, tile=tile, buffer=buffer, overwrite=True, engine="loky:2"))


def likeness(path: Path, labelled: Path, one: Path, tile: float, buffer: float) -> None:
    """Covering of the labels in tiles and in one piece, and how well borders are found near edges and elsewhere."""
    import torch

    from torchjoint import ops
    from torchjoint.cloud.neighbors import nearest_neighbors
    from torchjoint.datasets.files.las import read_las
    from torchjoint.metrics import boundary_recall, segmentation_covering

    points = read_las(path)[0]
    whole = torch.from_numpy(np.load(one).astype(np.int64))
    labels = torch.from_numpy(laspy.read(labelled)["superpoint"].astype(np.int64))
    print(segmentation_covering(labels, whole))
    points, places = points - points[0], points[:, :2] / tile
    edges = ops.neighbor_edges(nearest_neighbors((points).float(), 10).indices)
    at_edge = (((places - places.round()).abs() * tile).amin(1) < buffer / 2)[edges[0]]
    for name, chosen in (("at the edges of tiles", at_edge), ("elsewhere", ~at_edge)):
        some = edges[:, chosen]
        recall = [boundary_recall(*pair, some) for pair in ((labels, whole), (whole, labels))]
        print(f"{name}: {some.shape[1]} edges, boundary recall {recall[0]:.4f}, precision {recall[1]:.4f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("generate", "one", "tiles", "likeness", "compare", "run"))
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--points", type=int, default=5_000_000)
    parser.add_argument("--tile", type=float)
    parser.add_argument("--buffer", type=float)
    arguments = parser.parse_args()
    files, sizes = arguments.files, (arguments.tile, arguments.buffer)
    given = [f"--{name}={value}" for name, value in zip(("tile", "buffer"), sizes, strict=True) if value is not None]
    if arguments.command == "generate":
        generate(files[0], arguments.points)
    elif arguments.command == "one":
        in_one_piece(*files)
    elif arguments.command == "tiles":
        in_tiles(*files, *sizes)
    elif arguments.command == "likeness":
        likeness(*files, *sizes)
    else:
        compare(files[0], files[1], given, alone=arguments.command == "run")


def compare(city: Path, out: Path, sizes: list[str], alone: bool) -> None:
    """Writes what a point takes in memory and in tiles, or in tiles alone."""
    import report

    with laspy.open(city) as reader:
        count = reader.header.point_count
    rows = []
    for command in ("tiles",) if alone else ("one", "tiles"):
        paths = [str(city), str(city.with_suffix(".npy") if command == "one" else out)]
        result = measured([command, *paths, *(sizes if command == "tiles" else [])])
        name = "`tj.superpoints` in memory" if command == "one" else " ".join(["tiles", *sizes])
        rows.append([f"{name}, {count:,} points", *(1e6 * result[key] / count for key in ("seconds", "cpu"))])
        rows[-1].append(result["peak_gb"])
    columns = {"way": 0, "clock, µs a point": 2, "processor time, µs a point": 2, "peak memory of all processes, GB": 2}
    report.save("tiles_alone" if alone else "tiles", [report.Table(columns, rows)])


if __name__ == "__main__":
    main()
