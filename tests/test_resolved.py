"""One lattice for a smooth f: which is chosen, what its own samples tell of its error, and what another sees that they cannot."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch

import torch_mcaa as mcaa
from torch_mcaa import scenes
from torch_mcaa.estimators import Task
from torch_mcaa.estimators.bandwidth import Bandwidth
from torch_mcaa.estimators.located.counted import Counted, Precision
from torch_mcaa.estimators.paper.suited import Suited, choose
from torch_mcaa.estimators.resolved import Grid, Resolved
from torch_mcaa.estimators.steepness import steepness_of
from torch_mcaa.grid import Cell, Screen
from torch_mcaa.integrand import Integrand
from torch_mcaa.patterns.nested import Nested, distances, nested

FILTER = mcaa.Gaussian(0.5, radius=4.0)
SIZE = 32
CELL = Cell(0, 0, SIZE, SIZE)
X, Y = 0.31, 0.74


def longest(count: int) -> Nested:
    return max((each for each in nested(count) if each.count == count), key=lambda each: float(each.dual[0] @ each.dual[0]))


def resolved(f: Callable, tolerance: float = 1e-3) -> tuple[Resolved, Grid, Counted]:
    task = Task(Screen.of((SIZE, SIZE)), Integrand(f, torch.float64), FILTER, "extend", 1, torch.float64, torch.device("cpu"))
    work = Resolved(task, Bandwidth(FILTER), mcaa.Tolerance(tolerance), 7)
    ask, side = Counted(task, CELL, 1 << 40, Precision()), SIZE + 2 * work.halo
    return work, Grid(X, Y, -work.halo, -work.halo, ask.everywhere(X, Y, Cell(-work.halo, -work.halo, side, side))), ask


def estimated(scene: Callable, lattice: Nested, truth: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Errors, and the standard errors that its own samples tell of, and that another lattice does, (h, w)."""
    work, grid, ask = resolved(scene)
    choice = Suited(lattice, np.zeros((1, 2)), np.zeros((2, 1)), 3.0, torch.tensor([16.0, 16.0]))
    value, variance, other, _ = work._estimate(CELL, [choice], grid, grid.planes(CELL, work.halo), ask)
    return value[0] - truth, (variance - other)[0].clamp_min(0).sqrt(), other[0].sqrt()


def exact(scene: scenes.Scene) -> torch.Tensor:
    centre = torch.arange(SIZE, dtype=torch.float64) + 0.5
    return scene.exact(centre[None], centre[:, None], FILTER)


@pytest.mark.parametrize("count", [1, 2, 5, 12, 16])
def test_lattices_hold_the_grid_and_their_duals_are_right(count: int) -> None:
    """As many as the divisors' sum says, of different points; k . p is whole for all dual k, and twice as fine ones begin alike."""
    some = [each for each in nested(count) if each.count == count]
    assert len(some) == sum(d for d in range(1, count + 1) if count % d == 0)
    for lattice in some:
        for each in (lattice, *lattice.finer()):
            points = np.stack([each.x, each.y])
            assert not points[:, 0].any() and points.min() >= 0 and points.max() < 1
            assert len({tuple(p) for p in points.T.round(9)}) == each.count == abs(round(np.linalg.det(each.dual)))
            assert np.abs(each.dual @ points - np.rint(each.dual @ points)).max() < 1e-9
        assert all((each.x[:count] == lattice.x).all() and each.count == 2 * count for each in lattice.finer())


def test_distances_are_those_of_a_search() -> None:
    tones = np.array([[0.3, 0.1], [1.9, -0.8], [4.1, 3.3]])
    for lattice in nested(10)[::7]:
        whole, half = distances([lattice], tones)
        index = np.stack(np.meshgrid(np.arange(-14, 15), np.arange(-14, 15)), -1).reshape(-1, 2)
        apart = np.linalg.norm(tones[:, None] - index @ lattice.dual / 2, axis=2)
        even = (index % 2 == 0).all(1)
        assert np.allclose(whole[0], apart[:, even & index.any(1)].min(1))
        assert np.allclose(half[0], apart[:, ~even].min(1))


@pytest.mark.parametrize("count", [1, 2, 5, 8])
def test_a_tone_errs_by_what_theory_says(count: int) -> None:
    """cos(2 pi v . p) becomes the sum of the filter's transform at v - k times cos(2 pi (v . p - k . (p - s))) over the dual vectors k, with the
    shift s; over the same for v = 0, since the weights sum to 1.
    """
    lattice, v = longest(count), np.array([0.21, 0.13])
    error, _, _ = estimated(lambda x, y: torch.cos(2 * math.pi * (v[0] * x + v[1] * y)), lattice, torch.zeros(SIZE, SIZE))
    k = np.stack(np.meshgrid(np.arange(-4, 5), np.arange(-4, 5)), -1).reshape(-1, 2) @ lattice.dual
    p = np.stack(np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5), -1)

    def summed(v: np.ndarray) -> np.ndarray:
        transform = np.exp(-2 * (math.pi * 0.5) ** 2 * ((v - k) ** 2).sum(1))
        return (transform * np.cos(2 * math.pi * ((p @ v)[..., None] - (p - np.array([X, Y])) @ k.T))).sum(2)

    # what the filter's cut leaves
    assert np.abs(error.numpy() - summed(v) / summed(0 * v)).max() < 1e-5


