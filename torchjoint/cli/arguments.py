"""Arguments and checks that several commands share: parameters of the method, frame limits, overwrite protection."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from torchjoint.config import Config, presets
from torchjoint.datasets.formats.cloud_alone import SUFFIXES


@dataclass(frozen=True)
class Parameters:
    """Parameters of the method."""

    preset: Annotated[str, tyro.conf.arg(help=f"{', '.join(presets())}, or a YAML file of your own.")] = "default"
    """A preset that comes with the package, or a YAML file of your own."""
    set: tuple[str, ...] = ()
    """Single parameters: --set image_segments.scale=5 visibility.depth_tolerance=0.02"""

    def config(self) -> Config:
        """Returns the preset with the single parameters applied."""
        is_file = self.preset.endswith((".yaml", ".yml"))
        config = Config.from_yaml(self.preset) if is_file else Config.from_preset(self.preset)
        return config.set(self.set)


#: The command line's defaults.
DEFAULTS = Parameters()
Flat = tyro.conf.OmitArgPrefixes[Parameters]
Out = Annotated[Path, tyro.conf.arg(aliases=["-o"])]


def read_topics(assignments: Iterable[str]) -> tuple[tuple[str, str], ...]:
    """Roles and topics of ``role=/topic``, as :class:`~torchjoint.recordings.RecordingOptions` has them.

    Raises:
        ValueError: an assignment has another form.
    """
    parts = {assignment: assignment.partition("=") for assignment in assignments}
    for assignment, (role, _, topic) in parts.items():
        if not (role and topic):
            raise ValueError(f"--topics: expected ROLE=TOPIC, such as color=/camera/image_raw, got {assignment!r}")
    return tuple((role, topic) for role, _, topic in parts.values())


def check_output(out: Path, names: Iterable[str], overwrite: bool) -> None:
    """Checks that files with these names may be written into folder `out`.

    Raises:
        FileExistsError: `out` is not a folder, or it holds one of the files and `overwrite` is False.
    """
    if out.exists() and not out.is_dir():
        raise FileExistsError(f"-o: {out} exists and is not a folder")
    for name in names:
        if (out / name).exists() and not overwrite:
            raise FileExistsError(f"{out / name}: exists already; choose another folder with -o, or --overwrite")


@contextmanager
def folder_of(out: Path, *kinds: str) -> Iterator[Path]:
    """Yields the path of a new folder beside `out`, to be written; then it becomes `out`, and replaces an earlier one.

    Raises:
        FileExistsError: the earlier one holds more than files with the suffixes `kinds`, and folders of them.
        ValueError: `out` has the name of a file.
    """
    if out.suffix.lower() in (*kinds, *SUFFIXES) and not out.is_dir():
        raise ValueError(f"-o: expected a folder, for {', '.join(kinds)} files, got the name of a file, {out.name}")
    if out.exists() and not (out.is_dir() and all(_is_kind(file, kinds) for file in out.iterdir())):
        raise FileExistsError(f"{out}: holds more than {', '.join(kinds)} files and will not be overwritten")
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=f".{out.name}.") as temporary:
        yield Path(temporary) / "new"
        if out.exists():
            os.replace(out, Path(temporary) / "old")
        os.replace(Path(temporary) / "new", out)


def _is_kind(file: Path, kinds: tuple[str, ...]) -> bool:
    """Whether an earlier run may have written a file, or the folder of ScanNet's masks."""
    if file.is_dir():
        return file.name == "predicted_masks" and all(mask.suffix in kinds for mask in file.iterdir())
    return file.suffix in kinds
