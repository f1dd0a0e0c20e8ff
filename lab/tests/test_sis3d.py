"""3D-SIS' example scenes: where their parts are, their cameras, volumes, and the truth by voxels."""

import struct

import numpy as np
import pytest
import samples
import sis3d_sample
import torch
from damage import CLEAR, damages
from scannet_files import (
    shots_of,
    write_exported,
    write_image_truth,
    write_info,
    write_mesh,
    write_point_truth,
    write_sens,
)
from sis3d_files import VOXEL, boxes_of, scene_voxels, world_to_grid, write_volume
from torchjoint_lab.datasets import sis3d
from torchjoint_lab.datasets.scenes import list_scenes, load_scene
from torchjoint_lab.datasets.sis3d_volume import read_volume
from torchjoint_lab.datasets.voxels import label_voxels, read_world_to_scene, voxels_of

import torchjoint as tj

SCAN = "scene0144_00"


@pytest.fixture(scope="module")
def synthetic(scene_of):
    return scene_of(4, num_views=2)


@pytest.fixture
def root(tmp_path, synthetic):
    return write_example(tmp_path / "data", synthetic)


def write_example(root, synthetic):
    """Frames, mesh, calibration, and the five largest objects in a volume."""
    scene, labels = synthetic.scene, synthetic.point_labels.numpy()
    frames, mesh = root / "images_square" / SCAN, root / "scans" / SCAN
    write_exported(frames, shots_of(scene), step=20)
    np.savetxt(frames / "world2grid.txt", world_to_grid(scene.points), fmt="%.9f")
    mesh.mkdir(parents=True)
    write_mesh(mesh / f"{SCAN}_vh_clean_2.ply", scene.points, (scene.colors * 255).round())
    intrinsics = scene.frames[0].intrinsics.tolist()
    write_info(mesh / f"{SCAN}.txt", intrinsics, intrinsics, (120, 160), (120, 160))
    (root / "scenes").mkdir()
    objects = np.argsort(-np.bincount(labels))[:5]
    boxes, masks = boxes_of(scene.points, labels, objects)
    dims = scene_voxels(scene.points).max(0) + 7
    masks[0][0, 0, 0] = max(2, masks[0][0, 0, 0])  # 2: of the complete object only
    write_volume(root / "scenes" / f"{SCAN}__0__.scene", dims, boxes, [5] * 5, masks, np.eye(4))
    return root


@pytest.mark.parametrize("path", [f"images_square/{SCAN}", f"scans/{SCAN}", "."])
def test_a_scene_by_any_of_its_paths(root, synthetic, path):
    scene = load_scene(root / path)
    assert scene.name == SCAN
    torch.testing.assert_close(scene.points, synthetic.scene.points)
    assert [frame.name for frame in scene.frames] == ["0", "20"]
    for got, expected in zip(scene.frames, synthetic.scene.frames, strict=True):
        torch.testing.assert_close(got.intrinsics, expected.intrinsics)
        torch.testing.assert_close(got.world_to_camera, expected.world_to_camera, atol=2e-5, rtol=0)
        torch.testing.assert_close(got.depth, expected.depth, atol=0.0006, rtol=0)


def test_a_scan_with_frames_of_its_own_is_scannet_s(root, synthetic):
    mesh = root / "scans" / SCAN
    assert sis3d.recognizes(mesh)
    intrinsics = synthetic.scene.frames[0].intrinsics
    write_sens(mesh / f"{SCAN}.sens", shots_of(synthetic.scene), intrinsics, intrinsics)
    assert not sis3d.recognizes(mesh)
    assert [frame.name for frame in load_scene(mesh).frames] == ["0", "1"]
    assert sis3d.find_folders(mesh).images == root / "images_square" / SCAN  # whose voxels these still are