FEATURES: dict[str, Callable[[np.random.Generator], scenes.Scene]] = {
    "edge": lambda g: scenes.HalfPlane(g.uniform(0, 2 * math.pi), 16 + g.uniform(-2, 2)),
    "disc of 3 px": lambda g: scenes.Disc(g.uniform(10, 20), g.uniform(10, 20), 3.0),
    "dot of 1 px": lambda g: scenes.Disc(g.uniform(10, 20), g.uniform(10, 20), 1.0),
    "line of 0.5 px": lambda g: scenes.Stripe(g.uniform(0, 2 * math.pi), 16 + g.uniform(-2, 2), 0.5),
    "blob of 0.4 px": lambda g: scenes.Blob(g.uniform(10, 20), g.uniform(10, 20), 0.4),
}


@pytest.mark.parametrize("name", FEATURES)
def test_a_lattices_own_samples_tell_of_what_lies_between_them(name: str) -> None:
    """Of features that samples met: 8 places under 5 lattices, the largest error at most 2.5 times what is told (3 standard errors are what
    a normal error keeps), and where it is above 6 tolerances never taken for good.
    """
    generator = np.random.default_rng(5)
    for count in (1, 2, 4, 5, 8):
        for _ in range(8):
            scene = FEATURES[name](generator)
            error, own, _ = estimated(scene, longest(count), exact(scene))
            worst = float(error.abs().max())
            assert worst < 1e-3 or worst <= 2.5 * float(own.max())
            assert worst <= 6e-3 or float(own.max()) > 1e-3


def test_a_smooth_f_is_told_to_be_so() -> None:
    """A tone that the filter lets pass: nothing is told where its own standard error by the character sums of `Shared` would be 1e-1."""
    scene = scenes.Sinusoid(0.23, 0.11, 0.7)
    error, own, other = estimated(scene, longest(4), exact(scene))
    assert float(own.max()) < 1e-4 and float(other.max()) < 1e-4 and float(error.abs().max()) < 1e-4


def test_another_lattice_sees_what_lies_on_a_dual_vector() -> None:
    """A tone of (2, 0) is constant on 2 x 2 points a pixel: its own samples tell nothing, few pixels of a turned lattice all of it."""
    slow, fast = scenes.Sinusoid(0.11, 0.05, 0.2), scenes.Sinusoid(2.0, 0.0, 0.1)
    lattice = next(each for each in nested(4) if each.count == 4 and np.allclose(each.dual @ each.dual.T, 4 * np.eye(2)))
    truth = exact(slow) + 0.02 * exact(fast)
    error, own, other = estimated(lambda x, y: slow(x, y) + 0.02 * fast(x, y), lattice, truth)
    assert float(error.abs().max()) > 3e-3 and float(own.max()) < 1e-3
    assert float(other.min()) == pytest.approx(float(error.square().mean().sqrt()), rel=0.1)


def test_lattices_are_chosen_by_the_directions_of_f() -> None:
    """A tone of 0.92 cycles a pixel does with 3 points if these lie right, in whatever direction; two tones of that frequency do not."""

    def chosen(f: Callable) -> int:
        work, grid, ask = resolved(f)
        steep = steepness_of(ask, CELL, grid.planes(CELL, 0)[:, 0], 3)
        (found,) = choose(work.bandwidth, steep, torch.full_like(steep.mean, 1e-3), torch.ones(1, dtype=torch.bool))
        return 0 if found is None else found.lattice.count

    counts = []
    for turn in np.linspace(0, math.pi, 7)[:-1]:
        one, two = (scenes.Sinusoid(0.92 * math.cos(t), 0.92 * math.sin(t), 0.3) for t in (turn, turn + math.pi / 2))
        counts.append((chosen(one), chosen(lambda x, y, one=one, two=two: one(x, y) + two(x, y))))
    assert all(1 <= single <= 5 for single, _ in counts) and all(double == 0 or double >= 6 for _, double in counts)


@pytest.mark.parametrize("spp", [5, 6, 7, 9])
def test_the_cap_holds_where_lattices_are_tried(spp: int) -> None:
    """Tones of many frequencies, that some blocks' lattices are not enough for."""
    scene = scenes.ZonePlate(0.09, 20.3, 31.1)
    picture = mcaa.render(scene, (96, 96), filter=FILTER, spp=spp, tolerance=1e-5)
    assert picture.stopped == "spp" and float(picture.spp.double().mean()) <= spp


def test_what_is_random_is_not_resolved() -> None:
    generator = torch.Generator().manual_seed(3)
    with pytest.warns(mcaa.McaaWarning, match="random"):
        picture = mcaa.render(
            lambda x, y: 0.5 + 0.1 * torch.rand(x.shape, generator=generator, dtype=torch.float64), (64, 64), spp=64, tolerance=1e-2
        )
    assert float(picture.spp.double().mean()) > 3


def test_channels_are_resolved_together() -> None:
    """A slow and a fast one: both within the tolerance."""
    slow, fast = scenes.Sinusoid(0.05, 0.11, 0.2), scenes.Sinusoid(1.1, 0.7, 0.1)
    centre = torch.arange(64, dtype=torch.float64) + 0.5
    picture = mcaa.render(
        lambda x, y: (slow(x, y), fast(x, y)), (64, 64), filter=FILTER, spp=256, tolerance=1e-3, dtype=torch.float64
    )
    for plane, scene in zip(picture.image, (slow, fast), strict=True):
        error = plane - scene.exact(centre[None], centre[:, None], FILTER)
        assert float(error.square().mean().sqrt()) <= 1e-3 and float(error.abs().max()) <= 6e-3
    assert float(picture.spp.double().mean()) < 16
