"""Arguments that several commands share."""

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from torchjoint.config import Config, marked_table, parameter_table, presets, superpoint_table
from torchjoint.datasets.files.clouds import SUFFIXES
from torchjoint.datasets.formats import FORMATS
from torchjoint.recordings.segment import RecordingOptions
from torchjoint.results.folder import is_part
from torchjoint.runtime.outputs import Output, check_no_input, is_as_written


def parameters(
    stage: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[STAGE]", help_behavior_hint="")] = None,
    superpoints: bool = False,
) -> None:
    """Prints the parameters of the method with default, unit, sensible range and effect (Markdown).

    The first table lists the few parameters that users change, and the effect of values that are too low or too high.

    Args:
        stage: print only the parameters of this stage, such as paper.
        superpoints: print the parameters of `torchjoint superpoints` instead, with their values in each preset.
    """
    if superpoints and stage is not None:
        raise ValueError(f"parameters: expected no stage with --superpoints, which have one table, got {stage!r}")
    if superpoints:
        print(superpoint_table())
    elif stage is not None:
        print(parameter_table(stage))
    else:
        print(f"{marked_table()}\n\n{parameter_table()}")


def formats() -> None:
    """Lists the formats of recordings, and the files that each one needs; docs/your_data.md says more."""
    print("\n".join(f"{name:13} {module.WHAT}" for name, module in FORMATS.items()))


@dataclass(frozen=True)
class Parameters:
    """Parameters of the method."""

    preset: Annotated[str, tyro.conf.arg(help=f"{', '.join(presets())}, or a YAML file of your own.")] = "default"
    """A preset that comes with the package, or a YAML file of your own."""
    set: tuple[str, ...] = ()
    """Single parameters: --set image_segments.scale=5 visibility.depth_tolerance=0.02"""

    def config(self, out: Path | None = None) -> Config:
        """Returns the preset with the single parameters applied; its file must not be in `out`, which is replaced."""
        if out is not None and self.preset.endswith((".yaml", ".yml")):
            check_no_input(out, (Path(self.preset),))
        return Config.from_preset(self.preset).set(self.set)


#: The command line's defaults.
DEFAULTS = Parameters()
Flat = tyro.conf.OmitArgPrefixes[Parameters]
Out = Annotated[Path, tyro.conf.arg(aliases=["-o"])]
OptionalOut = Annotated[Path | None, tyro.conf.arg(aliases=["-o"])]


def read_topics(assignments: Iterable[str]) -> tuple[tuple[str, str], ...]:
    """Roles and topics of ``role=/topic``, as :class:`~torchjoint.recordings.RecordingOptions` has them."""
    parts = {assignment: assignment.partition("=") for assignment in assignments}
    for assignment, (role, _, topic) in parts.items():
        if not (role and topic):
            raise ValueError(f"--topics: expected ROLE=TOPIC, such as color=/camera/image_raw, got {assignment!r}")
    return tuple((role, topic) for role, _, topic in parts.values())


def output_file(out: Path, overwrite: bool, inputs: Sequence[Path | None], option: str = "-o") -> Output:
    """Checks that a file may be written; returns what writes it.

    Raises:
        FileNotFoundError, FileExistsError, ValueError: as :class:`~torchjoint.runtime.outputs.Output`; also if a folder
            stands there.
    """
    _check_parent(out, option)
    if out.is_dir():
        raise FileExistsError(f"{option}: {out} is a folder; expected the name of a file")
    return Output(out, overwrite=overwrite, inputs=inputs, option=option)


def output_files_in(out: Path, kinds: tuple[str, ...], overwrite: bool, inputs: Sequence[Path | None]) -> Output:
    """Checks that a folder of files with the suffixes `kinds` may be written; returns what writes it."""
    if out.suffix.lower() in (*kinds, *SUFFIXES) and not out.is_dir():
        raise ValueError(f"-o: expected a folder, for {', '.join(kinds)} files, got the name of a file, {out.name}")
    _check_parent(out, "-o")
    if out.is_symlink():
        raise FileExistsError(f"{out}: expected no link, and a folder; choose another name")
    made = Output(out, overwrite=overwrite, inputs=inputs)
    if out.exists() and not is_as_written(out):
        raise FileExistsError(f"{out}: holds more than {', '.join(kinds)} files of an export, or changed ones")
    return made


def _check_parent(out: Path, option: str) -> None:
    if not out.parent.is_dir():
        raise FileNotFoundError(f"{option}: {out.parent} is no folder; make it first")
    if not os.access(out.parent, os.W_OK | os.X_OK):  # else a long run would end with it
        raise PermissionError(f"{option}: {out}: the folder {out.parent} cannot be written; choose another output")
    if out.name == "-":
        raise ValueError(f"{option}: expected the name of a file or folder, got -, which stands for no stream here")
    if is_part(out):
        raise ValueError(f"{option}: expected a path outside of the parts of a result, got {out}")


@dataclass(frozen=True)
class Reading(RecordingOptions):
    """How recordings are read.

    Attributes:
        topics: for a ROS recording, if several topics fit a role: --topics color=/front/image_raw. The roles are color,
            info, depth, points and odometry.
    """

    topics: tuple[str, ...] = ()  # type: ignore[assignment]

    def options(self) -> RecordingOptions:
        """The options with the topics by their roles."""
        return RecordingOptions(**vars(self) | {"topics": read_topics(self.topics)})


#: The command line's defaults.
AS_IT_IS = Reading()
FlatReading = tyro.conf.OmitArgPrefixes[Reading]
