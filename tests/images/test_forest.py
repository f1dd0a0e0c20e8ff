"""The forest's file, and its training: features as OpenCV computes them, patches, trees, and the whole of it."""

from __future__ import annotations

import dataclasses
import gzip
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from torchjoint_lab.datasets.bsds import BsdsImage, bsds_images
from torchjoint_lab.training import TrainingOptions, TreeOptions, train, train_boundaries
from torchjoint_lab.training.channels import image_channels, rgb_to_luv, triangle_filter
from torchjoint_lab.training.detect import detect
from torchjoint_lab.training.features import (
    NUM_PAIRS,
    NUM_REGULAR,
    feature_channels,
    feature_values,
    regular_values,
    similarity_values,
    sites,
)
from torchjoint_lab.training.forest_file import write_forest
from torchjoint_lab.training.patches import (
    FeatureCodes,
    Samples,
    draw_samples,
    segmentation_boundaries,
    segmentation_lines,
)
from torchjoint_lab.training.tree import grow_tree

from torchjoint.images import forest as forest_file
from torchjoint.images.forest import NUM_FEATURES, Forest, padded, read_forest
from torchjoint.runtime.outputs import work_folder

SMALL = TrainingOptions(
    trees=3, trees_per_site=2, samples=3000, feature_share=0.05, tree=TreeOptions(features_tried=20, node_samples=500)
)


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> list[BsdsImage]:
    return bsds_images(write_bsds(tmp_path_factory.mktemp("bsds")), "train")


@pytest.fixture(scope="module")
def trained(data, tmp_path_factory) -> Path:
    file = tmp_path_factory.mktemp("forest") / "small.yml.gz"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(train, "ProcessPoolExecutor", Threads)
        train_boundaries(data, file, SMALL)
    return file


class Threads(ThreadPoolExecutor):
    """In the place of processes, which take seconds to start."""

    def __init__(self, workers, mp_context):
        super().__init__(workers)


def write_bsds(folder: Path, count: int = 4, split: str = "train") -> Path:
    """Images of discs of one colour on another, with noise, each segmented by two people."""
    from scipy.io import savemat

    rng = np.random.default_rng(0)
    (folder / "images" / split).mkdir(parents=True)
    (folder / "groundTruth" / split).mkdir(parents=True)
    for index in range(count):
        rows, columns = np.mgrid[:75, :101]
        segments = np.ones(rows.shape, np.uint16)
        for disc in range(2):
            center, radius = rng.uniform(20, (55, 81)), rng.uniform(12, 24)
            segments[np.hypot(rows - center[0], columns - center[1]) < radius] = 2 + disc
        image = rng.uniform(0, 255, (4, 3))[segments] + rng.normal(0, 8, (*rows.shape, 3))
        cv2.imwrite(str(folder / "images" / split / f"{index}.jpg"), image.clip(0, 255).astype(np.uint8))
        one = {"Segmentation": segments, "Boundaries": segmentation_lines(segments).astype(np.uint8)}
        truth = np.empty((1, 2), object)
        truth[0, 0] = truth[0, 1] = one
        savemat(folder / "groundTruth" / split / f"{index}.mat", {"groundTruth": truth})
    return folder


def random_image(height: int, width: int, seed: int = 0) -> NDArray[np.float32]:
    """Blobs of many sizes."""
    rng = np.random.default_rng(seed)
    image = np.zeros((height, width, 3))
    for sigma in (1, 4, 12):
        image += cv2.GaussianBlur(rng.normal(size=image.shape), (0, 0), sigma) * sigma
    return (image / 8 + 0.5).clip(0, 1).astype(np.float32)


