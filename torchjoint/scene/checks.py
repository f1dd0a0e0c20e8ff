"""Checks of a scene's parts, before step 1. Each check raises TypeError or ValueError.

The message calls the argument `name`, and says what was expected and what came.
"""

import warnings
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.runtime.groups import check_dense

#: What becomes of points that are NaN or infinite.
Invalid = Literal["refuse", "drop", "keep"]
Beams = Literal["keep", "drop many", "drop any"]

#: Largest difference of R R^T from the identity, of det R from 1, and of the last row from 0 0 0 1, in a valid pose.
#: Poses in text files have 7 digits. Poses that were averaged or interpolated wrongly have much larger differences.
RIGID_TOLERANCE = 1e-3

#: Larger skew, in focal lengths, is an error: none is applied.
MOST_SKEW = 2e-3

#: Fewer points at (0, 0, 0) than this are no beams without return, unless the points are known to be a scan.
BEAMS = 10

#: Largest coordinate, because squares of distances, and their sums, must fit into float32.
LARGEST_COORDINATE = 1e12

#: A cloud that is so many times taller than wide has degrees for metres: a site of 3 km, or a pole of 10 m, has fewer.
TALLEST = 300


def as_points(points: Tensor, name: str = "points") -> Tensor:
    """Checks a cloud: [N, 3], N >= 1, finite; returns it as float32, or as float64 if float32 would round it."""
    check_dense(points, name)
    if points.dtype.is_floating_point and points.ndim == 2 and not _is_finite(points):
        bad = int((~points.isfinite()).any(1).sum())
        others = f"{name}[{name}.isfinite().all(1)]"
        raise ValueError(f"{name}: {bad} of {len(points)} points are NaN or infinite; {others} are the others")
    if points.dtype in (torch.float16, torch.bfloat16) and points.numel():
        tell_half(float(points.abs().max()), points.dtype, name)
    points = as_float(points, name, points.dtype if points.dtype == torch.float64 else torch.float32)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"{name}: expected shape [N, 3], got {list(points.shape)}")
    if points.shape[0] == 0:
        raise ValueError(f"{name}: expected at least one point, got an empty cloud")
    check_largest(points, name)
    if points.dtype == torch.float64:
        rounded = points.float()
        return rounded if torch.equal(rounded.double(), points) else points
    return points


def tell_half(largest: float, dtype: torch.dtype, name: str) -> None:
    """Warns of coordinates of 16 bits, whose steps are those of the largest one."""
    step = largest * torch.finfo(dtype).eps
    told = f"{name}: {dtype} keeps only {step:.2g} m this far from the origin; give float32 or float64"
    warnings.warn(told, stacklevel=4)


def tell_degrees(points: Tensor, name: str) -> None:
    """Warns if points [N, 3] look like longitude, latitude and metres: nothing is so tall above so small a base."""
    size = points.amax(0) - points.amin(0) if len(points) else points.new_zeros(3)
    base, tall = float(size[:2].max()), float(size[2])
    is_site = 0 < base < min(1, tall / TALLEST) and tall < 9000  # not a table-top with one wrong point
    if is_site and float(points[:, :2].abs().max()) <= 360:
        warnings.warn(f"{name}: are x and y in degrees, z in metres? Project them before", stacklevel=4)


def check_largest(value: Tensor, name: str) -> None:
    """Checks that no number of a tensor is larger than LARGEST_COORDINATE; NaN is not looked at."""
    largest = max(abs(one.item()) for one in value.aminmax()) if value.numel() else 0
    if largest > LARGEST_COORDINATE:
        raise ValueError(f"{name}: expected coordinates up to {LARGEST_COORDINATE:g}, got {largest:.4g}")


