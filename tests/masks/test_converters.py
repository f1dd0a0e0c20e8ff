"""Converters, on structures made by hand in the forms of networks: the right masks and scores, and named damage."""

from __future__ import annotations

import json
import re
import zipfile
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from PIL import Image
from torchjoint_lab.synthetic import with_network_masks

import torchjoint as tj

#: Two masks that overlap, of 3 x 4 pixels.
STACK = torch.tensor(
    [
        [[1, 1, 0, 0], [1, 1, 0, 0], [0, 0, 0, 0]],
        [[0, 1, 1, 0], [0, 1, 1, 0], [0, 0, 0, 0]],
    ],
    dtype=torch.bool,
)
#: Their run lengths, column by column.
COUNTS = [[0, 2, 1, 2, 7], [3, 2, 1, 2, 4]]
LABELS = torch.tensor([[0, 0, 5, 5], [0, 0, 5, 5], [-1, -1, -1, 9]])


def assert_equal(masks, stack, scores):
    assert torch.equal(masks.stack(), stack)
    assert masks.scores.tolist() == pytest.approx(scores)


def sam_records():
    return [
        {
            "segmentation": STACK[i].numpy(),
            "area": 4,
            "bbox": [0, 0, 1, 1],
            "predicted_iou": [0.9, 1.04][i],
            "point_coords": [[1.0, 1.0]],
            "stability_score": [0.95, 0.99][i],
            "crop_box": [0, 0, 4, 3],
        }
        for i in range(2)
    ]


class TestLabelsAndStacks:
    def test_label_maps(self):
        masks = tj.masks.from_labels(LABELS.numpy(), scores=[0.5, 0.6, 0.7])
        assert_equal(masks, torch.stack([value == LABELS for value in (0, 5, 9)]), [0.5, 0.6, 0.7])
        zero_is_none = tj.masks.from_labels((LABELS + 1).numpy().astype(np.uint16), none=0)
        assert torch.equal(zero_is_none.stack(), masks.stack())

    @pytest.mark.parametrize("dtype", [np.bool_, np.uint8, np.float32])
    def test_stacks(self, dtype):
        assert_equal(tj.masks.from_stack(STACK.numpy().astype(dtype), np.array([0.2, 1.0])), STACK, [0.2, 1.0])

    def test_stacks_of_0_and_255(self):
        assert_equal(tj.masks.from_stack(STACK.to(torch.uint8) * 255), STACK, [1, 1])

    @pytest.mark.parametrize(
        ("stack", "message"),
        [
            (STACK * 4.0 - 2, "expected booleans, or numbers 0 and 1, got torch.float32 from -2 to 2; use `> 0`"),
            (STACK * torch.nan, "stack: expected booleans"),
            (STACK[0], r"stack: expected shape \[M, H, W\], got \[3, 4\]"),
            (STACK.tolist(), "stack: expected a torch.Tensor or a NumPy array, got list"),
            (STACK.to_sparse(), "stack: expected a dense tensor of real numbers, got torch.sparse_coo, torch.bool"),
            (np.array(["a"]), "stack: expected numbers or booleans, got dtype <U1"),
        ],
    )
    def test_damaged_stacks_are_named(self, stack, message):
        with pytest.raises((ValueError, TypeError), match=message):
            tj.masks.from_stack(stack)

    @pytest.mark.parametrize(
        ("scores", "message"),
        [
            ([0.5, float("nan")], "stack' scores: expected"),
            ([0.5, 1.5], r"stack' scores: expected numbers in \[0, 1\], got 0.5 to 1.5"),
            ([0.5], r"stack' scores: expected"),
        ],
    )
    def test_damaged_scores_are_named(self, scores, message):
        with pytest.raises(ValueError, match=message):
            tj.masks.from_stack(STACK, scores)

    def test_a_name_for_each_mask(self):
        for names, told in ((["cup"], "one for each of 2 masks, got 1"), ({0: "cup", 1: "pan"}, "a string for each")):
            with pytest.raises((TypeError, ValueError), match=f"names: expected {told}"):
                tj.masks.from_stack(STACK, None, names)


