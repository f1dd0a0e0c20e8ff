"""Networks of the caller's: run in evaluation mode, and given back in the modes in which they came."""

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
import torch
from torch import nn

import torchjoint as tj
from torchjoint.images.segmenter import ImageSegmenter, eval_mode
from torchjoint.runtime.messages import Stopwatch


class Network(nn.Module):
    """In train mode, but for a part that its owner has frozen. It notes the modes in which it runs."""

    def __init__(self, output):
        super().__init__()
        self.norm = nn.BatchNorm2d(3)
        self.frozen = nn.BatchNorm2d(3)
        self.output = output
        self.ran_in = []
        self.train()
        self.frozen.eval()

    def modes(self):
        return {name: part.training for name, part in self.named_modules()}

    def forward(self, images):
        self.ran_in.append(self.modes())
        return self.output(self.frozen(self.norm(images)))


FOUND = {"": True, "norm": True, "frozen": False}
ROLES = {
    "boundary": lambda images: images[:, 0].sigmoid(),
    "image_segmenter": lambda images: (images[:, 0] > 0.5).long(),
}


@pytest.fixture(scope="module")
def scene(scene_of):
    return scene_of(3).scene.select_frames([0, 1])


@pytest.mark.parametrize("role", ROLES)
def test_a_network_runs_in_eval_mode_and_is_found_in_its_own(scene, role):
    network = Network(ROLES[role])
    assert network.modes() == FOUND
    tj.JointSegmenter(**{role: network})(scene)
    assert network.ran_in
    assert all(not any(modes.values()) for modes in network.ran_in)
    assert network.modes() == FOUND
    assert int(network.norm.num_batches_tracked) == 0  # no statistics of the frames were taken


@pytest.mark.parametrize("role", ROLES)
def test_also_after_an_error(scene, role):
    def fails(images):
        raise KeyError("in the network")

    network = Network(fails)
    with pytest.raises(KeyError, match="in the network"):
        tj.JointSegmenter(**{role: network})(scene)
    assert network.modes() == FOUND


def test_threads_share_a_network(scene):
    """The first one to end set the network of the others to training mode, which also changed its statistics."""
    network, runs = Network(ROLES["boundary"]), []

    def output(images):
        runs.append(threads.submit(segmenter.detect, [scene.frames[1]], Stopwatch())) if not runs else None
        time.sleep(0.2)  # the other one begins, if it does not wait
        return ROLES["boundary"](images)

    network.output = output
    segmenter = ImageSegmenter(tj.Config(), boundary=network)
    with ThreadPoolExecutor() as threads:
        segmenter.detect([scene.frames[0]], Stopwatch())
        runs[0].result()
    assert network.ran_in == 2 * [dict.fromkeys(FOUND, False)]
    assert network.modes() == FOUND
    assert not network.norm.running_mean.any()


def test_a_detector_of_no_parts_is_used():
    """A list of modules without a member is false."""
    assert type(ImageSegmenter(tj.Config(), boundary=nn.ModuleList()).boundary) is nn.ModuleList


def test_a_network_in_eval_mode_stays_there():
    network = Network(torch.Tensor.clone).eval()
    with eval_mode(network):
        assert not any(network.modes().values())
    assert not any(network.modes().values())


def test_masks_leave_the_rest_of_the_image_to_the_pixel_graph(scene):
    frame, given = scene.frames[0], torch.zeros(1, *scene.frames[0].size, dtype=torch.bool)
    given[0, 20:60, 30:90] = True
    segmenter = ImageSegmenter(tj.Config())
    (own,), (found,) = (
        segmenter([replace(frame, masks=masks)], Stopwatch()) for masks in (None, tj.Masks.from_stack(given))
    )
    assert torch.equal(found.boundary, own.boundary)
    assert torch.equal(found.masks.stack(), given)
    assert len(found.labels[given[0]].unique()) == 1
    outside = torch.stack([found.labels[~given[0]], own.labels[~given[0]]])
    assert len(outside.unique(dim=1).T) == len(outside[0].unique()) == len(outside[1].unique()) > 5
