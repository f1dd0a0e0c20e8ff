"""Recordings for batches, and their results."""

import pytest
from deadly_batches import CONFIG, OPTIONS, TESTS, contents
from folder_files import write_scans

import torchjoint as tj
from torchjoint.results.figures import overview


@pytest.fixture(scope="module")
def scans(scene_of, tmp_path_factory):
    return write_scans(tmp_path_factory.mktemp("scans") / "scans", scene_of(2))


@pytest.fixture(scope="module")
def expected(scans, tmp_path_factory):
    """The files of each scene after a run that nothing disturbs; the scenes are copies."""
    out = tmp_path_factory.mktemp("expected")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TORCHJOINT_TEST_DEATHS", str(out))
        patch.syspath_prepend(TESTS)
        patch.setattr("torchjoint.results.folder.overview", overview)  # as the workers have it
        tj.recordings.segment_recording(scans / "a", out / "a", CONFIG, OPTIONS)
    return dict.fromkeys("abc", contents(out / "a"))
