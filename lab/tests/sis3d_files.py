"""3D-SIS' files, written from what is known of their formats and with nothing of the readers' code."""

import pickle
import struct

import numpy as np

VOXEL = 0.046875


def world_to_grid(points):
    """World, z up, to the voxels of 3D-SIS' padded grid, y up."""
    turned = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    lowest = (np.asarray(points, dtype=float) @ turned.T).min(0)
    matrix = np.eye(4)
    matrix[:3, :3] = turned / VOXEL
    matrix[:3, 3] = 16 - lowest / VOXEL
    return matrix


def scene_voxels(points):
    """The voxels of the scene, less padded than the grid, that points lie in."""
    matrix = world_to_grid(points)
    places = np.asarray(points, dtype=float) @ matrix[:3, :3].T + matrix[:3, 3] - [10, 16, 10]
    return np.rint(places).astype(int)


def boxes_of(points, labels, instances):
    """For each instance its box in the scene's voxels, and the mask of those that hold a point of it."""
    voxels, boxes, masks = scene_voxels(points), [], []
    for instance in instances:
        own = voxels[np.asarray(labels) == instance]
        low, high = own.min(0), own.max(0) + 1
        mask = np.zeros(high - low, dtype=np.float32)
        mask[tuple((own - low).T)] = 1
        boxes.append([*low, *high])
        masks.append(mask)
    return np.array(boxes, dtype=np.float32).reshape(-1, 6), masks


def write_volume(path, dims, boxes, classes, masks, matrix, frame_ids=(), sdf=None):
    x, y, z = dims
    sdf = np.zeros(dims) if sdf is None else sdf
    with path.open("wb") as stream:
        stream.write(struct.pack("<3Q", x, y, z) + np.asarray(sdf, dtype="<f4").tobytes(order="F"))
        stream.write(struct.pack("<I", len(boxes)))
        for box, label in zip(boxes, classes, strict=True):
            stream.write(struct.pack("<6fI", *box, label))
        stream.write(struct.pack("<I", len(masks)))
        for mask, label in zip(masks, classes, strict=True):
            stream.write(struct.pack("<I3Q", label, *mask.shape) + mask.astype("<u2").tobytes(order="F"))
        stream.write(struct.pack("<I", len(boxes)) + np.ones(len(boxes), dtype="<f4").tobytes())
        stream.write(np.asarray(matrix, dtype="<f4").tobytes())
        stream.write(struct.pack("<I", len(frame_ids)) + np.array(frame_ids, dtype="<u4").tobytes())


def write_detections(folder, boxes, classes, scores, masks, kept=None, dims=(1, 1, 1), protocol=None):
    """A result of 3D-SIS; masks are those of the kept boxes."""
    folder.mkdir(parents=True)
    np.save(folder / "pred_box.npy", np.asarray(boxes, dtype=np.float32).reshape(-1, 6))
    np.save(folder / "pred_class.npy", np.asarray(classes, dtype=np.int64))
    np.save(folder / "pred_conf.npy", np.asarray(scores, dtype=np.float64))
    np.save(folder / "scene.npy", np.zeros(dims, dtype=np.int64))
    kept = [True] * len(boxes) if kept is None else kept
    for name, value in (("pred_mask", masks), ("pred_mask_index", kept)):
        with (folder / name).open("wb") as stream:
            pickle.dump(value, stream, protocol=protocol)