def without_return(points: Tensor, any_counts: bool = False) -> Tensor:
    """Which points [N, 3] are exactly (0, 0, 0): beams without return, as many drivers of LiDARs write them; [N] bool.

    Fewer than BEAMS or one in a hundred, unless `any_counts`, are points as others are; so are all.
    """
    none = ~points.any(1)
    fewest = 1 if any_counts else max(BEAMS, len(points) // 100)
    return none if fewest <= int(none.sum()) < len(none) else torch.zeros_like(none)


def kept_points(points: Tensor, name: str, invalid: Invalid, beams: Beams = "keep", cuts: Sequence[int] = ()) -> Tensor:
    """Which points [N, 3] are kept, [N] bool.

    Args:
        points: [N, 3].
        name: begins the messages.
        invalid: what becomes of points that are NaN or infinite; "drop" warns of their number.
        beams: what becomes of beams without return, see :func:`without_return`: they are kept; or left out, with a
            warning, if they are many, or if there are any.
        cuts: where the second and further clouds begin, if the points are those of several: beams are many in one.
    """
    valid = torch.isfinite(points).all(1)
    bad = int((~valid).sum())
    check_largest(points[valid] if bad else points, name)
    if bad and invalid != "keep":
        told = f"{name}: {bad} of {len(points)} points are NaN or infinite"
        if invalid == "refuse" or bad == len(points):
            raise ValueError(f"{told}; --drop-invalid (drop_invalid=True) leaves them out")
        warnings.warn(f"{told}; they are left out", stacklevel=3)
    valid |= invalid == "keep"
    none = torch.cat([without_return(cloud, beams == "drop any") for cloud in points.tensor_split(tuple(cuts))])
    if beams != "keep" and bool(none.any()):
        told = f"{name}: {int(none.sum())} of {len(points)} points are (0, 0, 0), beams without return"
        warnings.warn(f"{told}; they are left out", stacklevel=3)
        valid &= ~none
    return valid


def as_pose(pose: Tensor, name: str = "world_to_camera") -> Tensor:
    """Checks a rigid transform [4, 4]; returns it as float64."""
    pose = as_float(pose, name, torch.float64).clone()  # callers may write the next one into theirs
    check_shape(pose, (4, 4), name)
    check_largest(pose, name)
    rotation = pose[:3, :3]
    error = (rotation @ rotation.T - torch.eye(3, dtype=torch.float64, device="cpu")).abs().max().item()
    determinant = torch.linalg.det(rotation).item()
    last_row = (pose[3] - torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=torch.float64, device="cpu")).abs().max().item()
    if error > RIGID_TOLERANCE or abs(determinant - 1) > RIGID_TOLERANCE or last_row > RIGID_TOLERANCE:
        told = f"{name}: expected a rigid transform [R t; 0 1], got R R^T off the identity by {error:.3g}"
        raise ValueError(f"{told}, det R = {determinant:.6g}, last row {pose[3].tolist()}")
    return pose


def as_labels(labels: Tensor, size: tuple[int, ...], name: str = "labels") -> Tensor:
    """Checks labels of shape `size`: integers >= -1, or bool (True -> 0, False -> -1 = none); returns them as int64."""
    check_dense(labels, name)
    if labels.dtype.is_floating_point or labels.dtype.is_complex:
        raise TypeError(f"{name}: expected an integer dtype, got {labels.dtype}")
    check_shape(labels, size, name)
    if labels.dtype == torch.bool:
        return torch.where(labels, 0, -1)
    if labels.dtype == torch.uint8 and (values := labels.unique().tolist())[:1] == [0] and len(values) == 2:
        told = f"{name}: got only 0 and {values[1]}, as in the image of a mask"
        raise ValueError(f"{told}; its background would be a segment: pass `mask > 0`, or int64 labels (-1 = none)")
    is_byte, labels = labels.dtype == torch.uint8, labels.to(torch.int64)  # readers of files have widened other dtypes
    least, largest = map(int, labels.aminmax()) if labels.numel() else (0, 0)
    if largest in (65535, 2**32 - 1) or (is_byte and largest == 255):
        warnings.warn(f"{name}: {largest} is a label; if it was -1 (none), give integers with a sign", stacklevel=4)
    if least < -1:
        raise ValueError(f"{name}: expected labels >= -1 (-1 = none), got {least}")
    return labels


def as_tensor(value: npt.NDArray[Any], name: str) -> Tensor:
    """The tensor of a NumPy array; TypeError if its numbers have a type that tensors do not have, or a mask."""
    if isinstance(value, np.ma.MaskedArray):
        raise TypeError(f"{name}: expected no masked array, whose mask would be lost; give filled(...)")
    try:
        # A copy: the array may be read-only, change, or have the bytes of another machine.
        return torch.from_numpy(np.array(value, dtype=value.dtype.newbyteorder("="), order="C"))
    except TypeError as error:
        raise TypeError(f"{name}: expected numbers, got an array of {value.dtype}") from error