class TestFeatures:
    @pytest.mark.parametrize(
        "size", [(80, 96), (81, 97), (83, 61), (97, 60), (98, 61), (64, 95), (40, 39), (21, 20), (10, 9), (1, 1)]
    )
    def test_evaluation_is_opencvs(self, trained, size):
        """Whatever the size: OpenCV halves odd ones in ways of its own."""
        image = random_image(*size)
        expected = cv2.ximgproc.createStructuredEdgeDetection(str(trained)).detectEdges(image)
        np.testing.assert_allclose(detect(read_forest(trained), image), expected, atol=1e-6)

    def test_evaluation_is_opencvs_on_a_photograph(self, trained, shared):
        image = bsds_images(shared / "data" / "bsds500", "train")[0].image.permute(1, 2, 0).contiguous().numpy()
        expected = cv2.ximgproc.createStructuredEdgeDetection(str(trained)).detectEdges(image)
        assert expected.max() > 0.01
        # Among 37,000 patches a few features lie within the last bit of a threshold, and patches go the other way.
        assert (np.abs(detect(read_forest(trained), image) - expected) > 1e-6).mean() < 0.005

    def test_every_feature_is_opencvs(self, tmp_path):
        """A forest that asks for nothing but one feature, of each kind, at its median."""
        image = random_image(60, 70)
        channels = image_channels(image)
        for feature in (0, 700, *range(37, NUM_REGULAR, 271), *range(NUM_REGULAR + 29, NUM_FEATURES, 311)):
            values = _values(channels, feature)
            forest = _stump(feature, float(np.median(values)) + 1e-5)
            write_forest(tmp_path / "stump.yml.gz", forest)
            detector = cv2.ximgproc.createStructuredEdgeDetection(str(tmp_path / "stump.yml.gz"))
            np.testing.assert_allclose(detect(forest, image), detector.detectEdges(image), atol=1e-6)

    def test_grey_has_the_u_and_v_of_white(self):
        luv = rgb_to_luv(np.full((2, 2, 3), 0.5, np.float32))
        np.testing.assert_allclose(luv[0, 0], [(116 * np.cbrt(0.5) - 16) / 270, 88 / 270, 134 / 270], atol=1e-3)

    def test_triangle_filter_by_hand(self):
        line = np.zeros((1, 9), np.float32)
        line[0, 4] = 1
        np.testing.assert_allclose(triangle_filter(line, 1)[0, 3:6], [0.25, 0.5, 0.25], atol=1e-6)
        np.testing.assert_allclose(triangle_filter(line, 2)[0, 2:7], np.array([1, 2, 3, 2, 1]) / 9, atol=1e-6)

    def test_numbers_of_features_by_hand(self):
        channels = image_channels(random_image(50, 40))
        row, column = 3, 2
        at = (np.array([row]), np.array([column]))
        feature = 5 * 256 + 7 * 16 + 9  # channel 5, column 7, row 9
        assert regular_values(channels.regular, *at, np.array([feature])) == channels.regular[5, row + 9, column + 7]
        feature = (
            NUM_REGULAR + 4 * NUM_PAIRS + 24 + 3
        )  # channel 4, cells 1 = (row 4, column 1) and 5 = (row 1, column 4)
        expected = channels.similarity[4, row + 4, column + 1] - channels.similarity[4, row + 1, column + 4]
        assert similarity_values(channels.similarity, *at, np.array([feature])) == expected
        assert feature_channels(np.array([5 * 256, feature])).tolist() == [5, 13 + 4]