def test_several_scenes_are_listed(root):
    other = root / "images_square" / "scene0378_00"
    (other / "color").mkdir(parents=True)
    (other / "pose").mkdir()
    (other / "world2grid.txt").write_text("")
    (root / "images_square" / "notes").mkdir()
    assert list(list_scenes(root)) == [SCAN, "scene0378_00"]
    assert list(list_scenes(root / "images_square")) == [SCAN, "scene0378_00"]


def test_a_folder_with_scans_of_both_kinds(root, synthetic):
    own = root / "scans" / "scene0011_00"
    own.mkdir()
    intrinsics = synthetic.scene.frames[0].intrinsics
    write_sens(own / "scene0011_00.sens", shots_of(synthetic.scene), intrinsics, intrinsics)
    found = list_scenes(root / "scans")
    assert list(found) == ["scene0011_00", SCAN]
    assert [[frame.name for frame in load_scene(path).frames] for path in found.values()] == [["0", "1"], ["0", "20"]]


def test_what_the_package_reads_is_read_by_the_lab(tmp_path):
    path = samples.write("tum", tmp_path / "tum")
    assert list_scenes(path) == tj.datasets.list_scenes(path)
    assert torch.equal(load_scene(path, progress=False).points, tj.load_scene(path, progress=False).points)


def test_a_folder_without_scenes(tmp_path):
    with pytest.raises(ValueError, match="is of no known format"):
        list_scenes(tmp_path)
    with pytest.raises(FileNotFoundError, match="does not exist"):
        list_scenes(tmp_path / "nowhere")


def test_the_truth_by_voxels(root, synthetic):
    """A point is the object that its voxel is of; where voxels have points of several objects, the first box's."""
    truth = load_scene(root).truth.points.numpy()
    labels, voxels = synthetic.point_labels.numpy(), scene_voxels(synthetic.scene.points)
    objects = np.argsort(-np.bincount(labels))[:5]
    in_voxel = {tuple(voxel): set() for voxel in voxels}
    for voxel, label in zip(voxels, labels, strict=True):
        in_voxel[tuple(voxel)].add(label)
    expected = [next((k for k, one in enumerate(objects) if one in in_voxel[tuple(voxel)]), -1) for voxel in voxels]
    lowest = voxels[labels == objects[0]].min(0)
    same = (voxels != lowest).any(1)  # the voxel that is not of the surface
    np.testing.assert_array_equal(truth[same], np.array(expected)[same])
    assert len(np.unique(truth)) == 6


def test_the_mesh_s_own_annotation_comes_first(root, synthetic):
    (root / "gt_insts").mkdir()
    numbers = [0 if label == 0 else 5000 + label for label in synthetic.point_labels.tolist()]
    (root / "gt_insts" / f"{SCAN}.txt").write_text("\n".join(map(str, numbers)) + "\n")
    truth = load_scene(root).truth.points
    assert torch.equal(truth, torch.tensor([number or -1 for number in numbers]))
    write_point_truth(root / "scans" / SCAN, SCAN, synthetic.point_labels)
    assert torch.equal(load_scene(root).truth.points, synthetic.point_labels)
    cloud = root / "scans" / SCAN / f"{SCAN}_vh_clean_2.ply"
    cloud.rename(cloud.with_suffix(".PLY"))  # which is found, too
    assert torch.equal(load_scene(root).truth.points, synthetic.point_labels)
    (root / "gt_insts" / f"{SCAN}.txt").write_text("1\n2\n")
    (root / "scans" / SCAN / f"{SCAN}.aggregation.json").unlink()
    with pytest.raises(
        ValueError, match=r"gt_insts/scene0144_00\.txt: expected 3000 numbers, one for each vertex, got 2"
    ):
        load_scene(root)


def test_pixels_have_a_truth_where_scannet_s_is_beside_them(root, synthetic):
    write_image_truth(root / "scans" / SCAN, synthetic.image_labels, step=20)
    images = load_scene(root).truth.images
    assert torch.equal(images[1], synthetic.image_labels[1])