def as_image(image: Tensor, name: str) -> Tensor:
    """Checks an image: [3, H, W], or grey [1, H, W] or [H, W]; returns it as [3, H, W] float32 RGB in [0, 1]."""
    check_dense(image, name)
    image = image[None] if image.ndim == 2 else image
    if image.ndim != 3 or image.shape[0] not in (1, 3):
        raise ValueError(f"{name}: expected shape [3, H, W] (NumPy: [H, W, 3]; grey: [H, W]), got {list(image.shape)}")
    if image.numel() == 0:
        raise ValueError(f"{name}: expected at least one pixel, got {list(image.shape)}")
    return as_unit_range(image, name).expand(3, -1, -1)


def as_unit_range(value: Tensor, name: str) -> Tensor:
    """Checks colours in [0, 1], or uint8; returns them as float32 in [0, 1], uint8 colours divided by 255."""
    check_dense(value, name)
    if value.dtype == torch.uint8:
        return value.to(torch.float32).div_(255)
    value = as_float(value, name, torch.float32)
    low, high = (value.min().item(), value.max().item()) if value.numel() else (0.0, 0.0)
    if low < -1e-4 or high > 1 + 1e-4:
        raise ValueError(f"{name}: expected values in [0, 1] (or uint8), got [{low:.4g}, {high:.4g}]")
    if 0 < high < 1.01 / 255 and len(value.unique()) > 2:  # a dark image has 0 and 1 / 255
        warnings.warn(f"{name}: got values up to {high:.2g} of 1; were they divided by 255 twice?", stacklevel=5)
    return value.clamp(0, 1)


def as_direction(value: Tensor, name: str) -> Tensor:
    """Returns a direction [3] of any length but 0 as a unit vector, float64."""
    value = as_float(value, name, torch.float64)
    check_shape(value, (3,), name)
    if not value.norm() > 0:
        raise ValueError(f"{name}: expected a direction, got zeros")
    return value / value.norm()


def as_intrinsics(intrinsics: Tensor, name: str) -> Tensor:
    """Checks a camera matrix [3, 3] of any real numbers, in pixels; returns it as float64. Skew would be ignored."""
    check_dense(intrinsics, name)
    if not (intrinsics.is_floating_point() or intrinsics.is_complex()):
        intrinsics = intrinsics.double()
    intrinsics = as_float(intrinsics, name, torch.float64).clone()
    check_shape(intrinsics, (3, 3), name)
    zeros = intrinsics[[1, 2, 2], [0, 0, 1]]
    check_largest(intrinsics, name)
    is_skewed = intrinsics[0, 1].abs() > MOST_SKEW * intrinsics[0, 0]
    if intrinsics.diag()[:2].min() <= 0 or zeros.abs().max() > 1e-9 or (intrinsics[2, 2] - 1).abs() > 1e-9 or is_skewed:
        raise ValueError(f"{name}: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], f > 0, got {intrinsics.tolist()}")
    return intrinsics


def as_float(value: Tensor, name: str, dtype: torch.dtype) -> Tensor:
    """Checks a finite floating CPU tensor; returns it as `dtype`. To become float64, it has 32 bits or more."""
    check_dense(value, name)
    if not value.dtype.is_floating_point or value.dtype.itemsize * 2 < dtype.itemsize:  # 16 bits round poses by 0.05 %
        raise TypeError(f"{name}: expected a floating dtype, got {value.dtype}; give float32 or float64")
    if not _is_finite(value):
        count = int((~torch.isfinite(value)).sum())
        raise ValueError(f"{name}: expected finite values, got {count} NaN or infinite of {value.numel()}")
    return value.detach().resolve_neg().to(dtype)


def _is_finite(value: Tensor) -> bool:
    # If any value is NaN, both extremes are NaN. This takes a tenth of the time of a test of each value.
    return value.numel() == 0 or bool(torch.stack(value.aminmax()).isfinite().all())


def check_shape(value: Tensor, shape: tuple[int, ...], name: str) -> None:
    """Checks a tensor's shape."""
    if tuple(value.shape) != tuple(shape):
        raise ValueError(f"{name}: expected shape {list(shape)}, got {list(value.shape)}")
