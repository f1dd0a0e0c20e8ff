"""The torchmetrics class of ScanNet's average precision: it accumulates what the function gives."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from torchmetrics import Metric, MetricCollection

from torchjoint import metrics
from torchjoint.metrics import ScannetAveragePrecisionMetric, scannet_average_precision

SIZE, LEAST = 400, 20


def sample(seed):
    """A prediction, and a truth with void, of SIZE points."""
    generator = torch.Generator().manual_seed(seed)
    target = torch.randint(-1, 6, (SIZE // 40,), generator=generator).repeat_interleave(40)
    target[0] = 0
    pred = torch.where(
        torch.rand(SIZE, generator=generator) < 0.3, torch.randint(7, (SIZE,), generator=generator), target
    )
    return pred.roll(3), target


SAMPLES = [sample(seed) for seed in range(5)]


def fed(samples):
    metric = ScannetAveragePrecisionMetric(LEAST)
    for one in samples:
        metric.update(*one)
    return metric


def test_the_names():
    assert set(metrics.__all__) <= set(dir(metrics))
    with pytest.raises(AttributeError, match="has no attribute 'Nonsense'"):
        _ = metrics.Nonsense


def test_of_one_sample_it_is_the_function():
    assert fed(SAMPLES[:1]).compute() == scannet_average_precision(*SAMPLES[0], min_size=LEAST)


def test_life_of_a_metric():
    """Calls give the value of the sample alone; copies, pickles and merged parts are as good as the whole; reset."""
    expected, metric = fed(SAMPLES).compute(), ScannetAveragePrecisionMetric(LEAST)
    assert isinstance(metric, Metric)
    for one in SAMPLES[:3]:
        assert metric(*one) == fed([one]).compute()
    metric = pickle.loads(pickle.dumps(metric))
    copy = metric.clone().set_dtype(torch.float32)
    copy.compute()
    copy.merge_state(fed(SAMPLES[3:]))
    for one in SAMPLES[3:]:
        metric.update(*one)
    assert metric.compute() == metric.compute() == pytest.approx(expected, abs=1e-12)
    assert copy.compute() == pytest.approx(expected, abs=1e-6)
    metric.reset()
    metric.update(*SAMPLES[1])
    assert metric.compute() == fed(SAMPLES[1:2]).compute()


def test_metrics_with_other_options_do_not_merge():
    metric, other = fed(SAMPLES[:1]), ScannetAveragePrecisionMetric(LEAST + 10)
    other.update(*SAMPLES[1])
    for state in (other, other.metric_state):
        with pytest.raises(ValueError, match=r"min_size: expected metrics with the same one, got \[30, 20\]"):
            metric.merge_state(state)
    assert metric.compute() == fed(SAMPLES[:1]).compute()


def test_nothing_to_compute():
    with (
        pytest.warns(UserWarning, match="was called before the ``update`` method"),
        pytest.raises(ValueError, match="ScannetAveragePrecisionMetric: expected an update before compute, got none"),
    ):
        ScannetAveragePrecisionMetric().compute()


def test_a_bad_sample_is_refused_and_leaves_no_trace():
    metric = fed(SAMPLES[:2])
    before = metric.compute()
    with pytest.raises(ValueError, match="nothing but -1"):
        metric.update(SAMPLES[0][0], torch.full((SIZE,), -1))
    assert metric.compute() == before


def test_bad_options():
    with pytest.raises(ValueError, match="min_size: expected"):
        ScannetAveragePrecisionMetric(min_size=0)


def test_a_collection_does_not_take_one_for_another():
    """torchmetrics updates only one of those whose states are alike after the first sample, here a perfect one."""
    first = SAMPLES[0][1], SAMPLES[0][1]
    collection = MetricCollection({str(least): ScannetAveragePrecisionMetric(least) for least in (LEAST, LEAST + 10)})
    for one in (first, *SAMPLES):
        collection.update(*one)
    found = collection.compute()
    assert found[str(LEAST)] == fed([first, *SAMPLES]).compute()
    assert found[str(LEAST)] != found[str(LEAST + 10)]


#: Two processes, the second a fork; the first has the first SHARE samples, the second, which may have none, the rest.
PROCESSES = """
import os, sys
from torch import distributed
from test_modules import SAMPLES, fed

expected = fed(SAMPLES).compute()
other = os.fork()
rank = 0 if other else 1
distributed.init_process_group("gloo", init_method=f"file://{sys.argv[1]}", rank=rank, world_size=2)
for share in (3, 5):
    metric = fed(SAMPLES[:share] if rank == 0 else SAMPLES[share:])
    for _ in range(2):  # the second time from what the first left
        found = metric.compute()
        assert max(abs(a - b) for a, b in zip(found, expected, strict=True)) < 1e-12, (share, found)
        metric._computed = None
distributed.destroy_process_group()
if other:
    assert os.waitpid(other, 0)[1] == 0
"""


@pytest.mark.slow  # `merge_state` in test_life_of_a_metric adds up the same states in one process
def test_states_add_up_over_processes(tmp_path):
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path]),
        "OMP_NUM_THREADS": "1",  # threads do not survive a fork
    }
    subprocess.run([sys.executable, "-c", PROCESSES, tmp_path / "meeting"], env=environment, check=True, timeout=600)