class TestForestFile:
    def test_it_comes_back(self, tmp_path, trained):
        forest = read_forest(trained)
        write_forest(tmp_path / "again.yml.gz", forest)
        assert (tmp_path / "again.yml.gz").read_bytes() == trained.read_bytes()
        again = read_forest(tmp_path / "again.yml.gz")
        for spec in dataclasses.fields(Forest):
            np.testing.assert_array_equal(getattr(again, spec.name), getattr(forest, spec.name))
        assert [file.name for file in tmp_path.iterdir()] == ["again.yml.gz"]

    def test_a_file_written_by_opencv(self, tmp_path, trained):
        """Other writers break lines elsewhere and write 1. for 1.0."""
        text = gzip.decompress(trained.read_bytes()).decode()
        text = text.replace(", ", ",\n       ").replace(" 0,", " 0.,")
        (tmp_path / "other.yml").write_text(text)
        np.testing.assert_array_equal(read_forest(tmp_path / "other.yml").thresholds, read_forest(trained).thresholds)

    def test_missing(self, tmp_path):
        with pytest.raises(FileNotFoundError, match=r"none\.yml\.gz: missing"):
            read_forest(tmp_path / "none.yml.gz")

    @pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.99])
    def test_cut_off(self, tmp_path, trained, share):
        raw = trained.read_bytes()
        plain = gzip.decompress(raw)
        for name, whole in (("cut.yml.gz", raw), ("cut.yml", plain)):
            (tmp_path / name).write_bytes(whole[: int(share * len(whole))])
            with pytest.raises(ValueError, match=f"{name}: not a"):
                read_forest(tmp_path / name)

    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            ("%YAML:1.0", "%PDF", "%YAML"),
            ("patchSize: 32", "patchSize: 16", "patchSize: expected 32, got 16"),
            ("stride: 2", "steps: 2", "stride: expected 2, got nothing"),
            ("thresholds:", "limits:", "expected the entries"),
            ("numberOfTrees: 3", "numberOfTrees: 7", "children"),
            ("numberOfTrees: 3", "numberOfTrees: 0", "0 trees"),
            ("numberOfTreesToEvaluate: 2", "numberOfTreesToEvaluate: 4", "trees_per_site: expected 1 to 3, got 4"),
            ("childs:\n   - [ 2", "childs:\n   - [ 1", "children"),
            ("childs:\n   - [ 2", "childs:\n   - [ 99999999", "children"),
            ("childs:\n   - [ 2", "childs:\n   - [ x", "not a structured forest"),
            ("featureIds:\n   - [ ", "featureIds:\n   - [ 9", "not a structured forest"),
            ("edgeBoundaries:\n   - [ 0", "edgeBoundaries:\n   - [ 1", "edgeBoundaries"),
            ("edgeBins:\n   - [ ", "edgeBins:\n   - [ 256, ", "not a structured forest"),
            ("edgeBins:\n   - [ ", "edgeBins:\n   - [ 1, ", "counts of"),
        ],
    )
    def test_foreign(self, tmp_path, trained, old, new, message):
        text = gzip.decompress(trained.read_bytes()).decode()
        assert old in text
        (tmp_path / "foreign.yml").write_text(text.replace(old, new, 1))
        with pytest.raises(ValueError, match=r"foreign\.yml: not a structured forest") as error:
            read_forest(tmp_path / "foreign.yml")
        assert message in str(error.value)

    @settings(max_examples=60)
    @given(st.data())
    def test_flipped_bytes(self, trained, tmp_path_factory, data):
        """Never a crash, and never another forest taken for whole without a trace."""
        raw = bytearray(trained.read_bytes())
        place = data.draw(st.integers(0, len(raw) - 1))
        raw[place] ^= data.draw(st.integers(1, 255))
        file = tmp_path_factory.getbasetemp() / "flipped.yml.gz"
        file.write_bytes(raw)
        try:
            forest = read_forest(file)
        except ValueError as error:
            if str(file) not in str(error):
                raise
        else:  # the header's time, flags or system differ, or a code of the packing that no byte uses
            whole = read_forest(trained)
            for name in ("children", "features", "thresholds", "boundary_counts", "boundary_pixels"):
                np.testing.assert_array_equal(getattr(forest, name), getattr(whole, name))
            assert forest.trees_per_site == whole.trees_per_site


class TestPatches:
    def test_boundaries_by_hand(self):
        segments = np.array([[1, 1, 2, 2], [1, 1, 2, 2], [3, 3, 3, 3]])
        assert segmentation_lines(segments).astype(int).tolist() == [[0, 1, 0, 0], [1, 1, 1, 1], [0, 0, 0, 0]]
        assert segmentation_boundaries(segments).astype(int).tolist() == [[0, 1, 1, 0], [1, 1, 1, 1], [1, 1, 1, 1]]

    def test_samples(self, data):
        rng = np.random.default_rng(0)
        codes = FeatureCodes.of_images(data, rng)
        features = np.sort(rng.choice(NUM_FEATURES, 300, replace=False))
        samples = draw_samples(data, codes, features, 2000, rng)
        count = samples.codes.shape[1]
        assert 1600 < count <= 2000
        assert samples.codes.shape[0] == 300
        assert samples.segments.shape == (count, 256)
        with_boundary = (samples.segments != samples.segments[:, :1]).any(axis=1)
        assert 0.4 < with_boundary.mean() < 0.9

    def test_codes_tell_on_which_side_of_a_threshold_a_value_is(self, data):
        rng = np.random.default_rng(0)
        codes = FeatureCodes.of_images(data, rng)
        channels = image_channels(padded(random_image(60, 70)))
        rows, columns = sites(channels)
        features = np.sort(rng.choice(NUM_FEATURES, 200, replace=False))
        found = codes.of_sites(channels, rows, columns, features)
        for row, feature in enumerate(features):
            for code in (10, 128, 250):
                threshold = codes.thresholds(np.array([feature]), np.array([code]))[0]
                left = _values(channels, feature) < threshold
                # Differences are coded by a table: those that are all but at the threshold may be on either side.
                assert (left == (found[row] <= code)).mean() > 0.99


