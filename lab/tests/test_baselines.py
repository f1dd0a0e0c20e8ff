"""Other methods' outputs as segmentations; hostile ones are refused."""

import os
import pickle
import struct
import zlib

import numpy as np
import pytest
import torch
from damage import CLEAR, damages
from scipy.io import savemat
from sis3d_files import VOXEL, boxes_of, world_to_grid, write_detections
from torchjoint_lab.datasets.vertex_numbers import read_vertex_instances
from torchjoint_lab.datasets.voxels import read_world_to_scene
from torchjoint_lab.evaluation.baselines.pickled_arrays import read_pickled_arrays
from torchjoint_lab.evaluation.baselines.scannet_benchmark import read_instance_masks
from torchjoint_lab.evaluation.baselines.scenecut import find_region_map, read_region_map
from torchjoint_lab.evaluation.baselines.sis3d import detection_labels, read_detections

from torchjoint.datasets.files.mat_files import read_matrices

#: Voxels of the scene are metres divided by VOXEL.
TO_VOXELS = torch.diag(torch.tensor([1 / VOXEL, 1 / VOXEL, 1 / VOXEL, 1], dtype=torch.float64))


def labels_at(folder, voxels):
    return detection_labels(read_detections(folder), torch.tensor(voxels) * VOXEL, TO_VOXELS).tolist()


