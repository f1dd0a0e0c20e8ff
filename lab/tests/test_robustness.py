"""`torchjoint-lab robustness`: each disturbance on a scene by hand, scores, resuming, the table, the command."""

import json
import math

import numpy as np
import pytest
import torch
from torchjoint_lab.benchmark import robustness, robustness_scenes
from torchjoint_lab.benchmark.disturbances import CLEAN, DISTURBANCES, as_8_bits
from torchjoint_lab.benchmark.robustness import Run, covering, disturb, measure, report, scores
from torchjoint_lab.benchmark.robustness_scenes import GENERATED, NamedScene, find_scenes

from torchjoint.runtime.threads import LazySequence
from torchjoint.scene import Frame, Scene, Truth
from torchjoint.scene.frame import camera_center

#: What the disturbance 16-bit looks like.
pytestmark = pytest.mark.filterwarnings("ignore:colors. got values up to .*divided by 255 twice")

COUNT = 200


def frame(index):
    image = torch.tensor([0.2, 0.2, 0.1])[:, None, None] * torch.full((3, 4, 5), index + 1.0)
    return Frame(as_8_bits(image), torch.eye(3), torch.eye(4), name=f"{index}")


@pytest.fixture
def scene():
    """A grid of 20 x 10 points, 1 m apart, of three colours; four frames."""
    points = torch.cartesian_prod(torch.arange(20.0), torch.arange(10.0), torch.zeros(1))
    colors = torch.tensor([[255, 100, 50], [10, 200, 30], [80, 80, 240]])[torch.arange(COUNT) % 3] / 255
    normals = torch.tensor([0.0, 0, 1]).expand(COUNT, 3)
    return Scene(points, [frame(i) for i in range(4)], colors, normals, truth=Truth(torch.arange(COUNT) % 2))


def disturbed(name, scene, seed=0):
    return DISTURBANCES[name](scene, torch.Generator().manual_seed(seed))


def images(scene):
    return torch.stack([one.image for one in scene.frames])


def poses(scene):
    return torch.stack([one.world_to_camera for one in scene.frames])


#: What a disturbance changes; everything else stays.
CHANGES = {
    CLEAN: set(),
    "moved": {"points"},
    "black": {"colors"},
    "exposure": {"images"},
    "half-frames": {"frames"},
    "one-frame": {"frames"},
    **{name: {"poses"} for name in ("poses-1cm", "poses-3cm", "poses-1deg")},
    **{name: {"cloud"} for name in ("half-points", "voxels", "outliers-1", "outliers-5", "twice", "shuffled")},
}
LIGHT = ("light-0.1", "light-0.25", "light-0.5", "light-2", "gamma-0.5", "gamma-2", "warm", "cold")
CHANGES |= {name: {"colors", "images"} for name in (*LIGHT, "16-bit", "grey", "color-noise")}


def test_every_disturbance_is_tested():
    assert set(CHANGES) == set(DISTURBANCES)


@pytest.mark.parametrize("name", DISTURBANCES)
def test_a_disturbance_changes_what_it_names(scene, name):
    before = images(scene).clone(), scene.points.clone(), scene.colors.clone()
    found, original = disturbed(name, scene)
    assert found.truth is None
    assert len(original) == len(found.points)
    changed = CHANGES[name]
    if "cloud" in changed:
        left = original >= 0
        for kept in ("points", "colors", "normals"):
            assert torch.equal(getattr(found, kept)[left], getattr(scene, kept)[original[left]])
    else:
        assert torch.equal(original, torch.arange(COUNT))
        assert torch.equal(found.points, scene.points) == ("points" not in changed)
        assert torch.equal(found.colors, scene.colors) == ("colors" not in changed)
        assert torch.equal(found.normals, scene.normals)
    if "frames" not in changed:
        assert torch.equal(images(found), images(scene)) == ("images" not in changed)
        assert torch.equal(poses(found), poses(scene)) == ("poses" not in changed)
    for now, then in zip((images(scene), scene.points, scene.colors), before, strict=True):
        assert torch.equal(now, then)  # the scene itself stays


