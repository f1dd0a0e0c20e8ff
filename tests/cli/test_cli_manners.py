"""Small things a person meets: versions, presets, pipes, interrupts, types."""

import dataclasses
import io
import os
import re
import signal
import subprocess
import sys

import numpy as np
import pytest
import torch
from folder_files import write_folder

import torchjoint as tj
from torchjoint.cli.arguments import output_file
from torchjoint.cli.main import COMMANDS
from torchjoint.config import presets
from torchjoint.datasets.formats import FORMATS
from torchjoint.datasets.fusion import fuse_cloud
from torchjoint.results.embeddings import Crop
from torchjoint.results.output_folder import output_folder

PROGRAM = "import sys; from torchjoint.cli import main; sys.argv = ['torchjoint', *sys.argv[1:]]; main()"


def test_version(run, capsys):
    with pytest.raises(SystemExit) as end:
        run("--version")
    assert end.value.code == 0
    assert capsys.readouterr().out == f"torchjoint {tj.__version__}\n"


@pytest.mark.parametrize("arguments", [("--help",), ("segment", "--help")])
def test_help_lists_the_presets(run, capsys, arguments):
    with pytest.raises(SystemExit):
        run(*arguments)
    text = " ".join(capsys.readouterr().out.split())
    assert " Example" in text
    for preset in presets():
        assert preset in text


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_an_example_and_names_values_as_the_text_does(run, capsys, command):
    with pytest.raises(SystemExit):
        run(command, "--help")
    text = " ".join(capsys.readouterr().out.split())
    assert "(default: None)" not in text
    assert "(default: False)" not in text
    assert "PATH" not in text
    assert "--no-overwrite" not in text
    assert not set(re.findall(r"\b(?:STR|INT|FLOAT)\b", text))
    assert f"Example: torchjoint {command} {COMMANDS[command].example}" in text


def test_help_behind_an_argument_is_that_of_the_command(run, capsys):
    with pytest.raises(SystemExit):
        run("edits", "import", "--help")
    assert "usage: torchjoint edits [-h] {import} RESULT FILE" in capsys.readouterr().out


@pytest.mark.slow
def test_closed_streams(tmp_path):
    """With `>&- 2>&-` Python has no streams, and files that a program opens would get their numbers."""
    np.savetxt(tmp_path / "a.xyz", np.random.default_rng(0).random((500, 3)))
    command = [sys.executable, "-c", PROGRAM, "batch", tmp_path / "a.xyz", "-o", tmp_path / "out"]
    done = subprocess.run(["sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh", *command])
    assert done.returncode == 0
    assert (tmp_path / "out" / "a" / "points.ply").is_file()


def test_a_folder_that_is_gone_is_one_line(run, tmp_path, monkeypatch):
    """Torch aborted the program, because it looked for its library there."""
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    with pytest.raises(SystemExit, match="error: the current folder was deleted; change to another one"):
        run("segment", tmp_path / "a.ply", "-o", tmp_path / "out")


def test_a_wrong_value_is_one_error(run, capsys):
    with pytest.raises(SystemExit):
        run("segment", "a", "--max-frames", "x")
    text = capsys.readouterr().err
    assert "--max-frames: invalid literal for int() with base 10: 'x'" in " ".join(text.replace("│", "").split())
    assert "None" not in text.replace("None: all", "")


@pytest.mark.slow
def test_a_result_has_a_name_by_default(run, scene_of, tmp_path, monkeypatch):
    write_folder(tmp_path / "kitchen", scene_of(0))
    monkeypatch.chdir(tmp_path)
    run("segment", "kitchen")
    assert (tmp_path / "kitchen-result" / "points.ply").is_file()
    run("label", "kitchen-result", "kitchen/cloud.ply")
    assert (tmp_path / "cloud-labelled.ply").is_file()
    run("batch", "kitchen", "--engine", "loky:1")
    assert (tmp_path / "results" / "kitchen" / "points.ply").is_file()


def test_parameters_of_one_stage(run, capsys):
    run("parameters", "paper")
    text = capsys.readouterr().out
    assert text.startswith("**`paper`**")
    assert text.count("**") == 2
    with pytest.raises(SystemExit, match="nope: unknown stage, expected one of boundary, "):
        run("parameters", "nope")


