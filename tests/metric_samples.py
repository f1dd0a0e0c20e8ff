"""The torchmetrics classes with their functions, and samples to feed them with."""

from __future__ import annotations

import torch

from torchjoint import metrics

SIZE = 400
CHAIN = torch.stack([torch.arange(SIZE - 1), torch.arange(1, SIZE)])


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

#: class and function of each measure that is a mean over samples, options of both, further arguments
MEANS = {
    "SegmentationCoveringMetric": (metrics.segmentation_covering, {}, ()),
    "ObjectsAndPartsMetric": (metrics.objects_and_parts, {"gamma_object": 0.6, "gamma_part": 0.2, "beta": 0.5}, ()),
    "MeanBestIoUMetric": (metrics.mean_best_iou, {}, ()),
    "AveragePrecisionObjectsMetric": (metrics.average_precision_objects, {"gamma_part": 0.3, "beta": 0.2}, ()),
    "AveragePrecisionPartsMetric": (metrics.average_precision_parts, {"gamma_object": 0.8, "beta": 0.2}, ()),
    "AchievableSegmentationAccuracyMetric": (metrics.achievable_segmentation_accuracy, {}, ()),
    "UndersegmentationErrorMetric": (metrics.undersegmentation_error, {}, ()),
    "BoundaryRecallMetric": (metrics.boundary_recall, {"tolerance": 0}, (CHAIN,)),
}
ALL = {**MEANS, "ScannetAveragePrecisionMetric": (metrics.scannet_average_precision, {"min_size": 20}, ())}


def made(name):
    return getattr(metrics, name)(**ALL[name][1])


def numbers(result):
    return tuple(float(value) for value in result) if isinstance(result, tuple) else (float(result),)


def fed(name, samples):
    metric = made(name)
    for one in samples:
        metric.update(*one, *ALL[name][2])
    return metric
