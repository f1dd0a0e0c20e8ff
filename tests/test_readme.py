"""The README, and the documents that it links, say what is true."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

import torchjoint as tj
from torchjoint.config import marked_table, parameter_table, superpoint_table
from torchjoint.datasets.formats import FORMATS

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def between(name, page):
    text = (ROOT / page).read_text(encoding="utf-8")
    return re.search(rf"<!-- {name} -->\n(.*?)<!-- end {name} -->", text, flags=re.DOTALL)[1].strip()


def test_the_result_is_that_of_the_table_of_real_sets():
    """README has the means of F without LiDAR and of LiDAR; first of the default, then of the best simple method."""
    rows = [line.split("|")[1:-1] for line in between("real", "docs/evaluation.md").splitlines()[2:]]
    means = {name.strip(): cells for name, *cells in rows}
    sets = "**mean of the sets without LiDAR**", "**mean of LiDAR**"
    expected = [means[name][column].split()[0] for column in (0, 1) for name in sets]
    assert re.findall(r"\d\.\d+", between("result", "README.md")) == expected


@pytest.mark.parametrize("page", ["README.md", "docs/index.md", "docs/in_and_out.md"])
def test_the_number_of_formats_is_the_code_s(page):
    assert re.findall(r"(\d+) formats", (ROOT / page).read_text(encoding="utf-8")) == [str(len(FORMATS))]


def test_the_readme_is_short():
    assert len(README.split()) <= 700


def test_the_pages_are_few_and_short():
    words = {page.name: len(page.read_text(encoding="utf-8").split()) for page in (ROOT / "docs").glob("*.md")}
    assert len(words) <= 16
    assert sum(words.values()) <= 18_000
    assert words["evaluation.md"] <= 1200


def test_the_table_of_marked_parameters_is_the_code_s():
    """If not: `torchjoint parameters` prints it first."""
    assert between("marked parameters", "docs/parameters.md") == marked_table().strip()


def test_the_table_of_parameters_is_the_code_s():
    """If not: `torchjoint parameters` prints it."""
    assert between("parameters", "docs/parameters.md") == parameter_table().strip()


def test_the_table_of_superpoint_parameters_is_the_code_s():
    """If not: `torchjoint parameters --superpoints` prints it."""
    assert between("superpoint parameters", "docs/superpoints.md") == superpoint_table().strip()


@pytest.mark.slow
def test_the_warnings_about_poses_are_the_code_s(monkeypatch):
    """If not: `python lab/studies/pictures.py` writes them. Numbers may differ a little from machine to machine."""
    monkeypatch.syspath_prepend(ROOT / "lab" / "studies")
    pictures = importlib.import_module("pictures")
    said, written = (
        re.sub(r"[\d.]+", "N", text) for text in (pictures.messages(), between("mistakes", "docs/your_data.md"))
    )
    assert said == written


def test_ci_runs_the_test_command():
    command = re.search(r"<!-- test command -->\n```bash\n(.*)\n```", README)[1]
    for variable in ("PIP_CONSTRAINT", "PIP_BUILD_CONSTRAINT"):
        assert f"{variable}=constraints.txt" in command
    assert "-e '.[test]' -e lab && " in command
    assert command.rstrip().endswith("pytest -n 2")
    ci = (ROOT / ".ci" / "run").read_text()
    assert ci.index("<!-- test command -->") < ci.index("make slow")  # what it leaves out comes next


def test_make_installs_what_the_readme_does():
    packages = re.search(r"pip install (.*?) &&", README[README.index("<!-- test command -->") :])[1]
    assert f"pip install {packages}\n" in (ROOT / "Makefile").read_text()


def test_files_that_are_linked_exist():
    for link in re.findall(r"\]\((?!http)([^)#]+)\)", README):
        assert (ROOT / link).exists(), link


def test_names_in_the_text_exist():
    for name in set(re.findall(r"\btj\.([A-Za-z_.]+)", README)):
        thing = tj
        for part in name.rstrip(".").split("."):
            thing = getattr(thing, part)
    for name in tj.__all__:
        assert getattr(tj, name) is not None


def test_constraints_pin_what_is_tested():
    """Here, and so in CI, the versions of constraints.txt are the ones that run."""
    import torch

    pins = dict(re.findall(r"^([\w.-]+)==(\S+)$", (ROOT / "constraints.txt").read_text(), flags=re.MULTILINE))
    assert pins["torch"] == torch.__version__.split("+")[0]


@pytest.fixture(scope="module")
def imported():
    """The modules that are there after `import torchjoint`."""
    code = "import sys, torchjoint; print(*sys.modules)"
    return set(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split())


@pytest.mark.parametrize("module", ["open3d", "matplotlib", "sklearn", "viser", "tyro", "torchmetrics", "cv2"])
def test_import_is_light(module, imported):
    assert "torchjoint" in imported
    assert module not in imported