@pytest.mark.parametrize("name", DISTURBANCES)
def test_a_disturbance_is_pure(scene, name):
    first, second = disturbed(name, scene, 3), disturbed(name, scene, 3)
    for one, other in zip((*first.scene.cloud.__dict__.values(),), second.scene.cloud.__dict__.values(), strict=True):
        assert (one is None and other is None) or torch.equal(one, other)
    assert torch.equal(images(first.scene), images(second.scene))
    assert torch.equal(images(first.scene), images(first.scene))  # also when it is read again
    assert torch.equal(poses(first.scene), poses(second.scene))


def test_points_move_by_a_share_of_their_own_spacing():
    near = torch.cartesian_prod(torch.arange(40.0), torch.arange(40.0), torch.zeros(1))
    scene = Scene(torch.cat([near * 0.01, near + 100]))
    moved = (disturbed("moved", scene).scene.points - scene.points).std(1)
    assert float(moved[:1600].mean()) == pytest.approx(0.003 * 0.886, rel=0.05)  # of three numbers, on the average
    assert float(moved[1600:].mean()) == pytest.approx(0.3 * 0.886, rel=0.05)


def test_points_are_left_out_added_and_shuffled(scene):
    half = disturbed("half-points", scene).original
    assert len(half) == COUNT / 2
    assert torch.equal(half, half.unique())  # in their order
    for name, share in (("outliers-1", 0.01), ("outliers-5", 0.05)):
        found, original = disturbed(name, scene)
        assert original.tolist() == [*range(COUNT), *[-1] * int(share * COUNT)]
        added = found.points[COUNT:]
        assert ((added >= scene.points.amin(0)) & (added <= scene.points.amax(0))).all()
    found, original = disturbed("twice", scene)
    assert original.tolist() == [*range(COUNT), *[-1] * COUNT]
    distance = (found.points[COUNT:] - scene.points).norm(dim=1)
    assert 0 < float(distance.min()) < float(distance.max()) < 2
    assert torch.equal(found.colors[COUNT:], scene.colors)
    shuffled = disturbed("shuffled", scene).original
    assert not torch.equal(shuffled, torch.arange(COUNT))
    assert torch.equal(shuffled.sort().values, torch.arange(COUNT))


def test_other_voxels_keep_one_point_in_each():
    grid = torch.cartesian_prod(torch.arange(60.0), torch.arange(60.0), torch.zeros(1)) * 0.01
    first, second = (disturb(Run("table", "one", "voxels", number), Scene(grid)).original for number in (0, 1))
    for kept in (first, second):
        assert len(kept) / len(grid) == pytest.approx(1 / 1.5**2, rel=0.1)
        assert torch.equal(kept, kept.unique())
    assert not torch.equal(first, second)


def test_a_scene_of_points_alone_gets_outliers(scene):
    found, _ = disturbed("outliers-5", Scene(scene.points))
    assert (found.colors, found.normals) == (None, None)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("light-0.1", [26, 10, 5]),  # 25.5 is rounded to the even number
        ("light-0.25", [64, 25, 12]),
        ("light-0.5", [128, 50, 25]),
        ("light-2", [255, 200, 100]),
        ("gamma-0.5", [255, 160, 113]),
        ("gamma-2", [255, 39, 10]),
        ("warm", [255, 85, 30]),
        ("cold", [153, 85, 50]),
        ("16-bit", [255 / 257, 100 / 257, 50 / 257]),
        ("grey", [141, 141, 141]),
    ],
)
def test_light_by_hand(scene, name, expected):
    found = disturbed(name, scene).scene
    torch.testing.assert_close(found.colors[0] * 255, torch.tensor(expected, dtype=torch.float32), atol=0.01, rtol=0)
    of_image = disturbed(name, Scene(scene.points, scene.frames, as_8_bits(torch.tensor([[0.4, 0.4, 0.2]] * COUNT))))
    assert torch.equal(found.frames[1].image[:, 2, 3], of_image.scene.colors[0])  # images change as points do