class TestDetections:
    """3D-SIS."""

    def test_the_most_confident_wins_then_the_first(self, tmp_path):
        boxes = [[0, 0, 0, 3, 1, 1], [1, 0, 0, 4, 1, 1], [2, 0, 0, 5, 1, 1]]
        masks = [np.ones((3, 1, 1), dtype=np.float32)] * 3
        voxels = [[i, 0, 0] for i in range(-1, 6)]
        write_detections(tmp_path / "a", boxes, [3, 4, 5], [0.6, 0.9, 0.7], masks)
        assert labels_at(tmp_path / "a", voxels) == [-1, 0, 1, 1, 1, 2, -1]
        write_detections(tmp_path / "b", boxes, [3, 4, 5], [0.8, 0.8, 0.8], masks)
        assert labels_at(tmp_path / "b", voxels) == [-1, 0, 0, 0, 1, 2, -1]

    def test_masks_are_of_the_kept_boxes_and_background_is_nothing(self, tmp_path):
        boxes = [[0, 0, 0, 9, 9, 9], [0.4, 0, 0, 2.4, 1, 1], [2, 0, 0, 3, 1, 1], [0, 0, 0, 3, 1, 1]]
        masks = [np.ones((2, 1, 1)), np.ones((1, 1, 1)), np.ones((3, 1, 1))]
        write_detections(tmp_path / "a", boxes, [7, 7, 0, 4], [0.2, 0.8, 0.9, 0.7], masks, [False, True, True, True])
        detections = read_detections(tmp_path / "a")
        assert detections.corners.tolist() == [[0, 0, 0], [0, 0, 0]]
        assert detections.scores.tolist() == [0.8, 0.7]
        assert detections.classes.tolist() == [7, 4]
        assert labels_at(tmp_path / "a", [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]]) == [0, 0, 1, -1]

    def test_only_the_mask_s_voxels_count(self, tmp_path):
        mask = np.zeros((2, 2, 2), dtype=np.float32)
        mask[0, 1, 1] = 1
        write_detections(tmp_path / "a", [[5, 6, 7, 7, 8, 9]], [3], [0.9], [mask])
        assert labels_at(tmp_path / "a", [[5, 7, 8], [5, 6, 7], [6, 7, 8]]) == [0, -1, -1]
        assert labels_at(tmp_path / "a", [[5.4, 7.4, 7.6], [5.6, 7, 8]]) == [0, -1]

    def test_a_scene_s_objects_are_found_again(self, tmp_path, scene_of):
        synthetic = scene_of(4, num_views=2)
        points, labels = synthetic.scene.points, synthetic.point_labels
        objects = labels.bincount().argsort(descending=True)[:6].tolist()
        boxes, masks = boxes_of(points, labels, objects)
        write_detections(tmp_path / "a", boxes, [3] * 6, [0.9] * 6, masks)
        np.savetxt(tmp_path / "world2grid.txt", world_to_grid(points), fmt="%.9f")
        found = detection_labels(
            read_detections(tmp_path / "a"), points, read_world_to_scene(tmp_path / "world2grid.txt")
        )
        expected = torch.full_like(labels, -1)
        for k, one in enumerate(objects):
            expected[labels == one] = k
        assert (found == expected).float().mean() > 0.9  # voxels on borders have points of two
        assert ((found >= 0) | (expected < 0)).all()

    def test_nothing_detected(self, tmp_path):
        write_detections(tmp_path / "a", [], [], [], [])
        assert labels_at(tmp_path / "a", [[0, 0, 0]]) == [-1]

    @pytest.mark.parametrize("protocol", [2, 3, 4, 5])
    def test_protocols(self, tmp_path, protocol):
        mask = np.asfortranarray(np.arange(6).reshape(1, 2, 3) % 2)
        write_detections(tmp_path / "a", [[0, 0, 0, 1, 2, 3]], [3], [0.9], [mask], protocol=protocol)
        assert read_detections(tmp_path / "a").masks[0].tolist() == (mask != 0).tolist()

    def test_chosen_boxes_may_be_an_array(self, tmp_path):
        write_detections(
            tmp_path / "a", [[0, 0, 0, 1, 1, 1]] * 2, [3, 3], [0.9, 0.1], [np.ones((1, 1, 1))], np.array([True, False])
        )
        assert len(read_detections(tmp_path / "a").masks) == 1

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"masks": []}, "pred_mask: expected 1 masks"),
            ({"masks": [np.ones((1, 1, 2))]}, r"pred_mask: expected mask 0 to have its box's size \[1, 1, 1\], got"),
            ({"masks": [3]}, r"pred_mask: expected mask 0 to have its box's size"),
            ({"kept": [True, True]}, "pred_mask_index: expected 1 bools"),
            ({"kept": [1]}, "pred_mask_index: expected 1 bools"),
            ({"scores": [0.9, 0.9]}, r"pred_conf\.npy: expected 1 numbers, one for each box, got shape \[2\]"),
            ({"scores": [np.nan]}, r"pred_conf\.npy: expected 1 numbers"),
            ({"classes": []}, r"pred_class\.npy: expected 1 numbers"),
            ({"boxes": [[0, 0, 0, 1, 1, np.nan]]}, r"pred_box\.npy: expected boxes in voxels"),
            ({"boxes": [[0, 0, 0, 1, 1, 1e20]]}, r"pred_box\.npy: expected boxes in voxels"),
        ],
    )
    def test_files_that_do_not_fit(self, tmp_path, change, message):
        result = {"boxes": [[0, 0, 0, 1, 1, 1]], "classes": [3], "scores": [0.9], "masks": [np.ones((1, 1, 1))]}
        write_detections(tmp_path / "a", **(result | change))
        with pytest.raises(ValueError, match=message):
            read_detections(tmp_path / "a")

    @pytest.mark.parametrize(
        "name", ["pred_box.npy", "pred_class.npy", "pred_conf.npy", "pred_mask", "pred_mask_index"]
    )
    def test_a_missing_file(self, tmp_path, name):
        write_detections(tmp_path / "a", [[0, 0, 0, 1, 1, 1]], [3], [0.9], [np.ones((1, 1, 1))])
        (tmp_path / "a" / name).unlink()
        with pytest.raises(FileNotFoundError, match=f"{name}: missing"):
            read_detections(tmp_path / "a")


class Malicious:
    """Runs a command when it is unpickled."""

    def __init__(self, call, *arguments):
        self.reduced = (call, arguments)

    def __reduce__(self):
        return self.reduced