def test_a_terminal_without_the_letters_of_a_name(run, tmp_path, monkeypatch):
    """The work was done, and then the command failed."""
    np.save(tmp_path / "cloud.npy", np.random.default_rng(0).random((500, 3)))
    printed = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(printed, "ascii"))
    run("superpoints", tmp_path / "cloud.npy", "-o", tmp_path / "\u03c0.npy", "--no-picture")
    assert rb"\u03c0.npy" in printed.getvalue()


@pytest.mark.slow
def test_a_closed_pipe_is_no_error():
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, "parameters"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    process.stdout.close()
    assert process.stderr.read() == b""
    process.stderr.close()
    assert process.wait() == 141


def test_a_broken_pipe_to_a_worker_is_told(run, monkeypatch):
    """It ended as if the output were closed, without a word."""

    def breaks():
        raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.setattr("torchjoint.cli.arguments.formats", breaks)
    with pytest.raises(SystemExit, match=r"torchjoint: error: .*Broken pipe"):
        run("formats")


def test_an_interrupt_while_fusing_says_what_is_lost(run, scene_of, tmp_path, monkeypatch, capsys):
    recording = write_folder(tmp_path / "recording", scene_of(2), cloud=False)

    def interrupt(path, unit):
        raise KeyboardInterrupt

    monkeypatch.setattr("torchjoint.datasets.recording.read_depth", interrupt)
    with pytest.raises(SystemExit) as end:
        run("segment", recording, "-o", tmp_path / "out")
    assert end.value.code == 130
    assert re.search(r"interrupted; .*the cloud was being fused from depth; the next run", capsys.readouterr().err)


@pytest.mark.parametrize(
    ("message", "ends"),
    [("libtorch_cpu.so: failed to map segment from shared object", True), ("cannot import name 'x' from 'y'", False)],
)
def test_a_library_that_does_not_fit_in_memory_is_one_line(run, monkeypatch, message, ends):
    def fails(name):
        handlers.append(signal.getsignal(signal.SIGINT))
        raise ImportError(message)

    before, handlers = signal.getsignal(signal.SIGINT), []  # a shell's job behind ignores it
    monkeypatch.setattr(sys.modules["torchjoint.cli.main"], "import_module", fails)
    with pytest.raises(SystemExit if ends else ImportError, match="error: out of memory" if ends else message):
        run("segment", "x")
    assert handlers != [before]  # Ctrl-C: torch would abort, numpy raise another error
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize("cache", ["cache", ""])
def test_matplotlib_keeps_its_fonts_in_the_cache(run, tmp_path, monkeypatch, cache):
    monkeypatch.setenv("MPLCONFIGDIR", "")  # so that it is restored
    monkeypatch.delenv("MPLCONFIGDIR")
    monkeypatch.setenv("TORCHJOINT_CACHE", cache and str(tmp_path / cache))
    run("formats")
    assert os.environ.get("MPLCONFIGDIR") == (str(tmp_path / cache / "matplotlib") if cache else None)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: tj.JointSegmenter("paper"), r"config: expected a Config, got str; .*from_preset\('paper'\)"),
        (lambda: tj.JointSegmenter()(torch.rand(9, 3)), "scene: expected a Scene, got Tensor"),
        (lambda: tj.Scene(torch.rand(9, 3), [(1, 2)]), r"frames\[0\]: expected a Frame, got tuple"),
    ],
)
def test_wrong_types_are_named(call, message):
    with pytest.raises(TypeError, match=message):
        call()


def test_reprs_are_short(scene_of):
    synthetic = scene_of(2)
    scene = synthetic.scene
    assert repr(scene) == f"Scene({scene.name!r}: 3000 points, 6 frames, colors)".replace(
        "colors)", "colors, truth)" if scene.truth is not None else "colors)"
    )
    assert repr(synthetic) == f"SyntheticScene({scene!r}, {len(synthetic.instance_names)} instances)"
    assert repr(scene.frames[0]).startswith("Frame('frame-000000': 160 x 120 pixels")
    segmentation = tj.Segmentation(torch.tensor([0, 0, 1]), ())
    assert repr(segmentation) == "Segmentation(3 points in 2 segments, 0 images)"
    assert repr(tj.Result.of(segmentation, tj.Scene(torch.rand(3, 3)))).startswith("Result(3 points in 2 segments")
    crop = Crop(torch.rand(3, 4, 5), torch.ones(4, 5).bool(), (0, 0, 5, 4), 0, "a", pixels=20, whole=0.5)
    assert repr(crop) == "Crop('a': 5 x 4 pixels, 20 of the segment, 50% whole)"


