"""A cloud without images."""

from samples._parts import wall, write_ply


def write(folder):
    write_ply(folder / "cloud.ply", wall())
    return folder / "cloud.ply"
