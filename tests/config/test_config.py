import dataclasses
import re

import pytest
import yaml

import torchjoint as tj
from torchjoint.config import Config, PaperConfig, PropagationConfig, RefinementConfig, SuperpointsConfig, presets


def test_presets_load_and_round_trip():
    assert set(presets()) == {"default", "paper", "scan"}
    for name in presets():
        config = Config.from_preset(name)
        assert Config.from_dict(yaml.safe_load(yaml.safe_dump(config.to_dict()))) == config


def test_the_default_preset_is_the_default():
    assert Config.from_preset("default") == Config()


def test_the_paper_preset_is_the_letter():
    paper = Config.from_preset("paper")
    assert paper.paper.normalization == "all"
    assert paper.paper.convex_factor == 1
    assert paper.paper.color_weight == 0
    assert paper.paper.merge_ratio is not None
    assert paper.paper.split_min_edges is not None
    assert paper.point_segments.method == "paper"
    assert not paper.contours.closed
    assert paper.visibility.method == "hidden_point_removal"


def test_each_preset_has_its_method_of_step_6():
    methods = {name: Config.from_preset(name).point_segments.method for name in presets()}
    assert methods == {"default": "auto", "scan": "scan", "paper": "paper"}


def test_the_default_reads_few_parameters():
    """Those of method paper come last, in a stage of their own."""
    *stages, last = Config.stages().items()
    assert last == ("paper", PaperConfig)
    assert sum(len(dataclasses.fields(stage)) for _, stage in stages) <= 20


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"propagashun": {}}, r"propagashun: unknown stage, expected one of boundary, "),
        ({"propagation": {"wieght": 1}}, r"propagation\.wieght: unknown parameter, expected one of window"),
        ({"propagation": 3}, r"propagation: expected parameters by name, got 3"),
        ({"paper": {"weight": -1}}, r"paper\.weight: expected >= 0, got -1"),
        ({"paper": {"weight": 1001}}, r"paper\.weight: expected <= 1000, got 1001"),
        ({"paper": {"weight": "much"}}, r"paper\.weight: expected float, got 'much'"),
        ({"paper": {"weight": True}}, r"paper\.weight: expected float, got True"),
        ({"paper": {"weight": None}}, r"paper\.weight: expected float, got null"),
        ({"paper": {"weight": float("nan")}}, r"paper\.weight: expected a finite number, got nan"),
        ({"propagation": {"window": 2.5}}, r"propagation\.window: expected a whole number, got 2\.5"),
        ({"propagation": {"window": 4}}, r"propagation\.window: expected an odd number, got 4"),
        ({"paper": {"overlap_threshold": 1.5}}, r"paper\.overlap_threshold: expected <= 1, got 1\.5"),
        ({"visibility": {"method": "magic"}}, r"visibility\.method: expected one of zbuffer, hidden.*, got 'magic'"),
        (
            {"point_segments": {"method": "magic"}},
            r"point_segments\.method: expected one of auto, learned, scan, paper, NAME\.npz, got",
        ),
        ({"paper": {"split_min_edges": 0}}, r"paper\.split_min_edges: expected >= 1, got 0"),
        ({"visibility": {"depth_tolerance": 0}}, r"visibility\.depth_tolerance: expected > 0, got 0"),
        ({"scan": {"min_size": 2.5}}, r"scan\.min_size: expected a whole number, got 2\.5"),
        ({"point_graph": {"neighbors": 0}}, r"point_graph\.neighbors: expected >= 1, got 0"),
    ],
)
def test_bad_values_are_refused_by_name(values, message):
    with pytest.raises((ValueError, TypeError), match=message):
        Config.from_dict(values)


def test_a_stage_of_another_kind_is_refused():
    with pytest.raises(TypeError, match="propagation: expected a PropagationConfig, got RefinementConfig"):
        Config(propagation=RefinementConfig())  # type: ignore[arg-type]