class TestPickles:
    """Whatever a pickle asks for, nothing is run."""

    @pytest.mark.parametrize("protocol", range(6))
    def test_a_command_is_refused_and_not_run(self, tmp_path, protocol):
        marker = tmp_path / "was_here"
        (tmp_path / "evil").write_bytes(pickle.dumps([Malicious(os.system, f"touch {marker}")], protocol))
        with pytest.raises(ValueError, match="evil: not a pickle of arrays and numbers alone"):
            read_pickled_arrays(tmp_path / "evil")
        assert not marker.exists()
        pickle.loads((tmp_path / "evil").read_bytes())
        assert marker.exists()  # and it would have been

    @pytest.mark.parametrize(
        "thing",
        [
            Malicious(eval, "1"),
            Malicious(getattr, "x", "join"),
            Malicious(np.load, "/etc/passwd", None, True),
            Malicious(np.ndarray, (2**40,)),
            np.array([None, 1], dtype=object),
            np.zeros(2, dtype="S5"),
            np.zeros(2, dtype=[("a", "f4")]),
            np.zeros(2, dtype="datetime64[s]"),
            np.zeros(2, dtype="c16"),
            np.ma.zeros(2),
            {"a": 1},
            {1, 2},
            "text",
            [[np.zeros(2)]],
            None,
            np.float64,
        ],
        ids=lambda thing: type(thing).__name__,
    )
    def test_what_else_is_refused(self, tmp_path, thing):
        (tmp_path / "p").write_bytes(pickle.dumps([thing], 4))
        with pytest.raises(ValueError, match="p: not a pickle of arrays and numbers alone"):
            read_pickled_arrays(tmp_path / "p")

    def test_a_list_in_itself(self, tmp_path):
        loop = []
        loop.append(loop)
        (tmp_path / "p").write_bytes(pickle.dumps(loop))
        with pytest.raises(ValueError, match="an item of type list"):
            read_pickled_arrays(tmp_path / "p")

    @pytest.mark.parametrize(
        "data",
        [
            b"\x80\x04\x8e\xff\xff\xff\xff\xff\xff\xff\x7f.",  # bytes beyond the file
            b"\x80\x05\x96\x00\x00\x00\x00\xff\x00\x00\x00.",
            b"\x80\x04\x8b\xff\xff\xff\x7f\x00.",
            b"",
            b".",
            b"\x80\x04e.",
            b"\x80\x04)R.",
        ],
        ids=repr,
    )
    def test_what_claims_more_than_it_has(self, tmp_path, data):
        (tmp_path / "p").write_bytes(data)
        with pytest.raises(ValueError, match="p: not a pickle of arrays and numbers alone"):
            read_pickled_arrays(tmp_path / "p")

    def test_tuples_that_hold_each_other(self, tmp_path):
        """Each holds the one before twice: 2 ** 60 items, if anybody looked at all of them."""
        doubled = b")\x94" + b"".join(b"h" + bytes([i]) + b"h" + bytes([i]) + b"\x86\x94" for i in range(60))
        call = b"cnumpy\ndtype\n" + b"h" + bytes([60]) + b"\x85R."
        (tmp_path / "p").write_bytes(b"\x80\x04" + doubled + call)
        with pytest.raises(ValueError, match="an array of type tuple"):
            read_pickled_arrays(tmp_path / "p")
        shape = b"h" + bytes([60]) + b"\x85" + b"K\x01\x86R."
        (tmp_path / "p").write_bytes(b"\x80\x04" + doubled + b"cnumpy.core.multiarray\nscalar\n" + shape)
        with pytest.raises(ValueError, match="a tuple in the place of a type"):
            read_pickled_arrays(tmp_path / "p")

    def test_a_memo_of_any_number(self, tmp_path):
        (tmp_path / "p").write_bytes(b"\x80\x04]r\xff\xff\xff\x7f.")  # 16 GB, were the memo an array
        assert read_pickled_arrays(tmp_path / "p") == []

    def test_an_array_larger_than_its_data(self, tmp_path):
        data = pickle.dumps(np.zeros((3, 5), dtype=np.int8), 4)
        place = data.index(b"K\x03K\x05")
        (tmp_path / "p").write_bytes(data[:place] + b"K\xffK\xff" + data[place + 4 :])
        with pytest.raises(ValueError, match="an array of 65025 numbers of int8, with other data"):
            read_pickled_arrays(tmp_path / "p")


