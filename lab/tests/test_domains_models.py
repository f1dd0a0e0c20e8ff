"""Catalogues of models: read as they are written, each one instance, whole kinds of things held out."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
from torchjoint_lab.synthetic import make_domain_scene
from torchjoint_lab.synthetic.catalogue import Catalogue, is_held_out

pytest.importorskip("open3d")

#: A wedge 2 x 1 x 1 (y up), of two materials, one with a texture.
OBJ = """mtllib wedge.mtl
v -1 0 -0.5\nv 1 0 -0.5\nv 1 0 0.5\nv -1 0 0.5\nv -1 1 -0.5\nv -1 1 0.5
vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1
usemtl plain
f 1/1 2/2 3/3\nf 1/1 3/3 4/4\nf 1/1 5/2 2/3\nf 4/1 3/2 6/3
usemtl picture
f 2/1 5/4 6/3\nf 2/1 6/3 3/2\nf 1/1 4/2 6/3\nf 1/1 6/3 5/4
"""
MTL = "newmtl plain\nKd .8 .1 .1\nnewmtl picture\nKd 1 1 1\nmap_Kd picture.png\n"
KINDS = ("anvil", "brush", "camera", "clock", "drill", "duck", "flute", "hammer", "jar", "radio", "speaker")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    import cv2

    picture = np.zeros((8, 8, 3), dtype=np.uint8)
    picture[4:] = (0, 255, 0)  # BGR: the lower half is green
    png = cv2.imencode(".png", picture)[1].tobytes()
    lines = []
    with zipfile.ZipFile(tmp_path / "fake.sh3f", "w") as archive:
        for i, kind in enumerate([*KINDS, "Plate, glass"]):
            lines += [f"name#{i}=Small {kind} {i}", f"category#{i}=Kitchen", f"model#{i}=/fake/{i}/wedge.obj"]
            lines += [f"width#{i}=20.0", f"depth#{i}=10.0", f"height#{i}=10.0", f"multiPartModel#{i}=true"]
            for name, text in (("wedge.obj", OBJ), ("wedge.mtl", MTL), ("picture.png", png)):
                archive.writestr(f"fake/{i}/{name}", text)
        archive.writestr("PluginFurnitureCatalog.properties", "\n".join(lines).encode("latin-1"))
    return tmp_path


def test_kinds_are_held_out_whole(folder: Path) -> None:
    taught, kept = ({m.kind for m in Catalogue(folder, held_out).models} for held_out in (False, True))
    assert taught | kept == set(KINDS)
    assert not taught & kept
    assert kept == {kind for kind in KINDS if is_held_out(kind)} != set()


def test_a_model_is_one_item_upright_and_of_its_size(folder: Path) -> None:
    item = Catalogue(folder).draw(np.random.default_rng(0), (0.05, 0.3))
    assert item is not None
    np.testing.assert_allclose(item.size, (0.2, 0.1, 0.1), atol=1e-6)
    corners = np.concatenate([part.positions.reshape(-1, 3) for part, _ in item.parts])
    np.testing.assert_allclose(corners.min(axis=0), (-0.1, -0.05, 0), atol=1e-6)
    tiles = sorted((material.tile for _, material in item.parts), key=np.size)
    assert tiles[0].shape == (1, 1, 3)
    assert tuple(tiles[1][0, 0]) == (0, 255, 0)  # row 0 is at v = 0, the lower side


def test_nothing_of_that_size_is_none(folder: Path) -> None:
    catalogue = Catalogue(folder)
    assert catalogue.draw(np.random.default_rng(0), (3.0, 5.0)) is None
    assert catalogue.draw(np.random.default_rng(0), (0.05, 0.3), kinds=("chair",)) is None


def test_plain_files_are_of_their_folder_s_kind(tmp_path: Path) -> None:
    for kind in KINDS:
        (tmp_path / kind).mkdir()
        (tmp_path / kind / "one.obj").write_text(OBJ.replace("mtllib wedge.mtl\n", ""))
    kinds = {m.kind for held_out in (False, True) for m in Catalogue(tmp_path, held_out).models}
    assert kinds == set(KINDS)
    item = Catalogue(tmp_path).draw(np.random.default_rng(0), (0.1, 9.0))
    assert item is not None
    np.testing.assert_allclose(item.size, (2, 1, 1), atol=1e-6)


@pytest.mark.slow
def test_scenes_hold_models_of_one_side_only(folder: Path) -> None:
    for held_out in (False, True):
        made = make_domain_scene("bin", 1, num_views=1, num_points=2000, models=folder, held_out=held_out)
        models = set(made.instance_names) & set(KINDS)
        assert models
        assert all(is_held_out(kind) == held_out for kind in models)


def test_an_empty_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="models: expected a folder"):
        make_domain_scene("table", models=tmp_path)
