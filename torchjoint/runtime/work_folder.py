"""The folder in which a run works, beside its output, so that an interrupted run can resume.

Others may have made a folder of the same name, or unpacked one. So each file that says what a folder is begins with a
seal, the inode of the folder, which only the system gives. Renaming the folder keeps it; a copy, or an archive that is
unpacked, has another. What has no right seal is of no run: it is neither used nor deleted.
"""

from __future__ import annotations

import shutil
from pathlib import Path

from torchjoint.runtime.files import PARTIAL, no_link, remove_partial_files, write_text

#: The file that says what a work folder is for.
SOURCE = "source.txt"


def _seal(file: Path) -> bytes:
    return f"torchjoint {file.parent.stat().st_ino}\n".encode()


def write_sealed(file: Path, text: str) -> None:
    """Writes a file that counts only in the folder in which it is."""
    write_text(file, _seal(file).decode() + text)


def read_sealed(file: Path) -> str | None:
    """Reads what :func:`write_sealed` wrote; None if there is no such file, or not of this folder."""
    if file.is_symlink() or not file.is_file():
        return None
    with file.open("rb") as stream:
        seal = _seal(file)
        return stream.read().decode(errors="replace") if stream.read(len(seal)) == seal else None


def work_folder(folder: Path, source: str) -> Path:
    """Makes the folder of a run, or finds that of an interrupted run with the same source; others are emptied.

    Args:
        folder: its path.
        source: all on which its content depends.

    Raises:
        FileExistsError: there is such a folder, but no run made it; or a link is in it.
    """
    for path in (folder, *folder.rglob("*")):
        no_link(path)
    folder.mkdir(parents=True, exist_ok=True)
    known = read_sealed(folder / SOURCE)
    # A run may be killed after it made the folder, and before it wrote the first file.
    if known is None and any(not path.name.startswith(PARTIAL) for path in folder.iterdir()):
        raise FileExistsError(f"{folder}: expected the folder of an earlier run; move it, or choose another output")
    for path in (folder, *folder.rglob("*")):
        remove_partial_files(path)
    if known is not None and known != source:
        for path in folder.iterdir():
            if path.name != SOURCE:  # it goes last, so that a killed deletion can be repeated
                shutil.rmtree(path) if path.is_dir() else path.unlink()
    if known != source:
        write_sealed(folder / SOURCE, source)
    return folder
