"""What users call by name: the public names, written down so that none goes by accident, and those in documents."""

import importlib
import re
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from torchjoint.cli import main

ROOT = Path(__file__).parents[1]
DOCUMENTS = ["README.md", *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md"))]

#: Pages for developers, too: their examples may have names that do not exist, but their files must.
PAGES = [*DOCUMENTS, "CONTRIBUTING.md", "SECURITY.md", "benchmarks/README.md", "lab/README.md", "lab/studies/README.md"]

PUBLIC = {
    "torchjoint": """
        BatchReport Cloud Config Frame Hierarchy JointSegmenter LabelImages LiveResult LiveSegmenter Masks PoseWarning
        RecordingOptions Result
        Scene Segmentation Superpoints SuperpointsConfig SyntheticScene Truth batch datasets load_result load_scene
        masks metrics ops superpoints synthetic transforms
    """,
    "torchjoint.config": """
        DETECTORS BoundaryConfig Config ContoursConfig ImageGraphConfig ImageSegmentsConfig PaperConfig
        PointGraphConfig PointSegmentsConfig PropagationConfig RefinementConfig ScanConfig SuperpointsConfig
        VisibilityConfig evidence_config evidence_differences marked_parameters marked_table parameter_table presets
        read_assignment read_preset read_yaml superpoint_table
    """,
    "torchjoint.engine": "Engine EngineLike Outcome SharedFile WorkerDied open_engine",
    "torchjoint.recordings": "BatchReport RecordingOptions batch find_recordings segment_recording",
    "torchjoint.scene": "Cloud Frame Hierarchy LabelImages Masks Scene Segmentation Truth",
    "torchjoint.masks": """
        Masks from_coco from_instances from_labels from_module from_panoptic from_sam from_stack read_folder read_masks
        save_masks
    """,
    "torchjoint.ops": """
        connected_components felzenszwalb fit_normals merge_regions min_cut
        nearest_neighbors neighbor_edges project propagate_labels region_dendrogram splat_depth ultrametric_contours
    """,
    "torchjoint.metrics": """
        AveragePrecision ObjectsAndParts ScannetAveragePrecisionMetric SegmentationCovering
        achievable_segmentation_accuracy average_precision_objects average_precision_parts boundary_recall
        mean_best_iou objects_and_parts scannet_average_precision segmentation_covering undersegmentation_error
    """,
    "torchjoint.datasets": "fuse_cloud list_scenes load_cloud load_scene",
    "torchjoint.synthetic": "SyntheticScene make_scene",
    "torchjoint.transforms": "AddSuperpoints transfer_labels",
}


@pytest.mark.parametrize("name", PUBLIC)
def test_the_public_names(name):
    """Taking one away breaks programs of users: say so in the changelog before this list is changed."""
    module = importlib.import_module(name)
    assert sorted(module.__all__) == sorted(PUBLIC[name].split())
    for public in module.__all__:
        assert getattr(module, public) is not None


def test_the_command_is_an_entry_point():
    (command,) = entry_points(group="console_scripts", name="torchjoint")
    assert command.value == "torchjoint.cli:main"
    assert command.load() is main


def test_the_reference_has_every_public_module():
    text = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    assert set(PUBLIC) - set(re.findall(r"(?m)^    (torchjoint\S*)$", text)) == set()


def resolved(name):
    """Whether a dotted name is that of a module, or of what can be reached from one by attributes."""
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        try:
            thing = importlib.import_module(".".join(parts[:length]))
        except ModuleNotFoundError as error:
            if not ".".join(parts[:length]).startswith(str(error.name)):
                raise
            continue
        for part in parts[length:]:
            if not hasattr(thing, part):
                return False
            thing = getattr(thing, part)
        return True
    return False


def names_in(text):
    """Every `tj.a.b` and `torchjoint.a.b`; paths, file names and what is still to be filled in are none."""
    found = re.findall(r"(?<![\w./-])(?:tj|torchjoint)((?:\.[A-Za-z_]\w*)+)(?![\w/]|\.\w)", text)
    return {f"torchjoint{name}" for name in found}


def test_names_are_told_from_what_is_none():
    text = "`tj.ops.min_cut` of torchjoint.ops, see torchjoint/joint.py. import torchjoint.egg-info/PKG my.tj.x"
    assert names_in(text) == {"torchjoint.ops.min_cut", "torchjoint.ops", "torchjoint.egg"}
    assert resolved("torchjoint.ops.min_cut")
    assert not resolved("torchjoint.ops.max_cut")
    assert not resolved("torchjoint.nothing.min_cut")


@pytest.mark.parametrize("document", DOCUMENTS)
def test_names_in_documents_exist(document):
    names = names_in((ROOT / document).read_text(encoding="utf-8"))
    assert sorted(name for name in names if not resolved(name)) == []


@pytest.mark.parametrize("document", DOCUMENTS)
def test_imports_in_documents_work(document):
    text = (ROOT / document).read_text(encoding="utf-8")
    for module, names in re.findall(r"^from (torchjoint[\w.]*) import ([\w, ]+)", text, flags=re.MULTILINE):
        for name in names.split(","):
            assert resolved(f"{module}.{name.strip()}"), f"from {module} import {name.strip()}"


@pytest.mark.parametrize("document", PAGES)
def test_files_in_documents_exist(document):
    """Links, from the document's folder; and paths in the text, from the checkout's or the package's."""
    text = (ROOT / document).read_text(encoding="utf-8")
    folder = (ROOT / document).parent
    links = re.findall(r"\]\((?!https?:)([^)#\s]+)(?:#[^)]*)?\)", text)
    assert sorted({link for link in links if not (folder / link).exists()}) == []
    paths = set(re.findall(r"`((?:\w+/)+\w+\.(?:py|cpp|h|yaml|md))`", text))
    paths = {path for path in paths if "NAME" not in path}  # which stands for any
    missing = [path for path in paths if not any((base / path).exists() for base in (ROOT, ROOT / "torchjoint"))]
    assert sorted(missing) == []