class TestSam:
    def test_arrays(self):
        """The score is predicted_iou x stability_score, clipped: SAM predicts more than 1 now and then."""
        assert_equal(tj.masks.from_sam(sam_records()), STACK, [0.9 * 0.95, 1.0])

    def test_run_lengths(self):
        records = [
            record | {"segmentation": {"size": [3, 4], "counts": COUNTS[i]}} for i, record in enumerate(sam_records())
        ]
        assert_equal(tj.masks.from_sam(records, size=(3, 4)), STACK, [0.9 * 0.95, 1.0])

    def test_class_names(self):
        """As Grounded SAM and Semantic Segment Anything write them; the former with a score of its own."""
        first, second = sam_records()
        assert tj.masks.from_sam([first | {"class_name": "cup"}, second | {"class_name": None}]).names == ("cup", "")
        scored = [
            {"segmentation": one["segmentation"], "score": score} for one, score in ((first, [0.7]), (second, 0.5))
        ]
        assert_equal(tj.masks.from_sam(scored), STACK, [0.7, 0.5])
        assert tj.masks.from_sam([first, second]).names == ()

    def test_no_masks_need_a_size(self):
        assert tj.masks.from_sam([], size=(3, 4)).size == (3, 4)
        with pytest.raises(ValueError, match=r"size: expected \(H, W\), because records has no masks"):
            tj.masks.from_sam([])

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"area": 5}, r"records\[1\]'s area: expected the mask's 4 pixels, got 5"),
            ({"area": float("nan")}, r"records\[1\]'s area: expected the mask's 4 pixels, got nan"),
            ({"bbox": [9, 9, 2, 2]}, r"records\[1\]'s segmentation: expected a mask in its bbox, x y \[9.0, 9.0\]"),
            ({"predicted_iou": float("nan")}, r"records\[1\]'s predicted_iou: expected a finite number, got nan"),
            ({"stability_score": "high"}, r"records\[1\]'s stability_score: expected a number, got 'high'"),
            ({"segmentation": STACK[1, :2].numpy()}, r"records\[1\]: expected the size \[3, 4\], got \[2, 4\]"),
            ({"segmentation": STACK.numpy()}, r"records\[1\]'s segmentation: expected shape \[H, W\], got \[2, 3, 4\]"),
            ({"segmentation": STACK[1] * 0.3}, r"records\[1\]'s segmentation: expected booleans"),
            (
                {"segmentation": {"size": [3, 4], "counts": [3, 2]}},
                r"records\[1\]'s segmentation's counts: expected a sum of 3 x 4 = 12 pixels, got 5",
            ),
        ],
    )
    def test_damage_is_named(self, change, message):
        first, second = sam_records()
        with pytest.raises((ValueError, TypeError), match=message):
            tj.masks.from_sam([first, {**second, "area": None, **change}])

    def test_other_things_are_named(self):
        with pytest.raises(TypeError, match="records: expected a list of dicts, got dict"):
            tj.masks.from_sam(sam_records()[0])
        with pytest.raises(ValueError, match=r"records\[0\]: expected a dict with segmentation, got .*mask"):
            tj.masks.from_sam([{"mask": STACK[0]}])
        with pytest.raises(ValueError, match=r"segmentation: expected 5 x 4 pixels, got 3 x 4"):
            tj.masks.from_sam(sam_records(), size=(5, 4))


class TestCoco:
    def test_polygons_and_run_lengths(self):
        annotations = [
            {"segmentation": [[0, 0, 2, 0, 2, 2, 0, 2]], "category_id": 3},
            {"segmentation": {"size": [3, 4], "counts": COUNTS[1]}, "score": 0.25},
        ]
        assert_equal(tj.masks.from_coco(annotations, (3, 4)), STACK, [1, 0.25])

    def test_a_mask_of_several_polygons(self):
        corners = [[0, 0, 1, 0, 1, 1, 0, 1], [3, 2, 4, 2, 4, 3, 3, 3]]
        stack = tj.masks.from_coco([{"segmentation": corners}], (3, 4)).stack()
        assert stack[0].nonzero().tolist() == [[0, 0], [2, 3]]

    def test_groups_of_things_are_left_out(self):
        group, thing = (
            {"segmentation": {"size": [3, 4], "counts": COUNTS[i]}, "iscrowd": 1 - i, "id": i} for i in (0, 1)
        )
        with pytest.warns(UserWarning, match=r"annotations: 1 of 2 masks are groups of things \(iscrowd: 1\)"):
            masks = tj.masks.from_coco([group, thing], (3, 4))
        assert_equal(masks, STACK[1:], [1])
        assert masks.ids == (1,)
        with pytest.warns(UserWarning, match=r"annotations: ids that are no integers are not kept"):
            assert tj.masks.from_coco([thing | {"id": "cup"}], (3, 4)).ids == ()

    @pytest.mark.parametrize(
        ("segmentation", "message"),
        [
            ([[0, 0, 2, 0]], "segmentation: expected polygons x, y, x, y, ... of at least 3 finite corners"),
            ([[0, 0, 2, 0, 2, float("nan")]], "of at least 3 finite corners"),
            ([["a"] * 6], "expected polygons x, y, x, y, ... of numbers"),
            ({"size": [4, 3], "counts": [12]}, "segmentation: expected 3 x 4 pixels, got 4 x 3"),
        ],
    )
    def test_damage_is_named(self, segmentation, message):
        with pytest.raises((ValueError, TypeError), match=rf"annotations\[0\]'s {message}|{message}"):
            tj.masks.from_coco([{"segmentation": segmentation}], (3, 4))


