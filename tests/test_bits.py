"""The same bits whatever the number of threads and the order of work."""

from __future__ import annotations

import subprocess
import sys

import pytest
import torch

import torch_mcaa as mcaa
from torch_mcaa.arguments import task_of
from torch_mcaa.grid import Screen

PROGRAM = """
import hashlib, sys, torch, torch_mcaa as mcaa
torch.set_num_threads(int(sys.argv[1]))
def f(x, y):
    return torch.atan2(y - 150, x - 140), torch.sigmoid(0.1 * (x - y)) ** 1.7, (torch.hypot(x - 150, y - 150) < 99).float()
digest = hashlib.sha256()
for estimator in (mcaa.Auto(), mcaa.JumpCorrected(), mcaa.Shared(), mcaa.Shared(replicates=2), mcaa.Shared(mcaa.Sobol()), mcaa.Importance()):
    for size in ((301, 287), (33, 70)):
        if size[0] > 100 and estimator not in (mcaa.Auto(), mcaa.Shared(), mcaa.Importance()):
            continue
        picture = mcaa.render(f, size, estimator=estimator, spp=9)
        for plane in (picture.image, picture.stderr, picture.spp):
            digest.update(plane.numpy().tobytes())
def dense(x, y):
    return torch.remainder(torch.floor((0.8 * x + 0.6 * y) / 5) + torch.floor((0.8 * y - 0.6 * x) / 5), 2)
for picture in (mcaa.render(dense, (97, 110), spp=15), mcaa.render(f, (130, 140), spp=40, tolerance=2e-3)):
    digest.update(picture.image.numpy().tobytes())
print(digest.hexdigest())
"""


def test_threads_do_not_change_a_bit():
    """Functions whose last bits depend on where a loop is cut, under 1, 2, 3 and 8 threads."""
    digests = set()
    for threads in (1, 2, 3, 8):
        run = subprocess.run([sys.executable, "-c", PROGRAM, str(threads)], capture_output=True, text=True, check=True)
        digests.add(run.stdout.strip())
    assert len(digests) == 1


@pytest.mark.parametrize(
    "chosen", [mcaa.Auto(), mcaa.JumpCorrected(), mcaa.Shared(), mcaa.Shared(mcaa.Jittered()), mcaa.Importance()], ids=repr
)
@pytest.mark.parametrize("boundary", ["extend", "zero", "renormalize"])
def test_order_of_work_does_not_change_a_bit(chosen: mcaa.Auto, boundary: str):
    """Cells backwards, each by a new round, are the picture's cells."""

    def f(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        return torch.atan2(y - 100, x - 90)

    size = (300, 270) if chosen in (mcaa.Auto(), mcaa.Shared()) else (70, 90)
    picture = mcaa.render(f, size, estimator=chosen, boundary=boundary, spp=7, seed=5)  # type: ignore[arg-type]
    task = task_of(f, Screen.of(size), mcaa.Gaussian(0.5), boundary, "raise", 5, torch.float32, None)
    with torch.no_grad():
        for cell in reversed(list(task.screen.cells(*chosen.cell(task, 16, False)))):
            estimate = chosen.round(task, 7, 0).estimate(cell)
            assert torch.equal(estimate.value, picture.image[(slice(None), *cell.window)])
            assert torch.equal(estimate.variance.sqrt(), picture.stderr[(slice(None), *cell.window)])
            assert torch.equal(estimate.points, picture.spp[cell.window])
