"""The torchmetrics classes: they accumulate what the functions give."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path
from statistics import fmean

import pytest
import torch
from metric_samples import ALL, MEANS, SAMPLES, SIZE, fed, made, numbers
from torchmetrics import Metric, MetricCollection

from torchjoint import metrics


def test_every_class_is_tested():
    assert {name for name in metrics.__all__ if name.endswith("Metric")} == set(ALL)
    assert set(metrics.__all__) <= set(dir(metrics))
    with pytest.raises(AttributeError, match="has no attribute 'Nonsense'"):
        _ = metrics.Nonsense


@pytest.mark.parametrize("name", MEANS)
def test_it_is_the_mean_of_the_samples(name):
    function, options, more = ALL[name]
    values = [numbers(function(*one, *more, **options)) for one in SAMPLES]
    assert len(set(values)) > 1
    result = fed(name, SAMPLES).compute()
    assert numbers(result) == pytest.approx([fmean(column) for column in zip(*values, strict=True)], abs=1e-12)
    kind = type(function(*SAMPLES[0], *more, **options))
    assert type(result) is (torch.Tensor if kind is float else kind)


def test_f_is_averaged_and_not_made_of_averages():
    result = fed("ObjectsAndPartsMetric", SAMPLES).compute()
    assert result.f < 2 * result.precision * result.recall / (result.precision + result.recall) - 1e-4


@pytest.mark.parametrize("name", ALL)
def test_of_one_sample_it_is_the_function(name):
    function, options, more = ALL[name]
    assert numbers(fed(name, SAMPLES[:1]).compute()) == numbers(function(*SAMPLES[0], *more, **options))


@pytest.mark.parametrize("name", ALL)
def test_life_of_a_metric(name):
    """Calls give the value of the sample alone; copies, pickles and merged parts are as good as the whole; reset."""
    more = ALL[name][2]
    expected = numbers(fed(name, SAMPLES).compute())
    metric = made(name)
    assert isinstance(metric, Metric)
    for one in SAMPLES[:3]:
        assert numbers(metric(*one, *more)) == numbers(fed(name, [one]).compute())
    metric = pickle.loads(pickle.dumps(metric))
    copy = metric.clone()
    copy.merge_state(fed(name, SAMPLES[3:]))
    for one in SAMPLES[3:]:
        metric.update(*one, *more)
    assert numbers(metric.compute()) == numbers(metric.compute()) == pytest.approx(expected, abs=1e-12)
    assert numbers(copy.compute()) == pytest.approx(expected, abs=1e-12)
    metric.reset()
    metric.update(*SAMPLES[1], *more)
    assert numbers(metric.compute()) == numbers(fed(name, SAMPLES[1:2]).compute())


@pytest.mark.parametrize("name", ALL)
def test_nothing_to_compute(name):
    with (
        pytest.warns(UserWarning, match="was called before the ``update`` method"),
        pytest.raises(ValueError, match=f"{name}: expected an update before compute, got none"),
    ):
        made(name).compute()


@pytest.mark.parametrize("name", ALL)
def test_a_bad_sample_is_refused_and_leaves_no_trace(name):
    metric = fed(name, SAMPLES[:2])
    before = numbers(metric.compute())
    with pytest.raises(ValueError, match="nothing but -1"):
        metric.update(SAMPLES[0][0], torch.full((SIZE,), -1), *ALL[name][2])
    assert numbers(metric.compute()) == before


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("ObjectsAndPartsMetric", {"gamma_part": 0.9}, "gamma_part: expected"),
        ("AveragePrecisionObjectsMetric", {"gamma_part": 0.6}, "gamma_part: expected"),
        ("AveragePrecisionPartsMetric", {"gamma_object": 0.6}, "gamma_part: expected"),
        ("BoundaryRecallMetric", {"tolerance": -1}, "tolerance: expected"),
        ("ScannetAveragePrecisionMetric", {"min_size": 0}, "min_size: expected"),
    ],
)
def test_bad_options(name, options, message):
    with pytest.raises(ValueError, match=message):
        getattr(metrics, name)(**options)


def test_in_a_collection():
    names = ("SegmentationCoveringMetric", "MeanBestIoUMetric", "ScannetAveragePrecisionMetric")
    collection = MetricCollection([made(name) for name in names])
    for one in SAMPLES:
        collection.update(*one)
    found = collection.compute()
    assert set(found) == set(names)
    for name, value in found.items():
        assert numbers(value) == numbers(fed(name, SAMPLES).compute())


def test_a_collection_does_not_take_one_for_another():
    """torchmetrics updates only one of those whose states are alike after the first sample, here a perfect one."""
    first = SAMPLES[0][1], SAMPLES[0][1]
    collection = MetricCollection(
        {
            **{name: made(name) for name in ALL if name != "BoundaryRecallMetric"},
            "other objects": metrics.ObjectsAndPartsMetric(gamma_object=0.9),
            "other instances": metrics.ScannetAveragePrecisionMetric(min_size=30),
            "the same": made("MeanBestIoUMetric"),
        }
    )
    for one in (first, *SAMPLES):
        collection.update(*one)
    found = collection.compute()
    assert numbers(found["other objects"]) != numbers(found["ObjectsAndPartsMetric"])
    assert numbers(found["other instances"]) != numbers(found["ScannetAveragePrecisionMetric"])
    assert found["the same"] == found["MeanBestIoUMetric"]
    for name in set(ALL) & set(found):
        assert numbers(found[name]) == numbers(fed(name, [first, *SAMPLES]).compute()), name


#: Two processes, the second a fork; the first has the first SHARE samples, the second, which may have none, the rest.
PROCESSES = """
import os, sys
from torch import distributed
from metric_samples import ALL, SAMPLES, fed, numbers

expected = {name: numbers(fed(name, SAMPLES).compute()) for name in ALL}
other = os.fork()
rank = 0 if other else 1
distributed.init_process_group("gloo", init_method=f"file://{sys.argv[1]}", rank=rank, world_size=2)
for share in (3, 5):
    for name in ALL:
        metric = fed(name, SAMPLES[:share] if rank == 0 else SAMPLES[share:])
        for _ in range(2):  # the second time from what the first left
            found = numbers(metric.compute())
            assert max(abs(a - b) for a, b in zip(found, expected[name], strict=True)) < 1e-12, (name, share, found)
            metric._computed = None
distributed.destroy_process_group()
if other:
    assert os.waitpid(other, 0)[1] == 0
"""


@pytest.mark.slow  # `merge_state` in test_life_of_a_metric adds up the same states in one process
def test_states_add_up_over_processes(tmp_path):
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[1]), *sys.path]),
        "OMP_NUM_THREADS": "1",  # threads do not survive a fork
    }
    subprocess.run([sys.executable, "-c", PROCESSES, tmp_path / "meeting"], env=environment, check=True, timeout=600)