def test_colors_get_noise_black_and_exposure(scene):
    noise = disturbed("color-noise", scene).scene
    change = images(noise)[1] - images(scene)[1]
    assert float(change.std()) == pytest.approx(0.05, rel=0.3)
    assert not torch.equal(change, images(noise)[2] - images(scene)[2])  # other noise in each frame
    black = (disturbed("black", scene).scene.colors == 0).all(1)
    assert 0.2 < float(black.double().mean()) < 0.4
    factors = (images(disturbed("exposure", scene).scene) / images(scene)).flatten(1)[:3]  # the last is clipped
    assert (factors.std(1) < 0.02).all()  # one factor for each frame, but for 8 bits
    assert len(factors[:, 0].unique()) == 3
    assert ((factors >= 0.58) & (factors <= 1.42)).all()


def test_frames_are_left_out(scene):
    names = {tuple(one.name for one in disturbed("half-frames", scene, seed).scene.frames) for seed in range(8)}
    assert names == {("0", "2"), ("1", "3")}
    names = {tuple(one.name for one in disturbed("one-frame", scene, seed).scene.frames) for seed in range(20)}
    assert names == {("0",), ("1",), ("2",), ("3",)}


@pytest.mark.parametrize(("name", "shift"), [("poses-1cm", 0.01), ("poses-3cm", 0.03)])
def test_cameras_are_moved(scene, name, shift):
    found = poses(disturbed(name, scene).scene)
    centers = torch.stack([camera_center(pose) for pose in found])
    torch.testing.assert_close(centers.norm(dim=1), torch.full((4,), shift, dtype=torch.float64))
    assert len(centers.unique(dim=0)) == 4
    assert torch.equal(found[:, :3, :3], torch.eye(3, dtype=torch.float64).expand(4, 3, 3))


def test_cameras_are_turned(scene):
    found = poses(disturbed("poses-1deg", scene).scene)
    angle = torch.acos((found[:, :3, :3].diagonal(dim1=1, dim2=2).sum(1) - 1) / 2)
    torch.testing.assert_close(angle, torch.full((4,), math.radians(1), dtype=torch.float64))
    assert not found[:, :3, 3].any()


def test_images_are_changed_when_they_are_read(scene):
    read = []

    def load(index):
        read.append(index)
        return frame(index)

    lazy = Scene(scene.points, LazySequence(4, load))
    for name in ("light-0.5", "poses-1cm", "half-frames"):
        found = disturbed(name, lazy).scene
        assert read == []
        found.frames[1]
        assert len(read) == 1
        read.clear()


def test_what_a_scene_lacks_is_not_disturbed(scene):
    bare, one = Scene(scene.points), scene.select_frames([0])
    always = {"nothing", "moved", "half-points", "voxels", "outliers-1", "outliers-5", "twice", "shuffled"}
    assert {name for name in DISTURBANCES if DISTURBANCES[name].applies(bare)} == always
    assert {name for name in DISTURBANCES if not DISTURBANCES[name].applies(one)} == {"half-frames", "one-frame"}
    without = Scene(scene.points, scene.frames)
    assert {name for name in DISTURBANCES if not DISTURBANCES[name].applies(without)} == {"black"}


def test_every_run_is_moved_by_noise_of_its_own(scene):
    runs = [Run("k", "s", name, number) for name in (CLEAN, "grey") for number in range(2)]
    moves = torch.stack([disturb(run, scene).scene.points - scene.points for run in runs])
    assert len(moves.unique(dim=0)) == 4
    assert float(moves.std()) == pytest.approx(1e-4, rel=0.1)
    assert torch.equal(disturb(runs[1], scene).scene.points, disturb(runs[1], scene).scene.points)


def test_added_and_removed_points_do_not_count():
    truth = torch.tensor([0, 0, 1, 1, -1, 0])
    original = torch.tensor([3, 0, 1, -1, -1, 2])  # points 4 and 5 are gone, two are added
    labels = torch.tensor([7, 5, 5, 5, 7, 7])
    assert scores(labels, original, truth) == {"f": 1.0, "best_iou": 1.0}
    assert covering(labels, original, torch.tensor([0, 0, 1, 1, 0, 1])) == 1.0
    assert covering(labels, original, torch.tensor([0, 0, 0, 0, 2, 3])) == pytest.approx(0.5)
    assert scores(labels, original, None) == {}
    assert scores(labels, torch.tensor([4, 4, 4, 4, 4, -1]), truth) == {}