class TestRegionMaps:
    """SceneCut."""

    VALUES = np.array([[0, 7, 7], [3, 3, 0], [12, 7, 3]])
    LABELS = ((-1, 1, 1), (0, 0, -1), (2, 1, 0))

    @pytest.mark.parametrize("dtype", ["u1", "i4", "f8"])
    @pytest.mark.parametrize("compressed", [False, True])
    def test_a_mat_file(self, tmp_path, dtype, compressed):
        content = {"seg": self.VALUES.astype(dtype), "info": "by hand", "times": np.zeros((2, 2, 2))}
        savemat(tmp_path / "20.mat", content, do_compression=compressed)
        assert torch.equal(read_region_map(tmp_path / "20.mat"), torch.tensor(self.LABELS))

    @pytest.mark.parametrize("dtype", [np.uint16, np.int64, np.float32, np.uint64])
    def test_a_npy_file(self, tmp_path, dtype):
        np.save(tmp_path / "20.npy", self.VALUES.astype(dtype))
        assert torch.equal(read_region_map(tmp_path / "20.npy"), torch.tensor(self.LABELS))

    def test_by_the_frame_s_name(self, tmp_path):
        np.save(tmp_path / "20.npy", self.VALUES)
        assert find_region_map(tmp_path, "20") == tmp_path / "20.npy"
        with pytest.raises(FileNotFoundError, match=r"40\.mat: missing, and so is 40\.npy"):
            find_region_map(tmp_path, "40")
        savemat(tmp_path / "20.mat", {"seg": self.VALUES})
        with pytest.raises(ValueError, match=r"holds both 20\.mat and 20\.npy"):
            find_region_map(tmp_path, "20")

    @pytest.mark.parametrize(
        ("content", "message"),
        [
            ({"a": VALUES, "b": VALUES}, "expected one matrix of numbers, got a, b"),
            ({"a": np.zeros((2, 2, 2))}, "expected one matrix of numbers, got none"),
            ({"a": np.array([[np.nan, 1]])}, "expected finite numbers of shape"),
            ({"a": np.array([[1j, 1]])}, "expected one matrix of numbers, got none"),
            ({"a": np.zeros((0, 3))}, "expected finite numbers of shape"),
            ({"a": {"b": 3}}, "expected one matrix of numbers, got none"),
        ],
    )
    def test_other_content(self, tmp_path, content, message):
        savemat(tmp_path / "a.mat", content)
        with pytest.raises(ValueError, match=rf"a\.mat: .*{message}"):
            read_region_map(tmp_path / "a.mat")

    def test_every_type_of_numbers(self, tmp_path):
        for dtype in ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8", "?"):
            values = (self.VALUES % 5).astype(dtype)
            savemat(tmp_path / "a.mat", {"seg": values}, do_compression=True)
            assert np.array_equal(read_matrices(tmp_path / "a.mat", 9)["seg"], values)

    def test_other_byte_order(self, tmp_path):
        element = lambda kind, data: struct.pack(">2I", kind, len(data)) + data + bytes(-len(data) % 8)  # noqa: E731
        body = element(6, struct.pack(">2I", 11, 0)) + element(5, struct.pack(">2i", 3, 3))
        body += struct.pack(">2H", 3, 1) + b"seg\0" + element(4, self.VALUES.astype(">u2").tobytes(order="F"))
        header = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI"
        (tmp_path / "a.mat").write_bytes(header + struct.pack(">2I", 14, len(body)) + body)
        assert torch.equal(read_region_map(tmp_path / "a.mat"), torch.tensor(self.LABELS))

    def test_what_is_no_mat_file(self, tmp_path):
        savemat(tmp_path / "old.mat", {"seg": self.VALUES.astype(float)}, format="4")
        old = (tmp_path / "old.mat").read_bytes()
        for data in (b"", b"x" * 50, b"MATLAB 7.3 MAT-file" + b" " * 105 + b"\x00\x02IM" + bytes(100), old):
            (tmp_path / "a.mat").write_bytes(data)
            with pytest.raises(ValueError, match=r"a\.mat: not a \.mat file of versions 5 to 7"):
                read_region_map(tmp_path / "a.mat")
        with pytest.raises(FileNotFoundError, match=r"b\.mat: missing"):
            read_region_map(tmp_path / "b.mat")

    def test_a_few_bytes_that_unpack_to_gigabytes(self, tmp_path):
        """A matrix of 3 x 3 with 4 GB of numbers: no more is unpacked than its size needs."""
        savemat(tmp_path / "a.mat", {"seg": self.VALUES})
        whole = (tmp_path / "a.mat").read_bytes()
        pack = zlib.compressobj(9)
        packed = pack.compress(whole[128 : 128 + 48] + struct.pack("<2I", 9, 2**32 - 8))
        packed += b"".join(pack.compress(bytes(2**20)) for _ in range(200)) + pack.flush()
        (tmp_path / "a.mat").write_bytes(whole[:128] + struct.pack("<2I", 15, len(packed)) + packed)
        with pytest.raises(ValueError, match=r"a\.mat: .*truncated: 4294967288 bytes of numbers are announced, 72 are"):
            read_region_map(tmp_path / "a.mat")

    def test_a_matrix_larger_than_any_image(self, tmp_path):
        savemat(tmp_path / "a.mat", {"seg": self.VALUES})
        data = bytearray((tmp_path / "a.mat").read_bytes())
        struct.pack_into("<2i", data, 128 + 8 + 16 + 8, 2**14, 2**14)
        (tmp_path / "a.mat").write_bytes(data)
        with pytest.raises(ValueError, match=r"seg of \(16384, 16384\) numbers: 204435456 more than expected"):
            read_region_map(tmp_path / "a.mat")