class TestPanoptic:
    def test_only_listed_segments_are_masks(self):
        infos = [{"id": 5, "score": 0.5, "label_id": 2}, {"id": 9, "category_id": 1, "class_name": "cup"}]
        assert tj.masks.from_panoptic(LABELS, infos).names == ("", "cup")
        assert_equal(tj.masks.from_panoptic(LABELS, infos), torch.stack([LABELS == 5, LABELS == 9]), [0.5, 1])
        assert len(tj.masks.from_panoptic(LABELS, [])) == 0
        with pytest.warns(UserWarning, match="segmentation: 2 of 3 ids are not in it, such as 6"):
            assert len(tj.masks.from_panoptic(LABELS, [{"id": 6}, {"id": 5}, {"id": 7}])) == 3

    def test_damage_is_named(self):
        with pytest.raises(ValueError, match=r"segments_info: expected each id once, got \[5, 5\]"):
            tj.masks.from_panoptic(LABELS, [{"id": 5}, {"id": 5}])
        with pytest.raises(ValueError, match=r"segments_info\[0\]: expected a dict with id, an integer, got .*'P0'"):
            tj.masks.from_panoptic(LABELS, [{"id": "P0"}])
        with pytest.raises(TypeError, match=r"segmentation: expected an integer dtype, got torch\.float32"):
            tj.masks.from_panoptic(LABELS.float(), [{"id": 5}])


class TestInstances:
    @pytest.mark.parametrize("dtype", [torch.bool, torch.float32])
    def test_instances_of_detectron2(self, dtype):
        instances = SimpleNamespace(pred_masks=STACK.to(dtype), scores=torch.tensor([0.9, 0.3]), pred_classes=[0, 1])
        assert_equal(tj.masks.from_instances(instances), STACK, [0.9, 0.3])
        assert_equal(tj.masks.from_instances({"instances": instances}, min_score=0.5), STACK[:1], [0.9])

    def test_damage_is_named(self):
        with pytest.raises(TypeError, match="instances: expected pred_masks and scores, got dict without pred_masks"):
            tj.masks.from_instances({"masks": STACK})
        with pytest.raises(ValueError, match="min_score: expected 0 to 1, got 50"):
            tj.masks.from_instances({"pred_masks": STACK}, min_score=50)
        with pytest.raises(ValueError, match="pred_masks' scores"):
            tj.masks.from_instances({"pred_masks": STACK, "scores": torch.tensor([0.9, torch.nan])}, min_score=0.5)