def test_without_volume_and_annotation_there_is_no_truth(root):
    (root / "scenes" / f"{SCAN}__0__.scene").unlink()
    assert load_scene(root).truth is None


def test_the_camera_that_3d_sis_takes():
    """Its configuration for images of 41 x 32: 37.01983, 38.52470, 20, 15.5."""
    intrinsics = sis3d.NOMINAL.depth.scaled_to((32, 41))
    expected = torch.tensor([[37.01983, 0, 20], [0, 38.52470, 15.5], [0, 0, 1]]).double()
    torch.testing.assert_close(intrinsics, expected, atol=1e-5, rtol=0)


def test_without_calibration_the_nominal_camera_is_taken(root):
    (root / "scans" / SCAN / f"{SCAN}.txt").unlink()
    intrinsics = load_scene(root).frames[0].intrinsics
    assert intrinsics.tolist() == [[577.870605 / 4, 0, 79.5], [0, 577.870605 / 4, 59.5], [0, 0, 1]]


class TestVoxels:
    """From metres to voxels."""

    def test_the_padding_is_taken_off(self, tmp_path):
        # One metre along world's x, y, z is 1 / 0.046875 voxels along the grid's x, -z, y.
        scale = 1 / VOXEL
        rows = [[scale, 0, 0, 16], [0, 0, scale, 16], [0, -scale, 0, 16], [0, 0, 0, 1]]
        (tmp_path / "world2grid.txt").write_text("\n".join(" ".join(map(str, row)) + " " for row in rows))
        matrix = read_world_to_scene(tmp_path / "world2grid.txt")
        points = torch.tensor([[0.0, 0, 0], [10 * VOXEL, 0, 0], [0, -2.4 * VOXEL, 3.6 * VOXEL]])
        assert voxels_of(points, matrix).tolist() == [[6, 0, 6], [16, 0, 6], [6, 4, 8]]

    @pytest.mark.parametrize("row", ["0 0 0 nan", "0 0 0 0", "1 0 0 1"])
    def test_what_is_no_transform(self, tmp_path, row):
        (tmp_path / "world2grid.txt").write_text(f"1 0 0 0\n0 1 0 0\n0 0 1 0\n{row}")
        with pytest.raises(ValueError, match=r"world2grid\.txt: expected an affine transform"):
            read_world_to_scene(tmp_path / "world2grid.txt")

    def test_the_last_of_several_masks(self):
        voxels = torch.tensor([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [1, 1, 0], [-1, 0, 0], [2**31, 0, 0]])
        corners = torch.tensor([[0, 0, 0], [1, 0, 0]])
        masks = [torch.ones(2, 1, 1, dtype=torch.bool), torch.tensor([True, False, True])[:, None, None]]
        assert label_voxels(voxels, corners, masks, [0, 1]).tolist() == [0, 1, -1, 1, -1, -1, -1]
        assert label_voxels(voxels, corners, masks, [1, 0]).tolist() == [0, 0, -1, 1, -1, -1, -1]


