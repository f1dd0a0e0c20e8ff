"""What a file of a stranger may hold at most. All readers take their bounds from here, before they allocate memory.

A few bytes can declare, or unpack to, gigabytes. Each bound is far above what real data have. Some grow with the file:
a large file may hold more.
"""

#: Pixels of an image, of a mask, or numbers of all channels of an image of floats.
PIXELS = 64_000_000
#: Pixels inside all masks of one image together, or around its polygons.
INSIDE = 1 << 28
#: Masks of one image; pairs of a mask and an atom in it, of which nested masks have many; or of a frame and a key.
MASKS, PAIRS = 1 << 16, 1 << 22
#: Rows of all edges of an image's polygons together: each row that an edge crosses takes a step.
EDGE_ROWS = 1 << 24

#: Bytes of an image's file, of its EXIF data, of text that is read as a whole, of JSON, and of YAML, which takes a
#: thousand times as long.
IMAGE_BYTES, EXIF_BYTES, TEXT_BYTES, JSON_BYTES, YAML_BYTES = 1 << 29, 1 << 16, 1 << 30, 1 << 28, 1 << 22
#: Pixels of all scans of a progressive JPEG together: each scan takes as long as a whole image.
SCANNED = 1 << 34
#: Values of a JSON file: an empty list has two bytes there, and 64 in memory.
JSON_VALUES = 1 << 24
#: XML elements in each other: the library of E57 takes time with the square of it.
NESTED = 1000
#: Characters of a line of text.
LINE = 1 << 24

#: Elements of a header, and properties, or fields, of all of them.
ELEMENTS, PROPERTIES = 256, 4096
#: Rows of lists of several lengths, each of which takes a step in Python.
LIST_ROWS = 1 << 24
#: Values of the vertices and triangles of a mesh that stands at many places, beyond POINTS_PER_BYTE.
INSTANCED = 16_000_000
#: Pixels of all textures of a mesh together; its vertices times its materials, each of which takes all vertices; and
#: the nodes above its parts, which are as many steps for each of them.
TEXTURES, MATERIAL_STEPS, NODE_STEPS = 1 << 29, 1 << 31, 1 << 21
#: Corrections of a result times levels at which names were given: at each level all corrections are applied.
LEVEL_STEPS = 1 << 20
#: Files of a recording that are looked through for changes.
FILES = 1_000_000

#: Bytes of unpacked data: RATIO x the packed ones + FREE. Labels compress well, decompression bombs even better.
RATIO, FREE = 100, 1 << 30
#: Points of a packed cloud: POINTS_PER_BYTE x its bytes + FREE_POINTS. Real scans have less than one in a byte.
POINTS_PER_BYTE, FREE_POINTS = 4, 1_000_000


def check(got: int, most: int, what: str, name: str = "") -> None:
    """Checks a number that data declare.

    Raises:
        ValueError: it is beyond its bound, or below 0; the message begins with `name`, if there is one.

    >>> check(3, 2, "elements", "cloud.ply")
    Traceback (most recent call last):
    ValueError: cloud.ply: expected at most 2 elements, got 3
    """
    if not 0 <= got <= most:
        raise ValueError(f"{name}{': ' if name else ''}expected at most {most} {what}, got {got}")


def check_pixels(height: int, width: int, name: str = "") -> None:
    """Checks the size of an image; errors as of :func:`check`."""
    if height < 0 or width < 0 or height * width > PIXELS:
        head = f"{name}: " if name else ""
        raise ValueError(f"{head}{width} x {height} pixels are too many (at most {PIXELS})")


def check_unpacked(size: int, packed: int, name: str = "") -> None:
    """Checks how many bytes `packed` bytes become; errors as of :func:`check`."""
    check(size, RATIO * packed + FREE, f"bytes when {packed} bytes are unpacked", name)


def check_points(count: int, packed: int, name: str = "") -> None:
    """Checks how many points `packed` bytes hold; errors as of :func:`check`."""
    check(count, POINTS_PER_BYTE * packed + FREE_POINTS, f"points in {packed} bytes", name)