def test_values_are_what_they_are_declared():
    assert isinstance(PaperConfig(weight=1).weight, float)
    assert isinstance(PropagationConfig(window=5.0).window, int)  # type: ignore[arg-type]
    assert PaperConfig(merge_ratio=None).merge_ratio is None


def test_set_as_on_the_command_line():
    config = Config().set(["paper.weight=0.25", "paper.merge_ratio=null", "visibility.method=zbuffer"])
    assert config.paper.weight == 0.25
    assert config.paper.merge_ratio is None
    for bad in ("paper.weight", "weight=3", "=3"):
        with pytest.raises(ValueError, match=r"expected stage\.parameter=value"):
            Config().set([bad])


def test_numbers_as_people_write_them():
    assert Config().set(["paper.weight=1e-3"]).paper.weight == 0.001
    assert Config().set(["scan.min_size=010"]).scan.min_size == 10
    for text in ("[", "1:30", "1:30.5", "0x10"):
        with pytest.raises(ValueError, match=rf"paper\.weight: expected a value, got '{re.escape(text)}'"):
            Config().set([f"paper.weight={text}"])


def test_yaml_errors_name_the_file(tmp_path):
    file = tmp_path / "mine.yaml"
    for text, message in (
        ("paper: {weight: -1}", r"mine\.yaml: paper\.weight: expected >= 0"),
        ("- 1\n- 2", r"mine\.yaml: expected stages with parameters, got a list"),
        ("a: [", r"mine\.yaml: not valid YAML"),
        ("a: 2026-99-99", r"mine\.yaml: not valid YAML"),
        ("a: !!timestamp x", r"mine\.yaml: not valid YAML"),
        ("a: !!bool x", r"mine\.yaml: not valid YAML"),
        ("paper: {weight: 1, weight: 2}", r"mine\.yaml: not valid YAML: the name 'weight' is there twice"),
    ):
        file.write_text(text)
        with pytest.raises(ValueError, match=message):
            Config.from_yaml(file)
    file.write_text("")
    assert Config.from_yaml(file) == Config()


def test_unknown_preset():
    with pytest.raises(ValueError, match=r"preset: expected one of default, paper, scan.*got 'nope'"):
        Config.from_preset("nope")


def test_every_parameter_is_declared_with_a_text():
    for stage in Config.stages().values():
        for spec in dataclasses.fields(stage):
            assert len(spec.metadata["doc"]) > 10, f"{stage.__name__}.{spec.name}"


def test_configs_are_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        Config().paper.weight = 3  # type: ignore[misc]


def test_aliases_cannot_blow_up_a_value(tmp_path):
    """Each level is ten times the one before; its error message alone had 40 MB for seven levels."""
    value = "&a0 [x, x, x, x, x, x, x, x, x, x]"
    for level in range(1, 3):
        value = f"&a{level} [{value}{f', *a{level - 1}' * 9}]"
    (tmp_path / "bomb.yaml").write_text(f"boundary: {{detector: {value}}}")
    with pytest.raises(ValueError, match=r"bomb\.yaml: not valid YAML: expected a value, got an alias") as caught:
        Config.from_yaml(tmp_path / "bomb.yaml")
    assert len(str(caught.value)) < 1000
    with pytest.raises(ValueError, match=r"boundary\.detector: expected a value, got"):
        Config().set([f"boundary.detector={value}"])


def test_a_file_that_is_nested_too_deeply(tmp_path):
    (tmp_path / "deep.yaml").write_text("[" * 10_000)
    with pytest.raises(ValueError, match=r"deep\.yaml"):
        Config.from_yaml(tmp_path / "deep.yaml")


@pytest.mark.parametrize(
    "made",
    [tj.JointSegmenter, tj.LiveSegmenter, tj.Superpoints, tj.transforms.AddSuperpoints],
    ids=lambda one: one.__name__,
)
def test_a_config_is_not_changed_afterwards(made):
    """Some steps had the old parameters, some the new ones, in silence."""
    one = made()
    with pytest.raises(AttributeError, match="config"):
        one.config = one.config
    assert one.config == (Config() if "Segmenter" in made.__name__ else SuperpointsConfig())