class TestModule:
    IMAGES = torch.zeros(2, 3, 3, 4)

    @pytest.mark.parametrize(
        ("output", "scores"),
        [
            (tj.masks.from_stack(STACK, [0.5, 0.6]), [0.5, 0.6]),
            (STACK, [1, 1]),
            ((STACK, torch.tensor([0.5, 0.6])), [0.5, 0.6]),
            (sam_records(), [0.9 * 0.95, 1.0]),
            ({"instances": SimpleNamespace(pred_masks=STACK, scores=torch.tensor([0.5, 0.6]))}, [0.5, 0.6]),
            (SimpleNamespace(pred_masks=STACK, scores=torch.tensor([0.5, 0.6])), [0.5, 0.6]),
        ],
    )
    def test_each_form_of_output(self, output, scores):
        network = tj.masks.from_module(lambda images: [output] * len(images))
        found = network(self.IMAGES)
        assert len(found) == 2
        for masks in found:
            assert_equal(masks, STACK, scores)

    def test_a_batch_of_label_maps(self):
        found = tj.masks.from_module(lambda images: torch.stack([LABELS + 1, LABELS + 1]), none=0)(self.IMAGES)
        assert [len(masks) for masks in found] == [3, 3]

    def test_segments_of_hugging_face(self):
        output = {"segmentation": LABELS, "segments_info": [{"id": 9, "score": 0.5}]}
        assert_equal(tj.masks.from_module(lambda _: [output] * 2)(self.IMAGES)[1], (LABELS == 9)[None], [0.5])

    def test_generators_of_sam_take_one_array(self):
        def generate(image):
            assert image.shape == (3, 4, 3)
            assert image.dtype == np.uint8
            return sam_records()[: 1 if image[0, 0, 0] == 255 else 2]

        images = torch.stack([torch.ones(3, 3, 4), torch.zeros(3, 3, 4)])
        assert [len(masks) for masks in tj.masks.from_module(generate, images="array")(images)] == [1, 2]

    def test_a_segmenter_takes_a_network(self):
        """The same as masks that come with the frames."""
        scene = tj.synthetic.make_scene(2, num_views=2, num_points=1500, height=60, width=80).scene
        masked = with_network_masks(scene, "sam-like")
        network = tj.masks.from_module(lambda images: [frame.masks for frame in masked.frames][: len(images)])
        result = tj.JointSegmenter(image_segmenter=network)(scene)
        assert torch.equal(result.points, tj.JointSegmenter()(masked).points)

    def test_a_network_inside_is_part_of_the_module(self):
        network = torch.nn.Conv2d(3, 1, 1)
        assert list(tj.masks.from_module(network).children()) == [network]

    @pytest.mark.parametrize(
        ("outputs", "message"),
        [
            ([STACK], "network's output: expected one for each of 2 images, got 1"),
            (None, "network's output: expected one for each of 2 images, got NoneType"),
            ([STACK, STACK * 0.5], "network's output for image 1: stack: expected booleans"),
            ([STACK, STACK[:, :2]], r"network's output for image 1: expected the size \(3, 4\), got \(2, 4\)"),
            (
                [STACK, "masks"],
                "network's output for image 1: stack: expected a torch.Tensor or a NumPy array, got str",
            ),
        ],
    )
    def test_wrong_output_is_named(self, outputs, message):
        with pytest.raises((ValueError, TypeError), match=message):
            tj.masks.from_module(lambda _: outputs)(self.IMAGES)

    def test_an_unknown_form_of_images_is_named(self):
        with pytest.raises(ValueError, match="images: expected 'batch' or 'array', got 'list'"):
            tj.masks.from_module(len, images="list")


