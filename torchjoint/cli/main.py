"""The entry point of the command line; lists the commands of torchjoint."""

from __future__ import annotations

from torchjoint.cli.commands import Command, run

COMMANDS = {
    "demo": Command("torchjoint.cli.demo:demo", "segments a rendered room, and scores it; needs no data"),
    "segment": Command("torchjoint.cli.segment:segment", "segments a recording: posed frames, with or without a cloud"),
    "batch": Command("torchjoint.cli.batch:batch", "segments any number of recordings over many workers"),
    "live": Command("torchjoint.cli.live:live", "plays a recording with depth, and segments what was seen so far"),
    "superpoints": Command("torchjoint.cli.superpoints:superpoints", "cuts a cloud of any size into superpoints"),
    "show": Command("torchjoint.cli.show:show", "shows a result in the browser"),
    "export": Command("torchjoint.cli.export:export", "writes a result in the format of another tool"),
    "edits": Command("torchjoint.cli.edits:edits", "brings corrections of another program back into a result"),
    "label": Command("torchjoint.cli.label:label", "puts labels into the file of a cloud, a mesh or Gaussian splats"),
    "formats": Command("torchjoint.cli.formats:formats", "lists the formats of recordings that can be read"),
    "parameters": Command("torchjoint.cli.parameters:parameters", "prints the parameters as tables"),
    "completion": Command("torchjoint.cli.completion:completion", "prints a script that completes commands in a shell"),
}

DESCRIPTION = """\
Joint segmentation of a point cloud and its images. The default needs no choice. --preset takes default, paper, or a
YAML file; that of superpoints takes default, scan, segmentator, or a YAML file."""

INTERRUPTED = "`segment` and `batch` resume when they are started again"


def main() -> None:
    """Entry point."""
    run("torchjoint", COMMANDS, DESCRIPTION, INTERRUPTED)
