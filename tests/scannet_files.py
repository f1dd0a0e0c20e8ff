"""ScanNet's files, written from what is known of their formats and with nothing of the readers' code."""

import io
import json
import struct
import zlib
from typing import NamedTuple

import numpy as np
from PIL import Image


class Shot(NamedTuple):
    """A frame before it is written."""

    color: np.ndarray  # [H, W, 3] uint8
    depth: np.ndarray  # [h, w] uint16, mm
    pose: np.ndarray  # [4, 4] camera-to-world


def shots_of(scene):
    """The frames of a scene as they go into files."""
    for frame in scene.frames:
        color = (frame.image * 255).round().byte().permute(1, 2, 0).numpy()
        depth = (frame.depth * 1000).round().numpy().astype(np.uint16)
        yield Shot(color, depth, np.linalg.inv(frame.world_to_camera.numpy()))


def random_shots(rng, count, color_size, depth_size):
    """A camera that moves along x in front of a wall two metres away."""
    for index in range(count):
        pose = np.eye(4)
        pose[0, 3] = 0.1 * index
        pixels = rng.integers(0, 256, (*color_size, 3), dtype=np.uint8)
        yield Shot(pixels, np.full(depth_size, 2000, dtype=np.uint16), pose)


def lost(shot):
    """The same frame where tracking was lost."""
    return shot._replace(pose=np.full((4, 4), -np.inf))


def four(intrinsics):
    matrix = np.eye(4)
    matrix[:3, :3] = intrinsics
    return matrix


def jpeg(pixels):
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "JPEG", quality=95)
    return stream.getvalue()


def write_sens(
    path, shots, color_intrinsics, depth_intrinsics, *, shift=1000.0, codecs=(2, 1), name=b"StructureSensor"
):
    shots = list(shots)
    cameras = [four(color_intrinsics), np.eye(4), four(depth_intrinsics), np.eye(4)]
    (ch, cw, _), (dh, dw) = shots[0].color.shape, shots[0].depth.shape
    with path.open("wb") as stream:
        stream.write(struct.pack("<IQ", 4, len(name)) + name)
        stream.write(np.array(cameras, dtype="<f4").tobytes())
        stream.write(struct.pack("<ii4IfQ", *codecs, cw, ch, dw, dh, shift, len(shots)))
        for index, shot in enumerate(shots):
            color, depth = jpeg(shot.color), shot.depth.astype("<u2").tobytes()
            depth = zlib.compress(depth) if codecs[1] == 1 else depth
            stream.write(np.array(shot.pose, dtype="<f4").tobytes())
            stream.write(struct.pack("<4Q", index * 33, index * 33, len(color), len(depth)) + color + depth)
        stream.write(struct.pack("<Q", 0))  # the accelerometer's readings follow: none


def write_exported(folder, shots, step=1):
    """As ScanNet's exporter writes frames; its poses' text is -inf where tracking was lost."""
    for name in ("color", "depth", "pose"):
        (folder / name).mkdir(parents=True)
    for index, shot in enumerate(shots):
        (folder / "color" / f"{index * step}.jpg").write_bytes(jpeg(shot.color))
        Image.fromarray(shot.depth).save(folder / "depth" / f"{index * step}.png")
        np.savetxt(folder / "pose" / f"{index * step}.txt", shot.pose, fmt="%f")


def write_intrinsics(folder, color, depth):
    (folder / "intrinsic").mkdir()
    for name, matrix in (("color", color), ("depth", depth)):
        np.savetxt(folder / "intrinsic" / f"intrinsic_{name}.txt", four(matrix), fmt="%f")
        np.savetxt(folder / "intrinsic" / f"extrinsic_{name}.txt", np.eye(4), fmt="%f")


def write_info(path, color, depth, color_size, depth_size):
    lines = ["axisAlignment = " + " ".join(["0.5"] * 16)]
    for name, matrix, size in (("color", color, color_size), ("depth", depth, depth_size)):
        lines += [f"{name}Height = {size[0]}", f"{name}Width = {size[1]}"]
        lines += [f"fx_{name} = {matrix[0][0]}", f"fy_{name} = {matrix[1][1]}"]
        lines += [f"mx_{name} = {matrix[0][2]}", f"my_{name} = {matrix[1][2]}"]
    path.write_text("\n".join([*lines, "numDepthFrames = 3", "sceneType = Kitchen"]) + "\n")


def write_mesh(path, points, colors):
    """Binary, as ScanNet's: positions, colours with alpha, one triangle."""
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [f"property float {axis}" for axis in "xyz"]
    header += [f"property uchar {name}" for name in ("red", "green", "blue", "alpha")]
    header += ["element face 1", "property list uchar int vertex_indices", "end_header\n"]
    with path.open("wb") as stream:
        stream.write("\n".join(header).encode())
        for point, color in zip(points, colors, strict=True):
            stream.write(struct.pack("<3f4B", *map(float, point), *map(int, color), 255))
        stream.write(struct.pack("<B3i", 3, 0, 1, 2))


def write_point_truth(folder, scan, labels):
    """Each object is made of two segments, with numbers that are no indices; what has no object has segments, too."""
    labels = np.asarray(labels)
    segments = (labels + 1) * 20 + np.arange(len(labels)) % 2 * 7 + 3
    name = f"{scan}_vh_clean_2.0.010000.segs.json"
    content = {"params": {"kThresh": "0.0001"}, "sceneId": scan, "segIndices": segments.tolist()}
    (folder / name).write_text(json.dumps(content))
    groups = [
        {
            "id": int(i),
            "objectId": int(i),
            "segments": sorted({int(s) for s in segments[labels == i]}),
            "label": "chair",
        }
        for i in np.unique(labels[labels >= 0])
    ]
    content = {"sceneId": f"scannet.{scan}", "segGroups": groups, "segmentsFile": name}
    (folder / f"{scan}.aggregation.json").write_text(json.dumps(content))


def write_image_truth(folder, labels, step=1):
    (folder / "instance-filt").mkdir(parents=True)
    for index, image in enumerate(labels):
        Image.fromarray((np.asarray(image) + 1).astype(np.uint8)).save(folder / "instance-filt" / f"{index * step}.png")
