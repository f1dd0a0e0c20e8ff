"""Every command of the README and of docs/ runs, in the order of its page, on small data with the names of the page."""

import importlib
import re
import shlex
import shutil
from contextlib import nullcontext
from pathlib import Path

import laspy
import numpy as np
import pytest
import samples
import torch
from copc_files import write_copc
from folder_files import write_folder, write_truth
from las_town import town, write_las
from PIL import Image
from scannet_files import shots_of, write_mesh, write_point_truth, write_sens

import torchjoint as tj
from torchjoint.engine import open_engine
from torchjoint.results.embeddings import Embeddings

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]

#: What a page can only guess, and what stands for it here.
STAND_INS = {
    "dask://head:8786": "loky:1",  # tests of engines have a real cluster
    "loky:4": "loky:1",
    "scans/scene0011_00": "scannet/scene0000_00",
    "000008.bin": "000007.bin",
    "/front/image_raw": "/camera/image_raw",
    " odometry=/slam/odometry": "",
}

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]


def commands(page):
    """The commands of torchjoint in the blocks of a page, as lists of words."""
    blocks = re.findall(r"```bash\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    lines = [line for block in blocks for line in block.splitlines() if re.match(r"(\.venv/bin/)?torchjoint ", line)]
    for stand_in in STAND_INS.items():
        lines = [line.replace(*stand_in) for line in lines]
    parts = [part for line in lines for part in shlex.split(line, comments=True)]
    found = []
    for part in parts:
        if part.endswith("torchjoint"):
            found.append([])
        elif part != "&&":
            found[-1].append(part)
    return found


@pytest.fixture(scope="module")
def world(tmp_path_factory, scene_of):
    """A folder with all that the pages name."""
    folder, scene = tmp_path_factory.mktemp("world"), scene_of(3, num_views=3)
    write_truth(write_folder(folder / "recording", scene), scene)
    (folder / "masks").mkdir()
    for index, labels in enumerate(scene.image_labels):
        Image.fromarray((labels.numpy() + 1).astype(np.uint16)).save(folder / "masks" / f"frame-{index * 5:06d}.png")
    (folder / "scans").mkdir()
    for name in ("kitchen1", "office"):
        write_folder(folder / "scans" / name, scene, depth=False)
    (folder / "more.txt").write_text("recording\n")
    shutil.copy(folder / "recording" / "cloud.ply", folder / "cloud.ply")
    write_las(folder / "city.laz", town(5000, 60))
    shutil.copy(folder / "city.laz", folder / "site.laz")
    (folder / "city").mkdir()
    shutil.copy(folder / "city.laz", folder / "city" / "a.laz")
    write_copc(folder / "city.copc.laz", laspy.read(folder / "city.laz"))
    cloud = scene.scene
    scan, camera = folder / "scannet" / "scene0000_00", scene.scene.frames[0].intrinsics
    scan.mkdir(parents=True)
    write_sens(scan / "scene0000_00.sens", shots_of(scene.scene), camera, camera)
    write_mesh(scan / "scene0000_00_vh_clean_2.ply", cloud.points.numpy(), (cloud.colors * 255).int().numpy())
    write_point_truth(scan, "scene0000_00", scene.point_labels.numpy())
    shutil.copy(samples.write("kitti", folder / "kitti"), folder / "000123.bin")
    shutil.move(folder / "kitti" / "training", folder / "training")
    shutil.copy(samples.write("ros_one", folder / "ros"), folder / "walk.bag")
    (folder / "bags").mkdir()
    samples.write("vggt", folder / "room")
    shutil.copy(folder / "walk.bag", folder / "bags" / "one.bag")
    (folder / "words.py").write_text("def encode(words): ...\n")
    return folder


@pytest.fixture(scope="module")
def finished(world, tmp_path_factory):
    """A result with embeddings, made once: of another page, and by a program of the page."""
    out = tmp_path_factory.mktemp("finished") / "out"
    tj.recordings.segment_recording(world / "recording", out, tj.Config(), tj.RecordingOptions())
    labels = tj.load_result(out).points
    Embeddings(torch.eye(int(labels.max()) + 1), labels).save(out)
    return out


@pytest.fixture(scope="module")
def one_engine():
    """In the place of `open_engine`: one worker for all pages, whose names of engines are still read."""
    with open_engine("loky:1") as worker:

        def opened(name, threads=1):
            with open_engine(name, threads):  # starts no worker before its first task
                return nullcontext(worker)

        yield opened


@pytest.fixture
def place(world, one_engine, monkeypatch):
    """The world is the current folder, the demo is small, and pages in the browser end when they are served."""
    monkeypatch.chdir(world)
    monkeypatch.syspath_prepend(world)
    monkeypatch.setattr("torchjoint.cli.demo.RECORDING", world / "recording")  # .ci/wheels runs the whole demo
    for module in ("torchjoint.recordings.batch", "torchjoint.cli.segment", "torchjoint.tiles.run"):
        monkeypatch.setattr(importlib.import_module(module), "open_engine", one_engine)  # tj.batch hides its module
    for module in ("show", "live"):
        monkeypatch.setattr(f"torchjoint.cli.{module}.serve_until_interrupted", lambda viewer: viewer.stop())
    monkeypatch.setattr("webbrowser.open", lambda url: None)
    before = set(world.iterdir())
    yield
    for made in set(world.iterdir()) - before:
        shutil.rmtree(made) if made.is_dir() else made.unlink()


@pytest.mark.parametrize("page", [page for page in PAGES if commands(page)], ids=lambda page: page.stem)
def test_the_commands_of_a_page_run(page, place, run, request):
    for words in commands(page):
        wants_result = words[0] in ("show", "export") and {"out", "out/"} & set(words)
        if wants_result and not Path("out").exists():
            shutil.copytree(request.getfixturevalue("finished"), "out")
        if "-o" in words:
            out = Path(words[words.index("-o") + 1])
            if words[0] != "batch":  # goes on in the folder of an earlier command
                shutil.rmtree(out, ignore_errors=True)
                out.unlink(missing_ok=True)
        run(*words)
        assert "-o" not in words or out.exists(), words


def test_all_pages_with_commands_are_found():
    found = {page.stem for page in PAGES if commands(page)}
    expected = "README in_and_out index large live masks parameters quickstart superpoints your_data"
    assert found == set(expected.split())
    assert ["show", "out"] in commands(ROOT / "README.md")
