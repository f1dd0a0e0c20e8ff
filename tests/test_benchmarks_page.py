"""The page of the benchmarks says what the result files say, and each result names a command that exists."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
RESULTS = sorted((ROOT / "benchmarks" / "results").glob("*.json"))


def check(folder):
    """What `page.py --check` in a folder like benchmarks/ returns."""
    return subprocess.run([sys.executable, folder / "page.py", "--check"], capture_output=True, text=True)


@pytest.fixture
def copy(tmp_path):
    folder = tmp_path / "benchmarks"
    folder.mkdir()
    for name in ("page.py", "report.py", "page.md", "README.md"):
        shutil.copy(ROOT / "benchmarks" / name, folder)
    shutil.copytree(ROOT / "benchmarks" / "results", folder / "results")
    return folder


def test_the_page_is_that_of_the_result_files():
    """If not: `python benchmarks/page.py` writes it."""
    done = check(ROOT / "benchmarks")
    assert done.returncode == 0, done.stderr


def test_a_changed_result_makes_the_page_stale(copy):
    file = copy / "results" / "kitchen.json"
    result = json.loads(file.read_text(encoding="utf-8"))
    result["tables"][0]["rows"][0][1] += 1
    file.write_text(json.dumps(result), encoding="utf-8")
    done = check(copy)
    assert done.returncode == 1
    assert "run python benchmarks/page.py" in done.stderr


def test_a_result_without_a_mark_is_an_error(copy):
    shutil.copy(copy / "results" / "kitchen.json", copy / "results" / "bathroom.json")
    assert "bathroom" in check(copy).stderr


@pytest.mark.parametrize("file", RESULTS, ids=lambda file: file.stem)
def test_a_result_names_a_script_and_no_machine(file):
    text = file.read_text(encoding="utf-8")
    script = re.fullmatch(r"python (benchmarks/\w+\.py)( .*)?", json.loads(text)["command"])[1]
    assert (ROOT / script).is_file()
    assert not re.search(r"/(work|home|root|tmp)\b", text)
