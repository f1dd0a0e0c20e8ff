"""torchjoint-lab train-boundary-model: trains the model of step 6, method learned, on labelled or generated scenes."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import tyro

from torchjoint.cli.arguments import output_file
from torchjoint.runtime.outputs import work_folder
from torchjoint.scene import Scene
from torchjoint_lab.cli.arguments import check_max_frames

if TYPE_CHECKING:
    from torchjoint_lab.training.boundary_examples import LabelledEvidence
    from torchjoint_lab.training.boundary_model import RoundScores


class _Source(NamedTuple):
    """A scene that is made or read when it is needed."""

    name: str
    kind: str  # the domain; "" for scenes of one's own
    key: str  # tells it from others, and from an earlier version of itself
    load: Callable[[], Scene]


def train_boundary_model(
    scenes: tyro.conf.Positional[tuple[Path, ...]] = (),
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("boundaries.npz"),
    domains: tuple[str, ...] = (),
    seeds: tuple[int, ...] = (0, 14),
    models: Path | None = None,
    thin: float | None = None,
    varied: tuple[float, ...] = (0.5,),
    max_frames: int | None = None,
    trees: int = 60,
    folds: int = 4,
    members: int = 5,
    seed: int = 0,
    overwrite: bool = False,
) -> None:
    """Trains the model that judges boundaries between regions of points; an interrupted run continues.

    The evidence of each scene is saved in OUT.partial until the model is complete.

    Args:
        scenes: labelled scenes of your own, or data sets of them; docs/your_data.md lists the formats.
        out: file for the model, NAME.npz.
        domains: also train on generated scenes of these domains: table, shelf, bin, desk, kitchen, room, workshop.
        seeds: first seed of the generated scenes, and the seed after the last one; `0 10 14 37`: also a second range.
        models: folder of 3D models for the generated scenes, as for `make_domain_scene`.
        thin: keep one point of your own scenes in each voxel of this size, metres.
        varied: the probability that points of a scene are moved, added or left out, and the same for its colours: other
            light, noise, grey; and that it has no frames. Each number gives MEMBERS models.
        max_frames: use at most so many frames of each of your own scenes, evenly spread.
        trees: number of trees in each round of merging of each member.
        folds: parts of the scenes, if they are of one domain, or all your own; else each domain is a part. Each part is
            judged by trees that were trained on the others.
        members: number of models of each number of VARIED, trained with seeds from SEED on: five err less than one.
        seed: of all random choices; the same seed makes the same file.
        overwrite: replace OUT if it exists.
    """
    from torchjoint.segments.learned.boundary_model import BoundaryModel
    from torchjoint_lab import training

    check_max_frames(max_frames)
    if not varied or not all(0 <= share <= 1 for share in varied):
        raise ValueError(f"--varied: expected numbers from 0 to 1, got {' '.join(map(str, varied)) or 'none'}")
    if out.suffix != ".npz":
        raise ValueError(f"-o: expected a name that ends in .npz, got {out}")
    made = output_file(out, overwrite, (*scenes, models))
    options = training.BoundaryModelOptions(trees=trees, folds=folds, members=members, seed=seed)
    sources = [*_own(scenes, thin, max_frames), *_generated(domains, seeds, models)]
    if len(sources) < 2:
        raise ValueError(f"scenes: expected at least two, in SCENES or by --domains, got {len(sources)}")
    begin = time.perf_counter()
    folder = _folder(out, sources, varied)
    prepared = [_prepare(folder, sources, place, share) for place, share in enumerate(varied)]
    fit = partial(training.fit_boundary_model, kinds=[one.kind for one in sources], report=_print_scores, progress=True)
    trained = [fit(one, options) for one in prepared]
    model = BoundaryModel(tuple(member for one in trained for member in one.members))
    with made.written() as path:
        training.save_boundary_model(path, model)
        training.load_boundary_model(path)
    shutil.rmtree(folder)
    print(
        f"{len(model.members)} models of {len(model.thresholds)} rounds from {len(sources)} scenes "
        f"in {time.perf_counter() - begin:.0f} s: {out}, {out.stat().st_size / 1e6:.1f} MB"
    )


def _own(paths: Sequence[Path], thin: float | None, max_frames: int | None) -> list[_Source]:
    from torchjoint.scene.scene import voxel_subsample
    from torchjoint_lab.datasets.scenes import list_scenes, load_scene

    def load(path: Path) -> Scene:
        scene = load_scene(path)
        if thin is not None:
            scene = scene.select_points(voxel_subsample(scene.points, thin))
        return scene if max_frames is None else scene.sample_frames(max_frames)

    if thin is not None and not thin > 0:
        raise ValueError(f"--thin: expected more than 0 metres, got {thin}")
    found = [item for path in paths for item in list_scenes(path).items()]
    return [
        _Source(
            name,
            "",
            f"{path.absolute()} {path.stat().st_mtime_ns} {thin} {max_frames}",
            lambda path=path: load(path),  # type: ignore[misc]
        )
        for name, path in found
    ]


def _generated(domains: Sequence[str], seeds: Sequence[int], models: Path | None) -> list[_Source]:
    from torchjoint_lab.synthetic import DOMAINS, make_domain_scene

    known = [domain for domain in DOMAINS if domain != "street"]  # method scan segments streets
    for domain in domains:
        if domain not in known:
            raise ValueError(f"--domains: expected some of {', '.join(known)}, got {domain!r}")
    if len(seeds) % 2 or list(seeds) != sorted(set(seeds)) or min(seeds, default=0) < 0:
        raise ValueError(f"--seeds: expected ascending pairs 0 <= first < end, got {' '.join(map(str, seeds))}")
    return [
        _Source(
            f"{domain} {seed}",
            domain,
            f"{domain} {seed} {None if models is None else models.absolute()}",
            lambda domain=domain, seed=seed: make_domain_scene(domain, seed, models=models).scene,  # type: ignore[misc]
        )
        for domain in dict.fromkeys(domains)
        for first, end in zip(seeds[::2], seeds[1::2], strict=True)
        for seed in range(first, end)
    ]


def _folder(out: Path, sources: Sequence[_Source], shares: Sequence[float]) -> Path:
    """The folder with the evidence of these scenes; deletes that of other scenes."""
    from torchjoint_lab.training.boundary_examples import learned_config

    record = json.dumps(
        [version("torchjoint"), learned_config().to_dict(), list(shares), [source.key for source in sources]]
    )
    return work_folder(out.with_name(f"{out.name}.partial"), record)


def _prepare(folder: Path, sources: Sequence[_Source], place: int, share: float) -> Sequence[LabelledEvidence]:
    """Collects the evidence of all scenes that are not in the folder yet; returns it lazily, one file per scene."""
    from tqdm import tqdm

    from torchjoint_lab.training.boundary_examples import labelled_evidence
    from torchjoint_lab.training.superpoint_graph_files import SuperpointGraphFiles, save_evidence
    from torchjoint_lab.training.variation import varied

    paths = [folder / f"scene-{place}-{index:05d}.pt" for index in range(len(sources))]
    with tqdm(list(zip(sources, paths, strict=True)), desc="evidence", unit="scene") as bar:
        for source, path in bar:
            bar.set_postfix_str(source.name)
            if path.is_file():
                continue
            try:
                prepared = labelled_evidence(varied(source.load(), source.name, share))
            except ValueError as error:
                raise ValueError(f"{source.name}: {error}") from error
            save_evidence(path, prepared)
    return SuperpointGraphFiles(paths)


def _print_scores(scores: RoundScores) -> None:
    from tqdm import tqdm

    bins = ", ".join(
        f"{bin_.probability:.2f}: {bin_.share:.2f} ({bin_.boundaries})" for bin_ in scores.bins if bin_.boundaries
    )
    tqdm.write(
        f"merging up to {scores.threshold:g}: {scores.boundaries} boundaries, AUC {scores.auc:.3f}; probability before "
        f"calibration: share of borders (boundaries): {bins}"
    )
