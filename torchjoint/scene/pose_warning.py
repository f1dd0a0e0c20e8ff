"""Warnings about poses, and what poses may be instead of world to camera in OpenCV's axes."""

#: In words, after "the poses look".
CONVENTIONS = {
    "inverted": "inverted: expected world_to_camera, but they fit better as camera-to-world",
    "axes": "to be in OpenGL axes (y up, z backwards): expected OpenCV axes (y down, z forwards)",
    "inverted axes": "to be camera-to-world in OpenGL axes: expected world_to_camera in OpenCV axes",
}


class PoseWarning(UserWarning):
    """The poses or intrinsics look wrong."""


class PoseDoubt(PoseWarning):
    """The same, of something that right poses or intrinsics can have, too: a cropped image, or few edges."""