class TestVolume:
    """The binary file."""

    @pytest.fixture
    def file(self, tmp_path):
        masks = [np.arange(6).reshape(1, 2, 3) % 3, np.ones((2, 2, 2))]
        boxes = [[1.5, 0, 2.25, 2, 2, 5], [0, 1, 2, 2, 3, 4]]
        matrix = np.diag([VOXEL, VOXEL, VOXEL, 1])
        matrix[:3, 3] = 1, 2, 3
        sdf = np.arange(60).reshape(3, 4, 5)
        write_volume(tmp_path / "a.chunk", (3, 4, 5), boxes, [5, 39], masks, matrix, [20, 400], sdf)
        return tmp_path / "a.chunk"

    def test_it_comes_back(self, file):
        volume = read_volume(file)
        assert volume.sdf.shape == (3, 4, 5)
        assert volume.sdf.tolist() == np.arange(60).reshape(3, 4, 5).tolist()
        assert volume.boxes.tolist() == [[1.5, 0, 2.25, 2, 2, 5], [0, 1, 2, 2, 3, 4]]
        assert volume.corners.tolist() == [[1, 0, 2], [0, 1, 2]]
        assert volume.classes.tolist() == [5, 39]
        assert volume.masks[0].tolist() == (np.arange(6).reshape(1, 2, 3) % 3).tolist()
        assert volume.masks[1].shape == (2, 2, 2)
        assert volume.inside.tolist() == [1, 1]
        assert volume.frame_ids.tolist() == [20, 400]

    def test_its_matrix_leads_from_voxels_to_the_world(self, file):
        volume = read_volume(file)
        assert volume.voxels_to_world[:3, 3].tolist() == [1, 2, 3]
        place = torch.linalg.inv(volume.voxels_to_world) @ torch.tensor([1 + 2 * VOXEL, 2, 3, 1]).double()
        torch.testing.assert_close(place, torch.tensor([2.0, 0, 0, 1]).double())

    def test_the_first_bytes_are_x_fastest(self, file):
        data = file.read_bytes()
        assert struct.unpack("<3Q3f", data[:36]) == (3, 4, 5, 0, 20, 40)

    @pytest.mark.parametrize(
        ("place", "layout", "values"),
        [
            (0, "Q", [2**40]),
            (0, "3Q", [2**63, 0, 5]),
            (0, "3Q", [2**32, 2**32, 2**32]),
            (24 + 240, "I", [2**32 - 1]),
            (24 + 240 + 4 + 56, "I", [3]),
            (24 + 240 + 4 + 56 + 4, "I3Q", [5, 2**21, 2**21, 2**22]),
            (24 + 240 + 4, "f", [float("nan")]),
            (24 + 240 + 4, "f", [1e30]),
        ],
    )
    def test_counts_are_checked_against_the_file(self, file, place, layout, values):
        data = bytearray(file.read_bytes())
        struct.pack_into("<" + layout, data, place, *values)
        file.write_bytes(data)
        with pytest.raises(ValueError, match=r"a\.chunk: (truncated|expected)"):
            read_volume(file)

    def test_every_truncation_is_noticed(self, file):
        whole = file.read_bytes()
        for length in range(1, len(whole), 7):
            file.write_bytes(whole[:length])
            with pytest.raises(ValueError, match=r"a\.chunk: truncated"):
                read_volume(file)

    def test_no_such_file(self, tmp_path):
        with pytest.raises(FileNotFoundError, match=r"b\.chunk: missing"):
            read_volume(tmp_path / "b.chunk")


class TestDamagedFiles:
    """Only clear errors come out."""

    @pytest.fixture
    def path(self, tmp_path):
        return sis3d_sample.write(tmp_path)

    def read(self, path):
        """Everything that a scene has; None after a clear error."""
        try:
            scene = load_scene(path)
            shapes = [frame.image.shape for frame in scene.frames]
            return shapes, None if scene.truth is None else scene.truth.points
        except CLEAR as error:
            message = str(error)
        assert len(message) > 10, message
        return None

    def test_bytes_are_cut_and_flipped(self, tmp_path, path):
        shapes, truth = self.read(path)
        assert shapes == [(3, 12, 16)] * 2
        assert truth.unique().tolist() == [-1, 0, 1]
        for _ in damages(tmp_path, 8):
            self.read(path)
        assert torch.equal(self.read(path)[1], truth)

    @pytest.mark.filterwarnings("ignore:depth")
    def test_files_are_missing(self, tmp_path, path):
        for file in sorted(file for file in tmp_path.rglob("*") if file.is_file()):
            whole = file.read_bytes()
            file.unlink()
            self.read(path)
            file.write_bytes(whole)
        assert self.read(path) is not None