class TestBenchmark:
    """ScanNet's text files."""

    def write(self, folder, lines, **masks):
        (folder / "predicted_masks").mkdir(exist_ok=True)
        for name, mask in masks.items():
            (folder / "predicted_masks" / f"{name}.txt").write_text("".join(f"{value}\n" for value in mask))
        (folder / "scene0011_00.txt").write_text("\n".join(lines) + "\n")
        return folder / "scene0011_00.txt"

    def test_masks_come_back(self, tmp_path):
        lines = ["predicted_masks/a.txt 5 0.75", "", "predicted_masks/b.txt 39 0.5"]
        found = read_instance_masks(self.write(tmp_path, lines, a=[0, 1, 1, 0], b=[0, 0, 7, 1]), 4)
        assert found.masks.tolist() == [[False, True, True, False], [False, False, True, True]]
        assert found.scores.tolist() == [0.75, 0.5]
        assert found.classes.tolist() == [5, 39]

    def test_no_instance(self, tmp_path):
        found = read_instance_masks(self.write(tmp_path, []), 4)
        assert found.masks.shape == (0, 4)
        assert found.scores.shape == (0,)

    @pytest.mark.parametrize(
        "path", ["../secret.txt", "{root}/secret.txt", "link/secret.txt", "predicted_masks/../../secret.txt"]
    )
    def test_paths_that_lead_elsewhere(self, tmp_path, path):
        (tmp_path / "secret.txt").write_text("1\n1\n")
        inside = tmp_path / "inside"
        inside.mkdir()
        (inside / "link").symlink_to(tmp_path)
        file = self.write(inside, [f"{path.format(root=tmp_path)} 5 0.5"])
        with pytest.raises(ValueError, match="line 1: expected a file inside"):
            read_instance_masks(file, 2)

    @pytest.mark.parametrize(
        ("line", "message"),
        [
            ("predicted_masks/a.txt 5", "line 1: expected a path, a class and a confidence"),
            ("predicted_masks/a.txt five 0.5", "line 1: expected a path, a class and a confidence"),
            ("predicted_masks/a.txt 5 nan", "line 1: expected a path, a class and a confidence"),
            ("predicted_masks/a.txt 5 0.5 1", "line 1: expected a path, a class and a confidence"),
            ("predicted_masks/c.txt 5 0.5", r"c\.txt: missing"),
            ("predicted_masks/b.txt 5 0.5", r"b\.txt: expected 4 numbers, one for each vertex, got 2"),
            ("predicted_masks/d.txt 5 0.5", r"d\.txt: expected integers"),
            ("predicted_masks/e.txt 5 0.5", r"e\.txt: expected integers"),
            (
                "predicted_masks/a.txt 5 0.5\npredicted_masks/../predicted_masks/a.txt 3 0.1",
                r"line 2: a\.txt comes twice",
            ),
        ],
    )
    def test_lines_of_another_form(self, tmp_path, line, message):
        masks = {"a": [0, 1, 1, 0], "b": [1, 1], "d": [0, "x", 1, 1], "e": [0, 10**30, 1, 1]}
        file = self.write(tmp_path, line.split("\n"), **masks)
        with pytest.raises((ValueError, FileNotFoundError), match=message):
            read_instance_masks(file, 4)

    def test_ground_truth(self, tmp_path):
        (tmp_path / "gt.txt").write_text("0\n5001\n39012\n2\n")
        assert read_vertex_instances(tmp_path / "gt.txt", 4).tolist() == [-1, 5001, 39012, 2]
        (tmp_path / "gt.txt").write_text("0\n-5\n")
        with pytest.raises(ValueError, match=r"gt\.txt: expected class \* 1000 \+ instance, got -5"):
            read_vertex_instances(tmp_path / "gt.txt", 2)