def cells(line):
    return [cell.strip() for cell in line.split("|")[1:-1]]


def test_the_table_by_hand():
    def of(kind, scene, name, *records):
        keys = {0: (), 1: ("covering",), 2: ("f", "best_iou"), 3: ("f", "best_iou", "covering")}
        return {
            Run(kind, scene, name, number): dict(zip(keys[len(record)], record, strict=True))
            for number, record in enumerate(records)
        }

    results = {
        **of("room", "room-40", CLEAN, (0.4, 0.5), (0.6, 0.5, 0.9), (0.5, 0.5, 0.8)),
        **of("room", "room-41", CLEAN, (0.8, 0.5), (0.6, 0.5, 0.7), (0.7, 0.5, 0.8)),
        **of("walk", "walk-0", CLEAN, (), (1.0,), (0.8,)),
        **of("room", "room-40", "grey", (0.1, 0.5, 0.5), (0.1, 0.5, 0.5), (0.1, 0.5, 0.5)),
        **of("room", "room-41", "grey", (0.3, 0.5, 0.5), (0.2, 0.5, 0.5), (0.1, 0.5, 0.5)),
        **of("walk", "walk-0", "grey", (), (), ()),
        **of("walk", "walk-0", "twice", (0.9,), (0.8,), (0.7,)),
    }
    columns, _, clean, grey, twice = (cells(line) for line in report(results).splitlines()[-5:])
    assert columns == ["disturbance", "room", "walk", "mean", "mean - clean"]
    assert clean == [
        "nothing", ".60 / .50, .80", ".90", "0.600 ± 0.000 / 0.500 ± 0.000, 0.850 ± 0.071", ""
    ]  # fmt: skip
    assert grey == [
        "grey", ".15 / .50, .50", "–", "0.150 ± 0.050 / 0.500 ± 0.000, 0.500 ± 0.000",
        "**-0.450 ± 0.029** / +0.000 ± 0.000, **-0.300 ± 0.000**",
    ]  # fmt: skip
    # Errors of three and two runs: the root of 0.1² / 3 + 0.02 / 2.
    assert twice == ["each point twice, with noise", "–", ".80", "0.800 ± 0.100", "-0.100 ± 0.115"]


@pytest.fixture
def segmented(monkeypatch):
    """Labels without the segmenter: the halves of a scene. Returns the scenes that were segmented."""
    seen = []

    def segment(scene):
        seen.append(scene)
        return (scene.points[:, 0] > 9.5).long()

    monkeypatch.setattr(robustness, "_segment", segment)
    return seen


def test_a_killed_run_goes_on(tmp_path, scene, segmented):
    loaded = []
    named = NamedScene("grid", "grid-0", lambda: loaded.append(1) or scene)
    steps = iter(range(3))

    def killed(scene, real=robustness._segment):
        if next(steps, None) is None:
            raise KeyboardInterrupt
        return real(scene)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(robustness, "_segment", killed)
        with pytest.raises(KeyboardInterrupt):
            list(measure([named], ["grey"], 2, tmp_path))
    assert len(segmented) == 3
    results = next(measure([named], ["grey"], 2, tmp_path))
    assert (len(segmented), len(loaded)) == (4, 2)
    assert [(run.disturbance, run.number) for run in results] == [(n, r) for n in (CLEAN, "grey") for r in range(2)]
    assert "covering" not in results[Run("grid", "grid-0", CLEAN, 0)]
    assert results[Run("grid", "grid-0", "grey", 1)]["covering"] == 1.0
    assert np.load(tmp_path / "grid-0.npy").tolist() == [0] * 100 + [1] * 100
    assert list(measure([named], ["grey"], 2, tmp_path)) == [results]
    assert (len(segmented), len(loaded)) == (4, 2)  # nothing was left to do
    more = next(measure([named], ["grey"], 3, tmp_path))
    assert len(more) == len(segmented) == 6


def test_what_does_not_apply_is_remembered(tmp_path, scene, segmented):
    named = NamedScene("grid", "grid-0", lambda: Scene(scene.points))
    results = next(measure([named], ["grey"], 1, tmp_path))
    assert list(results.values()) == [{}, {}]  # no truth; no colours
    assert len(segmented) == 1
    assert json.loads((tmp_path / "grid-0.grey.0.json").read_text()) == {}


