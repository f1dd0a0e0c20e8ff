"""The folder in which an interrupted training keeps its finished parts."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path


def resumable_folder(folder: Path, record: str) -> Path:
    """Makes the folder of one training, or finds it again; what another training left there is deleted.

    Args:
        folder: made where it does not exist.
        record: all on which the training depends: two trainings with one record continue each other.

    Raises:
        FileExistsError: there is a folder of that name that no training made.
    """
    key = hashlib.sha256(record.encode()).hexdigest()
    key_file = folder / "key"
    if folder.exists() and not key_file.is_file():
        raise FileExistsError(f"{folder}: is in the way and not of an earlier training; move it, or choose another OUT")
    if folder.exists() and key_file.read_text() != key:
        shutil.rmtree(folder)
    folder.mkdir(exist_ok=True)
    key_file.write_text(key)
    return folder