def write_everything(folder):
    """A small output of every baseline; how to read each."""
    masks = [np.ones((1, 2, 1), dtype=np.float32), np.arange(8, dtype=np.float32).reshape(2, 2, 2) % 2]
    write_detections(folder / "sis3d", [[0, 0, 0, 1, 2, 1], [1, 1, 1, 3, 3, 3]], [3, 4], [0.9, 0.8], masks)
    values = np.arange(48).reshape(6, 8) // 10
    savemat(folder / "packed.mat", {"seg": values}, do_compression=True)
    savemat(folder / "plain.mat", {"seg": values.astype(np.uint8)})
    np.save(folder / "map.npy", values.astype(np.uint16))
    (folder / "masks").mkdir()
    (folder / "masks" / "a.txt").write_text("0\n1\n1\n0\n")
    (folder / "bench.txt").write_text("masks/a.txt 5 0.5\n")
    (folder / "gt.txt").write_text("0\n5001\n5001\n0\n")
    points = torch.rand(10, 3)
    return {
        "sis3d": lambda path: detection_labels(read_detections(path), points, TO_VOXELS),
        "packed.mat": read_region_map,
        "plain.mat": read_region_map,
        "map.npy": read_region_map,
        "bench.txt": lambda path: read_instance_masks(path, 4),
        "gt.txt": lambda path: read_vertex_instances(path, 4),
    }


def test_damaged_outputs_give_clear_errors(tmp_path):
    (tmp_path / "all").mkdir()
    readers = write_everything(tmp_path / "all")
    for _ in damages(tmp_path / "all", 30):
        for name, read in readers.items():
            try:
                read(tmp_path / "all" / name)
            except CLEAR as error:
                assert len(str(error)) > 10  # noqa: PT017 (what else comes out fails the test)
    for name, read in readers.items():
        assert read(tmp_path / "all" / name) is not None
