"""The same as LAZ."""

from samples import cloud_alone_las

FORMAT = "cloud_alone"


def write(folder):
    return cloud_alone_las.write(folder, "cloud.laz")