def test_completion_offers_the_public_names():
    assert sorted(dir(tj)) == sorted([*tj.__all__, "__version__"])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_superpoints_of_numpy_arrays_are_a_numpy_array(scene_of, dtype):
    cloud = scene_of(2).scene
    points, colors = cloud.points.numpy().astype(dtype), (cloud.colors.numpy() * 255).round().astype(np.uint8)
    points.flags.writeable = False
    labels = tj.superpoints(points, colors)
    assert isinstance(labels, np.ndarray)
    np.testing.assert_array_equal(labels, tj.superpoints(torch.tensor(points), torch.from_numpy(colors)))


@pytest.mark.slow
def test_python_m_torchjoint_is_the_command() -> None:
    command = [sys.executable, "-m", "torchjoint", "--version"]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert printed == f"torchjoint {tj.__version__}\n"


def test_a_misspelt_command_is_guessed(run, capsys):
    with pytest.raises(SystemExit):
        run("segmnt", "recording")
    assert "no command 'segmnt'; did you mean 'segment'?" in capsys.readouterr().err


def test_formats_are_listed(run, capsys):
    run("formats")
    lines = capsys.readouterr().out.splitlines()
    assert any(line.split()[:2] == ["tum", "rgb.txt"] for line in lines)
    assert len(lines) == len(FORMATS)


def test_a_folder_that_cannot_be_written_is_named(tmp_path, monkeypatch):
    """Root may write everywhere, so the system's answer is replaced."""
    monkeypatch.setattr("torchjoint.results.output_folder.os.access", lambda path, mode: False)
    message = rf"{tmp_path}/out: the folder {tmp_path} cannot be written"
    with pytest.raises(PermissionError, match=message), output_folder(tmp_path / "out", "a test"):
        pass
    with pytest.raises(PermissionError, match=message):  # before the work of a command
        output_file(tmp_path / "out", False, ())


@pytest.mark.parametrize("suffix", [".npy", ".txt", ".xyz"])
def test_more_columns_than_colours(tmp_path, suffix):
    """As in `room_xyzrgbl.npy`: the label is left out with a word, the colours stay; normals are no colours."""
    rng = np.random.default_rng(0)
    rows = np.concatenate([rng.random((50, 3)), rng.integers(0, 256, (50, 3)), np.full((50, 1), 7)], 1)
    path = tmp_path / f"room{suffix}"

    def load(rows):
        np.save(path, rows) if suffix == ".npy" else np.savetxt(path, rows)
        return tj.load_scene(path)

    with pytest.warns(UserWarning, match=r"room\.\w+: of 7 columns, the first 6 are known, x y z r g b; the rest"):
        scene = load(rows)
    assert np.allclose(scene.colors.numpy(), rows[:, 3:6] / 255, atol=1e-6)
    rows[:, 3:6] = -0.5
    with pytest.warns(UserWarning, match="of 7 columns, the first 3 are known, x y z; the rest is left out"):
        assert load(rows).colors is None


def test_floating_colours_of_0_to_255_are_taken():
    points, colors = torch.rand(60, 3), torch.randint(0, 256, (60, 3)).float()
    with pytest.warns(UserWarning, match="colors: got values up to .*; taken as 0 to 255, and divided by 255"):
        scene = tj.Scene(points, colors=colors)
    assert torch.allclose(scene.colors, colors / 255)


@pytest.mark.parametrize(
    ("scale", "message"),
    [(1000, "got a median of 2000 .* probably millimetres"), (1e-3, "got a median of 0.002 .* probably metres where")],
)
def test_depth_in_another_unit(scene_of, scale, message):
    frames = [dataclasses.replace(f, depth=torch.full(f.size, 2.0 * scale)) for f in scene_of(3).scene.frames[:2]]
    with pytest.raises(ValueError, match=message):
        fuse_cloud(frames)


def test_equal_warnings_are_printed_once():
    code = f"""{PROGRAM}
import warnings
warnings.simplefilter("always")
for text in "aba":
    warnings.warn(text)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == "torchjoint: warning: a\ntorchjoint: warning: b\n"