def test_scenes_are_found(tmp_path):
    assert [one.name for one in find_scenes(("shelf",), 2, None)] == ["shelf-40", "shelf-41"]
    assert [one.kind for one in find_scenes((), 1, None)] == list(GENERATED)
    argo = tmp_path / "argo"
    argo.mkdir()
    np.save(argo / "cloud.truth.npy", np.array([3, -1, -2]))
    (argo / "cloud.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "end_header\n0 0 0\n1 0 0\n0 1 0\n"
    )
    folder = tmp_path / "semantickitti"
    folder.mkdir()
    np.arange(16, dtype=np.float32).tofile(folder / "7.bin")
    np.array([10 + (5 << 16), 40, 1, 50], dtype=np.uint32).tofile(folder / "7.label")
    found = {one.name: one.load() for one in find_scenes((), 1, tmp_path) if one.kind not in GENERATED}
    assert found["argo-cloud"].truth.points.tolist() == [3, -1, -1]
    assert found["semantickitti-7"].truth.points.tolist() == [10 + (5 << 16), 0, -1, -1]
    assert found["semantickitti-7"].points[1].tolist() == [4, 5, 6]


def test_every_second_table_top_is_scored_thinned(tmp_path, monkeypatch):
    paths = {f"learn{number}": number for number in (0, 10, 2, 4)}
    dense = Scene(torch.arange(300.0).reshape(100, 3) * 0.001)
    (tmp_path / "mosd").mkdir()
    monkeypatch.setattr(robustness_scenes, "list_scenes", lambda folder: paths)
    monkeypatch.setattr(robustness_scenes, "load_scene", lambda path: dense)
    found = find_scenes(("mosd",), 9, tmp_path)
    assert [one.name for one in found] == ["mosd-learn2", "mosd-learn10"]
    assert len(found[0].load().points) < 100


def test_bad_arguments_are_named(tmp_path, run_lab):
    for arguments, message in (
        (("--kinds", "attic"), "--kinds: expected some of table, .*, argo, got 'attic'"),
        (("--disturbances", "fog"), "--disturbances: expected some of nothing, moved, .*, got 'fog'"),
        (("--scenes", 0), "--scenes: expected at least 1, got 0"),
        (("--runs", 0), "--runs: expected at least 1, got 0"),
        (("--kinds", "ycb"), "--data: kind ycb needs a folder with scenes in ycb/, got None"),
        (("--data", tmp_path / "none"), "--data: .*none is not a folder"),
    ):
        with pytest.raises(SystemExit, match=message):
            run_lab("robustness", *arguments, "-o", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    (tmp_path / "file").touch()
    with pytest.raises(SystemExit, match=r"-o: .*file exists and is not a folder"):
        run_lab("robustness", "--kinds", "table", "-o", tmp_path / "file")
    (tmp_path / "table.md").write_text("mine")
    with pytest.raises(SystemExit, match=r"table.md: exists already; choose another name with -o, or --overwrite"):
        run_lab("robustness", "--kinds", "table", "-o", tmp_path)
    assert (tmp_path / "table.md").read_text() == "mine"


def test_the_command(tmp_path, monkeypatch, scene_of, run_lab, capsys):
    made = scene_of(2, num_views=2, num_points=1500, height=60, width=80).scene
    monkeypatch.setattr(robustness_scenes, "_make", lambda kind, seed: made)
    chosen = ("--kinds", "table", "--disturbances", "half-frames", "--scenes", 1, "--runs", 2, "-o", tmp_path)
    run_lab("robustness", *chosen)
    rows = {line[0]: line[1] for line in map(cells, (tmp_path / "table.md").read_text().splitlines()[-2:])}
    assert set(rows) == {"nothing", "half of the frames"}
    record = json.loads((tmp_path / "runs" / "table-40.half-frames.1.json").read_text())
    assert set(record) == {"f", "best_iou", "covering"}
    assert all(0 < value <= 1 for value in record.values())
    assert "written to" in capsys.readouterr().out