class TestTree:
    def test_it_finds_the_feature_that_parts_the_patches(self):
        """Half the patches are cut across and half down; feature 1 tells which."""
        rng = np.random.default_rng(0)
        is_across = np.arange(400) % 2 == 0
        across = np.repeat(np.arange(16) >= 8, 16)
        down = np.tile(np.arange(16) >= 8, 16)
        segments = np.where(is_across[:, None], across, down).astype(np.uint16)
        codes = rng.integers(0, 256, (3, 400)).astype(np.uint8)
        codes[1] = np.where(is_across, rng.integers(0, 100, 400), rng.integers(120, 256, 400))
        samples = Samples(codes, segments)
        tree = grow_tree(samples, rng, TreeOptions(features_tried=3))
        assert tree.children.tolist() == [2, 0, 0]
        assert tree.features[0] == 1
        assert codes[1][is_across].max() <= tree.codes[0] < codes[1][~is_across].min()
        assert {leaf.tobytes() for leaf in tree.segments} == {one.astype(np.uint16).tobytes() for one in (across, down)}

    def test_limits(self):
        rng = np.random.default_rng(0)
        segments = (rng.random((500, 256)) < 0.5).astype(np.uint16)
        samples = Samples(rng.integers(0, 256, (40, 500)).astype(np.uint8), segments)
        settled = []
        tree = grow_tree(samples, rng, TreeOptions(min_child=20, features_tried=10), settled.append)
        assert sum(settled) == 500
        assert min(settled) >= 20
        assert len(settled) == (tree.children == 0).sum() == len(tree.segments)
        assert len(grow_tree(samples, rng, TreeOptions(max_depth=1, features_tried=10)).children) == 3
        alike = Samples(samples.codes, np.zeros_like(segments))
        assert len(grow_tree(alike, rng, TreeOptions()).children) == 1


