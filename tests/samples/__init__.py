"""The smallest genuine sample of every format, one file a format, written with nothing of the readers' code.

Each module has `write(folder) -> Path`: it writes a sample into an empty folder and returns the path that
`tj.load_scene` is to be given; and `FORMAT`, where the format's name is not the module's. Samples are small (a few kB),
since tests/test_fuzz.py cuts and flips their bytes.
"""

from importlib import import_module
from pathlib import Path

FORMATS = tuple(sorted(file.stem for file in Path(__file__).parent.glob("[a-z]*.py")))
#: Formats of clouds without images.
WITHOUT_IMAGES = ("cloud_alone", "s3dis")


def write(name, folder):
    """Writes a sample of a format into a folder, which is made; returns the path to load."""
    folder.mkdir(parents=True)
    return import_module(f"samples.{name}").write(folder)


def format_of(name):
    """The name of a sample's format."""
    return getattr(import_module(f"samples.{name}"), "FORMAT", name)
