"""A wall of which something in front hides a part, by hand."""

import torch

from torchjoint.segments.planes import Planes
from torchjoint.views.observations import Observation
from torchjoint.views.visibility import Visible

FOCAL, HEIGHT, WIDTH = 20.0, 8, 12
LEFT, STRIP, RIGHT = 0, 1, 2


def wall_behind_a_strip(
    left=2.0, strip=1.0, right=2.0, slope=0.0, rows=HEIGHT, strip_width=4, turned=False, upside_down=False
):
    """What a camera at the origin sees, a point a pixel: a wall, of which a strip in its middle hides a part.

    Args:
        left, strip, right: depths, metres.
        slope: of the right part, depth per metre to the right.
        rows: of the image in which the strip is there.
        turned: rows and columns change places.
        upside_down: the normals of the right part show away from the camera.
    """
    row, column = (grid.flatten() for grid in torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij"))
    begin = (WIDTH - strip_width) // 2
    segment = torch.where(column < begin, LEFT, torch.where(column < begin + strip_width, STRIP, RIGHT))
    there = (segment != STRIP) | (row < rows)
    row, column, segment = row[there], column[there], segment[there]
    across = (column - WIDTH / 2) / FOCAL  # x / z
    z = torch.tensor([left, strip, right])[segment]
    z = torch.where(segment == RIGHT, z / (1 - slope * across), z)
    points = torch.stack([across * z, (row - HEIGHT / 2) / FOCAL * z, z], 1)
    normal = torch.tensor([[0.0, 0.0, -1.0]]).repeat(len(z), 1)
    normal[segment == RIGHT] = torch.nn.functional.normalize(torch.tensor([slope, 0.0, -1.0]), dim=0)
    if upside_down:
        normal[segment == RIGHT] *= -1
    if turned:
        row, column, points, normal = column, row, points[:, [1, 0, 2]], normal[:, [1, 0, 2]]
    point = torch.arange(len(z))
    visible = Visible(point, row, column, column.float(), row.float(), z)
    size = (WIDTH, HEIGHT) if turned else (HEIGHT, WIDTH)
    image = torch.zeros(3, *size, dtype=torch.uint8)
    seen = Observation("", torch.zeros(size, dtype=torch.int32), visible, torch.eye(3), torch.eye(4), image, image[0])
    return segment, Planes(points, normal), [seen]