class TestTraining:
    def test_it_learns_discs(self, data, trained):
        """Boundaries of a new image are stronger than what is not a boundary."""
        detector = cv2.ximgproc.createStructuredEdgeDetection(str(trained))
        rows, columns = np.mgrid[:90, :90]
        disc = (np.hypot(rows - 45, columns - 45) < 25).astype(np.int64)
        image = np.array([[0.2, 0.5, 0.7], [0.8, 0.3, 0.2]], np.float32)[disc]
        strength = detector.detectEdges(image)
        near = cv2.dilate(segmentation_lines(disc).astype(np.uint8), np.ones((3, 3))) > 0
        assert strength[near].mean() > 5 * strength[cv2.dilate(near.astype(np.uint8), np.ones((9, 9))) == 0].mean()

    @pytest.mark.slow
    def test_same_seed_same_file_and_a_stopped_training_goes_on(self, data, trained, tmp_path, monkeypatch):
        def stopped(*_args):
            raise KeyboardInterrupt

        monkeypatch.setattr(train, "_forest", stopped)
        monkeypatch.setattr(train, "ProcessPoolExecutor", Threads)
        with pytest.raises(KeyboardInterrupt):
            train_boundaries(data, tmp_path / "again.yml.gz", SMALL, workers=1)
        trees = sorted((tmp_path / "again.yml.gz.trees").glob("*.npz"))
        assert len(trees) == 3
        trees[1].unlink()
        kept = trees[0].stat().st_mtime_ns
        monkeypatch.undo()
        seen = []

        def load(path):
            seen.append(path.stat().st_mtime_ns)
            return original(path)

        original = train._load_tree
        monkeypatch.setattr(train, "_load_tree", load)
        train_boundaries(data, tmp_path / "again.yml.gz", SMALL, workers=1)  # in a process, as everywhere but here
        assert seen[0] == kept
        assert (tmp_path / "again.yml.gz").read_bytes() == trained.read_bytes()
        assert [file.name for file in tmp_path.iterdir()] == ["again.yml.gz"]

    @pytest.mark.slow
    def test_another_seed_makes_another_forest(self, data, trained, tmp_path, monkeypatch):
        monkeypatch.setattr(train, "ProcessPoolExecutor", Threads)
        work_folder(tmp_path / "other.yml.gz.trees", "of an earlier training")
        (tmp_path / "other.yml.gz.trees" / "tree-00.npz").write_text("which is not this one")
        train_boundaries(data, tmp_path / "other.yml.gz", dataclasses.replace(SMALL, trees=2, seed=1), workers=1)
        assert not np.array_equal(read_forest(tmp_path / "other.yml.gz").features[0], read_forest(trained).features[0])

    def test_errors(self, data, tmp_path):
        with pytest.raises(ValueError, match=r"images: expected at least one"):
            train_boundaries([], tmp_path / "a.yml.gz")
        with pytest.raises(ValueError, match=r"out: expected a name that ends in \.yml\.gz"):
            train_boundaries(data, tmp_path / "a.npz")
        (tmp_path / "b.yml.gz.trees").mkdir()
        (tmp_path / "b.yml.gz.trees" / "mine.txt").write_text("precious")
        with pytest.raises(FileExistsError, match=r"b\.yml\.gz\.trees: expected the folder of an earlier run"):
            train_boundaries(data, tmp_path / "b.yml.gz")
        for options in ({"trees": 0}, {"trees_per_site": 9}, {"samples": 1.5}, {"feature_share": 0}, {"seed": -1}):
            with pytest.raises(ValueError, match=f"{next(iter(options))}: expected"):
                TrainingOptions(**options)


def _values(channels, feature: int) -> NDArray[np.float32]:
    rows, columns = sites(channels)
    return feature_values(channels, rows, columns, np.full(len(rows), feature))


def _stump(feature: int, threshold: float) -> Forest:
    """Votes for the middle of patches whose feature is less."""
    return Forest(
        np.array([[2, 0, 0]], np.int32),
        np.array([[feature, 0, 0]], np.int32),
        np.array([[threshold, 0, 0]], np.float32),
        np.array([[0, 1, 0]], np.int32),
        np.array([8 * 16 + 8], np.uint8),
        1,
    )


@pytest.mark.parametrize("packed", [True, False])
def test_a_file_that_is_too_large_is_not_read_to_its_end(tmp_path, monkeypatch, packed):
    """A gzip bomb of 1.5 MB holds 1.5 GB."""
    monkeypatch.setattr(forest_file, "MAX_TEXT", 10_000)
    file = tmp_path / "forest.yml.gz"
    file.write_bytes(gzip.compress(b"%YAML" + bytes(20_000)) if packed else b"%YAML" + bytes(20_000))
    with pytest.raises(ValueError, match=r"forest\.yml\.gz: expected a .* forest, at most 10000 bytes, got more"):
        read_forest(file)


def test_lists_that_are_nested_too_deeply(tmp_path):
    file = tmp_path / "forest.yml"
    entries = "".join(f"{name}:\n   - {'[' * 100_000}\n" for name in ("childs", "featureIds", "thresholds"))
    rest = "edgeBoundaries:\n   - [ 0 ]\nedgeBins:\n   - [ 0 ]\n"
    options = "".join(f"   {name}: {value}\n" for name, value in forest_file.OPTIONS.items())
    file.write_text(f"%YAML:1.0\n---\noptions:\n{options}{entries}{rest}")
    with pytest.raises(ValueError, match=r"forest\.yml: not a structured forest"):
        read_forest(file)
