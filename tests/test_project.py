"""The files around the package say the same: version, date, targets of make, workflows."""

import datetime
import re
import tomllib
from pathlib import Path

import pytest
import yaml

import torchjoint

ROOT = Path(__file__).parents[1]
YAML_FILES = ["CITATION.cff", ".clang-format", ".pre-commit-config.yaml"]
YAML_FILES += sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / ".github").rglob("*.yml"))
#: What README's test command does in CI, what changes files, and CI itself.
NOT_IN_CI = {"install", "test", "format", "coverage", "ci"}


def text(name):
    return (ROOT / name).read_text(encoding="utf-8")


def release():
    """The text of the changelog's section of this version, and its date."""
    heading = rf"## \[{re.escape(torchjoint.__version__)}\] - (\S+)\n(.*?)(?=^## |\Z)"
    date, section = re.search(heading, text("CHANGELOG.md"), re.DOTALL | re.MULTILINE).groups()
    return section, datetime.date.fromisoformat(date)


def make_targets():
    return set(re.findall(r"^([a-z]+):", text("Makefile"), re.MULTILINE))


def test_the_changelog_has_this_version():
    section, _ = release()
    assert re.findall(r"^### (.*)$", section, re.MULTILINE) == ["Added"]  # nothing was released before
    assert section.count("\n- ") >= 10


def test_the_changelog_is_short():
    assert len(text("CHANGELOG.md").splitlines()) <= 100


def test_the_citation_is_of_this_version():
    citation = yaml.safe_load(text("CITATION.cff"))
    assert citation["version"] == torchjoint.__version__
    assert citation["date-released"] == release()[1]
    (paper,) = citation["references"]
    assert f"title     = {{{paper['title']}}}" in text("README.md")  # as in the BibTeX


def test_ci_calls_every_target_of_make():
    words = re.findall(r"^make (.*)$", text(".ci/run"), re.MULTILINE)
    called = [target for line in words for target in line.split() if not target.startswith("--")]
    assert len(called) == len(set(called))
    assert set(called) == make_targets() - NOT_IN_CI
    assert make_targets() >= NOT_IN_CI


def test_every_target_of_make_is_phony():
    """If not, a file or folder of that name, such as docs, would keep it from running."""
    assert set(re.search(r"^\.PHONY: (.*)$", text("Makefile"), re.MULTILINE)[1].split()) == make_targets()


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", ".github/pull_request_template.md", ".github/workflows/test.yml"])
def test_targets_in_pages_exist(page):
    commands = re.findall(r"(?:`|run: |^ *)make ([a-z ]*[a-z])", text(page), re.MULTILINE)
    assert commands
    assert {target for command in commands for target in command.split()} <= make_targets()


def test_ci_does_not_touch_the_checkout():
    script = text(".ci/run")
    assert script.index("git clone") < script.index("<!-- test command -->")
    assert re.findall(r"rm -rf (\S+)", script) == ['"$work"\'']


@pytest.mark.parametrize("name", YAML_FILES)
def test_yaml_files_can_be_read(name):
    assert isinstance(yaml.safe_load(text(name)), dict)


def test_workflows_run_the_oldest_python():
    oldest = tomllib.loads(text("pyproject.toml"))["project"]["requires-python"].removeprefix(">=")
    workflow = yaml.safe_load(text(".github/workflows/test.yml"))
    steps = [step for job in workflow["jobs"].values() for step in job["steps"]]
    assert oldest in {step["with"]["python-version"] for step in steps if "python-version" in step.get("with", {})}


def test_a_platform_that_fails_stops_no_release():
    jobs = yaml.safe_load(text(".github/workflows/wheels.yml"))["jobs"]
    assert jobs["platforms"]["strategy"]["fail-fast"] is False
    assert "platforms" in jobs["publish"]["needs"]  # it waits for the wheels
    assert "!cancelled() && needs.install.result == 'success'" in jobs["publish"]["if"]


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "SECURITY.md", "CODE_OF_CONDUCT.md"])
def test_files_that_are_linked_exist(page):
    for link in re.findall(r"\]\((?!http)([^)#]+)", text(page)):
        assert (ROOT / link).exists(), link


def test_files_of_the_tour_exist():
    page = text("CONTRIBUTING.md")
    tour = page[page.index("## The ten-minute tour") : page.index("## Add a format")]
    paths = set(re.findall(r"`([a-z_/]+(?:/|\.py))`", tour))
    assert {"joint.py", "images/", "cloud/", "views/", "segments/", "labels/"} <= paths
    places = [ROOT, ROOT / "torchjoint", ROOT / "torchjoint" / "segments"]
    assert {path for path in paths if not any((place / path).exists() for place in places)} == set()


@pytest.mark.slow
def test_the_program_that_judges_a_change_runs(capsys):
    program = re.search(r"```python\n(  from dataclasses.*?)```", text("CONTRIBUTING.md"), re.DOTALL)[1]
    names = {}
    exec(compile(re.sub(r"^  ", "", program, flags=re.MULTILINE), "CONTRIBUTING.md", "exec"), names)
    assert names["scores"].shape == (4, 2)
    assert (names["scores"].std(0) > 0).all()  # moved points do change labels


def test_no_test_has_a_long_name():
    files = [*ROOT.glob("tests/**/*.py"), *ROOT.glob("lab/tests/**/*.py")]
    names = [name for file in files for name in re.findall(r"def (test_\w+)", file.read_text(encoding="utf-8"))]
    assert len(names) > 1000
    assert [name for name in names if len(name) > 60] == []