class TestFiles:
    def test_a_label_image_of_16_bits(self, tmp_path):
        Image.fromarray((LABELS + 1).numpy().astype(np.uint16) * 300).save(tmp_path / "a.png")
        assert_equal(
            tj.masks.read_masks(tmp_path / "a.png"), torch.stack([value == LABELS for value in (0, 5, 9)]), [1] * 3
        )

    def test_a_folder_of_sams_command_line(self, tmp_path):
        for number, mask in zip((2, 10), STACK, strict=True):
            Image.fromarray(mask.numpy().astype(np.uint8) * 255).save(tmp_path / f"{number}.png")
        assert_equal(tj.masks.read_masks(tmp_path), STACK, [1, 1])
        table = tmp_path / "metadata.csv"
        table.write_text("id, area, predicted_iou, stability_score\n2,4,0.5,0.8\n10,4,1.02,1.0\n11,4,1,1\n")
        with pytest.warns(UserWarning, match=r"metadata\.csv: 1 of its masks have no PNG: 11"):
            assert_equal(tj.masks.read_masks(tmp_path), STACK, [0.4, 1])
        table.write_text("id,area,predicted_iou,stability_score\n2,4,0.5,0.8\n")
        with pytest.raises(ValueError, match=r"metadata.csv: expected a line with id 10"):
            tj.masks.read_masks(tmp_path)
        table.write_text("id,area,predicted_iou,stability_score\n" + 2 * "2,4,0.5,0.8\n" + "10,4,1.02,1.0\n")
        with pytest.raises(ValueError, match=r"metadata.csv: mask '2' is there twice"):
            tj.masks.read_masks(tmp_path)
        table.write_text("id,area,predicted_iou,stability_score\n2,4,nan,0.8\n10,4,1.02,1.0\n")
        with pytest.raises(ValueError, match=rf"{re.escape(str(tmp_path))}: .*' scores"):
            tj.masks.read_masks(tmp_path)
        table.unlink()
        (tmp_path / "._2.png").write_bytes(b"of macOS")
        assert len(tj.masks.read_masks(tmp_path)) == 2
        (tmp_path / "02.png").write_bytes((tmp_path / "2.png").read_bytes())
        with pytest.raises(ValueError, match="mask 2 is there twice"):
            tj.masks.read_masks(tmp_path)

    def test_masks_of_one_bit_a_pixel(self, tmp_path):
        Image.fromarray(STACK[0].numpy()).save(tmp_path / "0.png")
        assert torch.equal(tj.masks.read_masks(tmp_path).stack(), STACK[:1])

    def test_saved_masks_come_back(self, tmp_path):
        masks = tj.masks.from_stack(STACK, [0.25, 0.5])
        tj.masks.save_masks(tmp_path / "a.npz", masks)
        found = tj.masks.read_masks(tmp_path / "a.npz")
        assert all(torch.equal(getattr(found, name), getattr(masks, name)) for name in ("atom", "pairs", "scores"))
        assert [file.name for file in tmp_path.iterdir()] == ["a.npz"]
        with pytest.raises(ValueError, match=r"path: expected a file name with .npz, got a.png"):
            tj.masks.save_masks(tmp_path / "a.png", masks)

    def test_npz_of_others(self, tmp_path):
        np.savez(tmp_path / "stack.npz", masks=STACK.numpy(), scores=np.array([0.5, 1]))
        np.savez(tmp_path / "labels.npz", masks=LABELS.numpy())
        assert_equal(tj.masks.read_masks(tmp_path / "stack.npz"), STACK, [0.5, 1])
        assert len(tj.masks.read_masks(tmp_path / "labels.npz")) == 3

    def test_json_of_sam_and_of_sa_1b(self, tmp_path):
        records = [{"segmentation": {"size": [3, 4], "counts": c}, "area": 4, "predicted_iou": 0.5} for c in COUNTS]
        (tmp_path / "a.json").write_text(json.dumps(records))
        (tmp_path / "b.json").write_text(json.dumps({"image": {"height": 3, "width": 4}, "annotations": records}))
        for name in "ab":
            assert_equal(tj.masks.read_masks(tmp_path / f"{name}.json"), STACK, [0.5, 0.5])

    def test_npz_that_declares_more_than_its_file_can_hold(self, tmp_path):
        with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive, archive.open("masks.npy", "w") as stream:
            np.lib.format.write_array_header_1_0(
                stream, {"descr": "|u1", "fortran_order": False, "shape": (1 << 20, 1 << 20)}
            )
        with pytest.raises(ValueError, match=r"a\.npz: .*expected a shape that fits the file"):
            tj.masks.read_masks(tmp_path / "a.npz")

    @pytest.mark.parametrize("suffix", [".png", ".npz", ".json"])
    def test_truncated_files_are_named(self, tmp_path, suffix):
        path = tmp_path / f"masks{suffix}"
        if suffix == ".png":
            Image.fromarray(LABELS.numpy().astype(np.uint8)).save(path)
        elif suffix == ".npz":
            tj.masks.save_masks(path, tj.masks.from_stack(STACK))
        else:
            path.write_text(json.dumps([{"segmentation": {"size": [3, 4], "counts": COUNTS[0]}}]))
        whole = path.read_bytes()
        for length in (0, 1, len(whole) // 2, len(whole) - 24):
            path.write_bytes(whole[:length])
            with pytest.raises(ValueError, match=re.escape(str(path))):
                tj.masks.read_masks(path)

    def test_other_files_are_named(self, tmp_path):
        with pytest.raises(FileNotFoundError, match=r"a.png: missing; expected masks"):
            tj.masks.read_masks(tmp_path / "a.png")
        (tmp_path / "a.txt").write_text("masks")
        with pytest.raises(
            ValueError, match=r"a.txt: expected masks in a folder or in a file of kind .png, .npz, .json"
        ):
            tj.masks.read_masks(tmp_path / "a.txt")
        with pytest.raises(ValueError, match="expected PNGs, one for each mask, got none"):
            tj.masks.read_masks(tmp_path)
        Image.new("RGB", (4, 3)).save(tmp_path / "a.png")
        with pytest.raises(ValueError, match="expected a grey or palette image of labels, got mode RGB"):
            tj.masks.read_masks(tmp_path / "a.png")
        with pytest.raises(ValueError, match=r"a.png: expected a mask with values 0 and 255, got an image of mode RGB"):
            tj.masks.read_masks(tmp_path)
        Image.fromarray(LABELS.numpy().astype(np.uint8)).save(tmp_path / "a.png")
        with pytest.raises(
            ValueError, match=r"a.png: expected booleans, or numbers 0 and 1, got torch.uint8 from 0 to"
        ):
            tj.masks.read_masks(tmp_path)
        np.savez(tmp_path / "a.npz", segments=LABELS.numpy())
        with pytest.raises(ValueError, match=r"a.npz: expected masks, and optional scores, got segments"):
            tj.masks.read_masks(tmp_path / "a.npz")
        np.savez(tmp_path / "b.npz", masks=np.array([object()]))
        with pytest.raises(ValueError, match=r"b.npz"):
            tj.masks.read_masks(tmp_path / "b.npz")
