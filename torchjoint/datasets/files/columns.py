"""What a cloud's columns mean, by the names that programs give them: one table and one scale for all readers.

Names are compared without case, `_`, and the prefix `scalar_` of CloudCompare. Each column of a file is read, or stands
in the table of what is not read, or a warning names it.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.scene.checks import tell_half
from torchjoint.scene.cloud import full_brightness

Array = npt.NDArray[Any]

#: The first names are those of most files, the others those of surveys.
POINTS = (("x", "y", "z"), ("e", "n", "h"), *(("easting", "northing", up) for up in ("z", "height", "elevation")))
COLORS = tuple(
    tuple(f"{prefix}{color}" for color in colors)
    for colors in (("red", "green", "blue"), ("r", "g", "b"))
    for prefix in ("", "diffuse", "color", "colour", "vertex")
)
NORMALS = (("nx", "ny", "nz"), ("normalx", "normaly", "normalz"))
#: Gaussian splats (Kerbl et al. 2023): the constant term of the colour's spherical harmonics, and this basis function.
#: Their opacity is stored before a sigmoid.
HARMONICS, CONSTANT, OPACITY = (("fdc0", "fdc1", "fdc2"),), 0.5 / np.pi**0.5, (("opacity",),)
#: Red, green and blue in one number of four bytes: b g r a.
PACKED = ("rgb", "rgba", "color", "bgr", "bgra")
#: The bits of NaN as text gives it: no colour. Other bits of NaN are colours whose a is 255.
UNKNOWN = 0x7FC00000
#: Columns that no reader reads, and that no one expects to be read.
NOT_READ = re.compile(
    r"a|alpha|(diffuse|color|colour|vertex)(a|alpha)|intensity|reflectance|reflectivity|i|ambient|noise|ring|channel|line|"
    r"tag|range|distance|(gps|scan|time|offset|sweep)*(time|timestamp|stamp|stampsec|stampnsec)?|t|curvature|quality|"
    r"confidence|value|radius|flags?|label|labels|class|classification|category|semantic|instance|object|objectid|"
    r"segment|superpoint|thing|id|index|number|frest\d+|scale\d+|rot\d+|u|v|s|texture[uv]|viewpoint[xyz]|vp[xyz]|"
    r"padding\d*|_?\d*|filterid|returnnumber|numberofreturns|(original)?cloudindex|material(index|id)|face\w*|edges?"
)

#: What a comment says of lengths that are no metres.
NO_METRE = re.compile(rb"^(?:comment|obj_info|#|/).*?\b((units?|lengths?|scale|in)\b[^\w\n]{0,3}(of |are |is |in ){0,3}"
    rb"([cmk]m|(milli|centi|kilo)met\w+|(us[- ]?)?(survey )?f(ee|oo)?t|inch\w*))\b", re.I | re.M)  # fmt: skip

#: Normals that are shorter have no direction. If more than this share of a column's values is wrong, it is left out.
SHORTEST, MOST_WRONG = 1e-3, 0.5
#: Colours may be rounded by less than this.
EDGE = 1e-4


class CloudFile(NamedTuple):
    """The contents of a file with a cloud or a mesh."""

    points: Tensor  #: [N, 3] metres, float32 or float64 as in the file
    colors: Tensor | None = None  #: [N, 3] float32 RGB in [0, 1]
    normals: Tensor | None = None  #: [N, 3] float32
    faces: Tensor | None = None  #: [F, 3] int64, triangles of a mesh
    opacities: Tensor | None = None  #: [N] float32 in [0, 1], of Gaussian splats

    def chosen(self, which: Tensor) -> CloudFile:
        """The points that a mask [N] chooses, and the triangles between them."""
        if bool(which.all()):
            return self
        parts = [None if one is None else one[which] for one in self._replace(faces=None)]
        if self.faces is not None:
            parts[3] = (which.cumsum(0) - 1)[self.faces[which[self.faces].all(1)]]
        return CloudFile(*parts)  # type: ignore[arg-type]


def cloud_of(columns: Mapping[str, Array], name: str) -> CloudFile:
    """The cloud that columns [N] of numbers, or [N, k], describe; warnings begin with `name`."""
    found: dict[str, str] = {}
    for column in sorted(columns, key=lambda column: (plain(column) != column, column != column.lower())):
        if columns[column].ndim == 1:
            found.setdefault(plain(column), column)
    used: set[str] = set()

    def group(names: Iterable[Sequence[str]]) -> list[Array] | None:
        """The columns of the first of several groups that is whole."""
        for one in names:
            if all(part in found for part in one):
                used.update(found[part] for part in one)
                return [columns[found[part]] for part in one]
        return None

    xyz = group(POINTS)
    if xyz is None:
        missing = ", ".join(axis for axis in "xyz" if axis not in found)
        raise ValueError(f"expected x, y and z, got {', '.join(columns) or 'nothing'}: {missing} missing")
    points = _stacked(xyz, np.float32 if all(column.dtype.str[1:] == "f4" for column in xyz) else np.float64)
    if any(column.dtype.str[1:] == "f2" for column in xyz):
        tell_half(float(points.abs().max()), torch.float16, name)
    rgb, normals, opacities = group(COLORS), group(NORMALS), None
    if rgb is not None and all(one.dtype.kind in "iu" for one in rgb) and max(one.max(initial=0) for one in rgb) == 1:
        warnings.warn(f"{name}: colours are only 0 and 1 of 255, and are read as black: not of 0 to 1?", stacklevel=4)
    colors = None if rgb is None else unit_colors(np.stack(rgb, axis=1))
    for packed in PACKED:
        whole = next((column for column in columns if plain(column) == packed), None)
        if colors is None and whole is not None and (read := _unpacked(columns[whole])) is not None:
            colors = unit_colors(read)
            used.add(whole)
    if (harmonics := group(HARMONICS)) is not None:
        if (faint := group(OPACITY)) is not None:
            opacities = _stacked(faint, np.float32)[:, 0]
            if opacities.any() and ((opacities >= 0) & (opacities <= 1)).all():
                warnings.warn(f"{name}: opacities of 0 to 1 are read as they are, without a sigmoid", stacklevel=4)
            else:
                opacities = opacities.sigmoid()
        colors = (0.5 + CONSTANT * _stacked(harmonics, np.float32)).clamp(0, 1) if colors is None else colors
    tell_not_read([column for column in columns if column not in used], name)
    has_any = normals is not None and any(column.any() for column in normals)  # splats have zeros, for example
    return CloudFile(points, colors, _stacked(normals, np.float32) if normals and has_any else None, None, opacities)


def tell_not_read(columns: Iterable[str], name: str) -> None:
    """Warns of columns that are not read, but for those of which no one expects it."""
    left = [column for column in columns if not NOT_READ.fullmatch(plain(column))]
    if left:
        some = ", ".join(left[:8]) + (f" and {len(left) - 8} more" if len(left) > 8 else "")
        what = "kept by `label`, without effect" if name.lower().endswith((".las", ".laz")) else "not used"
        told = f"{name}: {some}: no position, normal or colour by these names; {what} (docs/your_data.md)"
        warnings.warn(told, stacklevel=5)


def colors_of_all(parts: Sequence[tuple[str, Tensor | None]], name: str, what: str) -> Tensor | None:
    """The colours of parts of a cloud, by their names, as one; None if a part has none, which a warning tells."""
    bare = [part for part, colors in parts if colors is None]
    if 0 < len(bare) < len(parts):
        told = f"{name}: {len(bare)} of {len(parts)} {what} have no colours, so those of the others are not read"
        warnings.warn(f"{told}: {', '.join(bare[:9])}", stacklevel=5)
    return None if bare or not parts else torch.cat([colors for _, colors in parts if colors is not None])


def plain(column: str) -> str:
    """The name of a column as it stands in the tables."""
    return re.sub(r"[\s_.-]", "", column.lower().removeprefix("scalar_").removeprefix("scalar "))


def unit_colors(colors: Array) -> Tensor:
    """Colours [N, 3] of one file, of any type and scale, as [N, 3] float32; NaN and what is no colour stay outside."""
    if colors.dtype.kind not in "iuf":
        raise ValueError(f"colors: expected numbers, got {colors.dtype}")
    # Signed bytes are bytes; 65535 is beyond float16.
    colors = colors.astype({"b": "u1", "e": "f4"}.get(colors.dtype.char, colors.dtype), copy=False)
    is_float = colors.dtype.kind == "f"
    largest = float(np.max(colors, initial=0, where=np.abs(colors) <= 65535 if is_float else True))
    if is_float and np.sum((colors > 0) & (colors < 1)) > 10 * np.sum(colors > 1):
        largest = 1.0  # the few that are brighter are out of range, and must not darken the others
    elif is_float and largest == 256:
        warnings.warn("colours of 0 to 256: 256 is taken as 255, full brightness", stacklevel=4)
        colors, largest = np.where(colors == 256, 255, colors), 255.0
    most = None if is_float else int(np.iinfo(colors.dtype).max)
    white = 255 if colors.dtype == np.uint8 else full_brightness(largest, most)
    return torch.from_numpy((colors if white == 1 else colors / white).astype(np.float32))


def typed(values: npt.NDArray[np.float64], kind: npt.DTypeLike, name: str, where: str) -> Array:
    """Numbers from text in their own type; integers must fit into it."""
    # float32 would round places in a survey, and the 32 bits of a colour that PCL writes.
    is_large = np.fmax.reduce(np.abs(values), axis=None, initial=0) > 1e5
    dtype = np.dtype(np.float64 if is_large and np.dtype(kind) == np.float32 else kind)
    with np.errstate(over="ignore", invalid="ignore"):
        converted: Array = values.astype(dtype, copy=False)
    if dtype.kind != "f" and (converted != values).any():  # also of NaN
        raise ValueError(f"{name}: expected integers of {dtype.itemsize * 8} bits in {where}")
    return converted


def repaired(cloud: CloudFile, name: str) -> CloudFile:
    """The cloud with values of the nearest points for NaN in colours, normals and opacities, and what is none of them.

    What is hardly right anywhere is left out. Warnings begin with `name`, and tell the numbers.
    """
    has_place = cloud.points.isfinite().all(1)
    for what in ("colors", "normals", "opacities"):
        values: Tensor | None = getattr(cloud, what)
        if values is None:
            continue
        wide = values.view(len(values), -1)
        right = wide.isfinite().all(1)
        if what != "opacities":
            right &= wide.norm(dim=1) > SHORTEST if what == "normals" else ((wide > -EDGE) & (wide < 1 + EDGE)).all(1)
        wrong, known = ((has_place & which).nonzero().squeeze(1) for which in (~right, right))
        if not len(wrong):
            continue
        or_else = {"normals": " or of length 0", "colors": " or out of range", "opacities": ""}[what]
        told = f"{name}: {len(wrong)} of {len(values)} {what} are NaN{or_else}; "
        if len(wrong) > MOST_WRONG * len(values):
            if bool(wide.any()):  # some programs write zeros where they have no normals
                warnings.warn(f"{told}the {what} are not read", stacklevel=4)
            cloud = cloud._replace(**{what: None})  # type: ignore[arg-type]
            continue
        warnings.warn(f"{told}they are taken from the nearest points", stacklevel=4)
        from scipy.spatial import cKDTree

        near = cKDTree(cloud.points[known].double().numpy()).query(cloud.points[wrong].double().numpy())[1]
        cloud = cloud._replace(**{what: values.index_copy(0, wrong, values[known[torch.from_numpy(near)]])})
    return cloud


def _stacked(columns: Sequence[Array], kind: npt.DTypeLike) -> Tensor:
    made = np.empty((len(columns[0]), len(columns)), kind)
    with np.errstate(over="ignore", invalid="ignore"):
        for place, column in enumerate(columns):
            made[:, place] = column
    return torch.from_numpy(made)


def _unpacked(packed: Array) -> Array | None:
    """Colours [N, 3] of a column whose numbers hold red, green and blue, NaN where it is NaN; None if they do not."""
    if packed.ndim == 2:
        return packed[:, :3] if packed.shape[1] in (3, 4) else None
    if packed.dtype.itemsize == 8 or packed.dtype.kind == "f":  # their bits, or their value
        known, most = packed[~np.isnan(packed)], 1 << (24 if packed.dtype.itemsize == 4 else 32)
        whole = packed.dtype.kind != "f" or (1 <= np.abs(known).max(initial=0) < most and not (known % 1).any())
        packed = np.where(np.isnan(packed), UNKNOWN, packed) if whole else packed.astype(np.float32)
        packed = packed.astype(np.int64).astype(np.uint32) if whole else packed
    if packed.dtype.itemsize != 4:
        return None
    value = np.ascontiguousarray(packed.astype(packed.dtype.newbyteorder("="))).view(np.uint32)
    colors = np.stack([(value >> shift).astype(np.uint8) for shift in (16, 8, 0)], axis=1)
    unknown = (value == UNKNOWN)[:, None]
    return np.where(unknown, np.nan, colors / 255) if unknown.any() else colors
