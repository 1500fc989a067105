"""Rendering to a tolerance: what rounds tell of one another, what it costs, and that it is met."""

from __future__ import annotations

import math

import pytest
import tolerance as benchmark
import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa import scenes
from torch_mcaa.edges.pilot import Verdict
from torch_mcaa.estimators import Estimate, Task
from torch_mcaa.estimators.bandwidth import Bandwidth
from torch_mcaa.estimators.located.counted import Counted, Precision
from torch_mcaa.estimators.located.jump_corrector import _steps
from torch_mcaa.estimators.parts import CROWDED, LOCATED, PLAIN, SAMPLED
from torch_mcaa.estimators.piloted import _mark_crowded
from torch_mcaa.estimators.steepness import Steepness, steepness_of
from torch_mcaa.grid import Cell, Screen
from torch_mcaa.integrand import Integrand
from torch_mcaa.replicates import Latest, agreed
from torch_mcaa.tolerance import FEW_SHIFTS

FILTER = mcaa.Gaussian(0.5, radius=4.0)


def _normal(seed: int, *shape: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def _rendered(scene: scenes.Scene, size: int, tolerance: float, spp: int = 512, seed: int = 0) -> tuple[mcaa.Rendering, Tensor]:
    picture = mcaa.render(scene, (size, size), filter=FILTER, spp=spp, tolerance=tolerance, seed=seed, dtype=torch.float64)
    centre = torch.arange(size, dtype=torch.float64) + 0.5
    return picture, picture.image[0] - scene.exact(centre[None], centre[:, None], FILTER)


def test_blocks_part_a_cell() -> None:
    """Every pixel in one rectangle, and every rectangle of one label."""
    cell, labels = Cell(3, 5, 40, 23), [1, 1, 2, 1, 1, 2, 2, 1]
    blocks = cell.blocks(12)
    labels = [labels[i % len(labels)] for i in range(len(blocks))]
    plane = torch.zeros(40, 23)
    for part, inside in cell.rectangles(12, labels):
        plane[part.within(cell)] += 1
        assert len({labels[block] for block in inside}) == 1
        assert sum(blocks[b].height * blocks[b].width for b in inside) == part.height * part.width
    assert bool((plane == 1).all())


@pytest.mark.parametrize("share", [0.5, 0.3])
def test_two_rounds_that_agree_say_how_far_their_mean_is_off(share: float) -> None:
    """Two rounds of weights `share` and the rest, reported a hundred times too large: between the true variance and four times it.

    4096 pixels: the mean of their squares is known to 2 %; the larger of a pixel's own and its neighbours' mean is 1.3 times it.
    """
    old, new = _normal(1, 1, 64, 64) / math.sqrt(1 - share), _normal(2, 1, 64, 64) / math.sqrt(share)
    true = float(((1 - share) * old + share * new).square().mean())
    told = agreed(new - old, torch.full_like(old, 100.0), share, None, False)
    assert true < float(told.mean()) < 4 * true


def test_agreement_takes_nothing_away_from_what_is_reported_rightly() -> None:
    difference = _normal(3, 1, 64, 64) * math.sqrt(2)
    told = agreed(difference, torch.full_like(difference, 0.5), 0.5, None, True)
    assert 0.4 < float(told.mean()) <= 0.5


def test_what_lattices_are_blind_to_stays() -> None:
    """Two that err alike agree; points off them have seen it."""
    nothing = torch.zeros(1, 16, 16)
    blind = torch.full_like(nothing, 0.1)
    assert bool((agreed(nothing, blind + 0.2, 0.5, blind, True) == blind).all())
    assert float(agreed(nothing, blind + 0.2, 0.5, None, True).max()) == 0


def test_rounds_at_odds_are_doubted() -> None:
    """One that saw nothing reports nothing: twice the square of half the difference tells, unless jumps were located and bring their own."""
    difference, reported = torch.full((1, 16, 16), 0.1), torch.full((1, 16, 16), 1e-8)
    assert float(agreed(difference, reported, 0.5, None, True).min()) == pytest.approx(0.005, rel=1e-4)
    assert float(agreed(difference, reported, 0.5, None, False).max()) == pytest.approx(1e-8)


def test_infinite_variances_stay() -> None:
    reported = torch.full((1, 16, 16), torch.inf)
    reported[0, 3, 3] = 1.0
    told = agreed(torch.zeros(1, 16, 16), reported, 0.5, None, True)
    assert int(told.isinf().sum()) == 255 and float(told[0, 3, 3]) == 0


def test_early_rounds_are_outgrown_by_two_that_agree_much_better() -> None:
    last, new = _normal(4, 1, 16, 16) * 1e-4, _normal(5, 1, 16, 16) * 1e-5
    empty = torch.zeros(16, 16, dtype=torch.int32)
    latest = Latest(Estimate(last, last, empty, empty), 8, 1)
    assert latest.outgrows(new, last + 0.1)
    # the mean of independent rounds of one size is nearer than the last alone
    first, second, third = (_normal(seed, 1, 64, 64) for seed in (6, 7, 8))
    assert not Latest(Estimate(second, second, empty, empty), 8, 1).outgrows(third, (first + second) / 2)


MOST = {
    "slow tone": (scenes.Sinusoid(0.23, 0.11, 0.7), 3.6),
    "tone": (scenes.Sinusoid(1.9, -0.8, 0.3), 9),
    "ramp": (scenes.Ramp(2e-3, 1e-3), 1.5),
    "zone plate": (scenes.ZonePlate(0.03, 60.3, 61.1), 9),
    "pentagon": (scenes.Polygon(((20.3, 30.1), (90.2, 17.7), (110.9, 70.4), (60.5, 112.2), (22.1, 80.8))), 12),
    "hairline": (scenes.Stripe(0.3, 80.2, 0.1), 8),
}


@pytest.mark.parametrize("name", MOST)
def test_tolerance_is_met_with_few_evaluations(name: str) -> None:
    """Some 1.5 times what was seen: blocks are done one by one, one lattice is enough for a smooth f, and jumps are located at once."""
    scene, most = MOST[name]
    picture, error = _rendered(scene, 128, 1e-3)
    assert picture.stopped == "tolerance"
    assert float(picture.spp.double().mean()) < most
    assert float(error.square().mean().sqrt()) <= 1e-3
    assert float(error.abs().max()) <= 6e-3


@pytest.mark.parametrize(("enough", "steps"), [(1e-1, 8), (1 / 1500, 11), (1e-9, 14)])
def test_brackets_of_finer_lattices_are_no_narrower_than_a_tolerance_asks_for(enough: float, steps: int) -> None:
    """Of a range of 1, and in the channel that asks for most."""
    value = torch.stack([torch.linspace(0, 1, 12), torch.linspace(2, 2.001, 12)]).view(2, 3, 4)
    assert _steps(value, torch.full_like(value, enough)) == steps


def test_a_block_that_jumps_and_was_sampled_after_all_is_not_taken_for_calm() -> None:
    """It was, and was sampled up to the cap in the place of being located: a comb of hairlines took 80 evaluations a pixel, and takes 30."""
    cell = Cell(0, 0, 64, 96)
    model = torch.full((64, 96), PLAIN, dtype=torch.uint8)
    model[5, 7], model[40:50, 40:50] = LOCATED, SAMPLED
    jumps, none = Verdict.JUMPS, Verdict.NONE
    verdict = torch.tensor([jumps, jumps, none, none, jumps, none])
    _mark_crowded(once := model.clone(), cell, verdict, False)
    assert bool((once[:32] == model[:32]).all()) and bool((once[40:50, 40:50] == CROWDED).all())
    _mark_crowded(model, cell, verdict, True)
    assert set(model[:32, :32].flatten().tolist()) == {PLAIN, LOCATED}
    assert bool((model[:32, 32:64] == CROWDED).all()) and bool((model[:, 64:] == PLAIN).all())
    assert bool((model[32:, 32:64] == CROWDED).all()) and bool((model[32:, :32] == PLAIN).all())


def _steepness(f, size: int, seed: int) -> tuple[Steepness, int]:
    """And how many evaluations it took; the pilot's grid is not among them."""
    cell = Cell(0, 0, size, size)
    task = Task(Screen.of((size, size)), Integrand(f, torch.float64), FILTER, "extend", 1, torch.float64, torch.device("cpu"))
    ask = Counted(task, cell, 1 << 20, Precision())
    grid = ask.everywhere(0.3, 0.8, Cell(0, 0, size, size))
    left = ask.left
    return steepness_of(ask, cell, grid, seed), left - ask.left


@pytest.mark.parametrize("v", [0.2, 1.0, 2.5, 5.0])
def test_steepness_tells_a_tones_frequency(v: float) -> None:
    """24 places in each of 16 blocks: within a tenth over all, and each within a half; on a grid of whole pixels (1.5, 2) is two values."""
    found, spent = _steepness(scenes.Sinusoid(0.6 * v, 0.8 * v, 0.4), 128, 5)
    assert float(found.frequency.square().mean().sqrt()) == pytest.approx(v, rel=0.1)
    assert bool(((found.frequency / v).log().abs() < math.log(1.5)).all())
    # the scene goes from 0 to 1; the larger of two estimates
    assert float(found.std.square().mean().sqrt()) == pytest.approx(math.sqrt(1 / 8), rel=0.1)
    assert float(found.mean.mean()) == pytest.approx(0.5, abs=0.05)
    assert spent == 16 * 5 * 24


@pytest.mark.parametrize("angle", [0.3, 1.2, 2.0, 2.9])
def test_one_tone_is_told_by_its_bend(angle: float) -> None:
    """Whatever its phase in a place: frequency and direction to a tenth, from 24 places of a block that holds whole periods and a part of one."""
    v = 1.1 * math.cos(angle), 1.1 * math.sin(angle)
    found, _ = _steepness(scenes.Sinusoid(*v, 0.4), 128, 5)
    # a frequency and its negative are one
    off = torch.minimum(*((found.tones - s * torch.tensor(v, dtype=torch.float64)).norm(dim=3) for s in (1, -1)))
    assert float(off.max()) < 0.11


def test_two_tones_may_have_any_direction() -> None:
    first, second = scenes.Sinusoid(0.9, 0.1, 0.4), scenes.Sinusoid(-0.2, 0.7, 1.0)
    found, _ = _steepness(lambda x, y: first(x, y) + second(x, y), 64, 5)
    angle = torch.atan2(found.tones[..., 1], found.tones[..., 0]) % math.pi
    gaps = torch.diff(angle.sort(2).values, dim=2)
    assert float(gaps.max()) < 0.2


def test_points_are_enough_for_a_tone_and_no_more_than_random_ones() -> None:
    """The Gaussian's transform is exp(-2 (pi s k)^2): what is 3,000 times too small lies 1.27 cycles off; a lattice of 5 has 2.1 between."""
    points = Bandwidth(FILTER).points
    one = torch.ones(1, 1, dtype=torch.float64)
    assert int(points(0.8 * one, one, 1e-3 * one)) == 5
    assert int(points(0 * one, 0 * one, 1e-3 * one)) == 3
    assert int(points(9 * one, one, 1e-3 * one)) == 16
    # a variance of the integral of w^2 over n, 1 / (4 pi s^2) = 0.318
    assert int(points(9 * one, one, 0.2 * one)) == math.ceil(0.3183 / 0.04)


def _taken_for_good(z: Tensor, told: Tensor, factor: float) -> float:
    """The largest share, over true standard errors, of pixels that are taken for good and beyond two tolerances; `told` are those of one of 1."""
    true = torch.tensor([0.5, 1, 1.5, 2, 3, 5, 9], dtype=torch.float64)[:, None]
    return float(((told * true * factor <= 1) & ((z * true).abs() > 2)).double().mean(1).max())


def test_chance_agreement_of_four_shifts_is_paid_for() -> None:
    """Whatever the true standard error, of the pixels at most 5 % are both taken for good and beyond two tolerances (and not far fewer)."""
    z = _normal(11, 2, 2, 1 << 20)
    told = ((z[:, 0] - z[:, 1]).square().mean(0) / 2).sqrt()
    assert 0.02 < _taken_for_good(2 * z.mean((0, 1)), told, FEW_SHIFTS[1]) < 0.051


def test_chance_agreement_of_two_shifts_is_paid_for_along_an_edge() -> None:
    """Neighbours of a correlation of 1 / e, that of the default filter: at most 1 %; of pixels alone 7 %."""
    drawn = _normal(11, 2, (1 << 20) + 1)
    z = (drawn[:, 1:] + 0.446 * drawn[:, :-1]) / math.sqrt(1 + 0.446**2)
    own = (z[0] - z[1]).square() / 2
    pooled = torch.maximum(own, torch.nn.functional.avg_pool1d(own[None], 3, 1, 1)[0])
    error = math.sqrt(2) * z.mean(0)
    assert 0.002 < _taken_for_good(error, pooled.sqrt(), FEW_SHIFTS[0]) < 0.01
    assert 0.05 < _taken_for_good(error, own.sqrt(), FEW_SHIFTS[0]) < 0.07


def test_high_tones_do_not_pass_as_smooth() -> None:
    """24 tones of 3 to 8 cycles a pixel, many near the dual vectors of one lattice or of two: no pixel of any is beyond 6 tolerances."""
    generator = torch.Generator().manual_seed(77)
    for seed in range(24):
        frequency, turn, phase = torch.rand(3, generator=generator, dtype=torch.float64).tolist()
        frequency, turn = 3 + 5 * frequency, 2 * math.pi * turn
        tone = scenes.Sinusoid(frequency * math.cos(turn), frequency * math.sin(turn), 2 * math.pi * phase)
        _, error = _rendered(tone, 48, 1e-3, seed=seed)
        assert float(error.abs().max()) <= 6e-3


def test_noise_does_not_pass_as_smooth() -> None:
    """White noise on a grid of 1/64 px, whose filtered values are known: the tolerance is kept by 95 % of the pixels, and most others nearly."""
    values = torch.rand(64 * 32, 64 * 32, generator=torch.Generator().manual_seed(9), dtype=torch.float64)

    def noise(x: Tensor, y: Tensor) -> Tensor:
        i, j = ((v.double() * 64).floor().long().remainder(64 * 32) for v in (y, x))
        return values[i, j].to(x.dtype)

    edges = torch.arange(64 * 8 + 1, dtype=torch.float64) / 64 - 4
    weight = torch.diff(FILTER.profile_cdf(edges))
    padded = torch.nn.functional.pad(values[None], (224, 224, 224, 224), "circular")[0]
    along = padded.unfold(1, 512, 64) @ weight
    truth = (along.unfold(0, 512, 64) @ weight)[:32, :32]
    picture = mcaa.render(noise, (32, 32), filter=FILTER, spp=1024, tolerance=0.02, dtype=torch.float64)
    error = (picture.image[0] - truth).abs()
    assert float((error <= 0.04).double().mean()) > 0.95
    assert float(error.square().mean().sqrt()) < 0.02


@pytest.mark.parametrize("spp", [6, 8, 13])
def test_the_cap_is_hard_where_jumps_may_have_more(spp: int) -> None:
    picture, _ = _rendered(scenes.Checkerboard(11.3, (0.4, 0.7)), 96, 1e-6, spp)
    assert picture.stopped == "spp"
    assert float(picture.spp.double().mean()) <= spp


@pytest.mark.parametrize(("spp", "turn"), [(10, 2.3), (12, 0.8)])
def test_the_pilot_counts_towards_the_cap(spp: int, turn: float) -> None:
    """A hairline under a box, which wants more than there is: 4 to 12 % above the cap if what the pilot took may be had again."""
    line = scenes.Stripe(turn, 48 * math.cos(turn) + 55 * math.sin(turn) + round((turn - 0.3) / 0.5), 0.1)
    picture = mcaa.render(line, (96, 111), spp=spp, filter=mcaa.Box(), tolerance=1e-3, seed=round((turn - 0.3) / 0.5))
    assert float(picture.spp.double().mean()) <= spp


def test_the_last_place_of_a_net_stays_below_one_in_float32(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = mcaa.Sobol.points

    def last(self: mcaa.Sobol, *args, **kwargs) -> tuple[Tensor, Tensor]:
        u, v = drawn(self, *args, **kwargs)
        return u, torch.where(v == v.amax(0, keepdim=True), 1 - 2.0**-33, v)

    monkeypatch.setattr(mcaa.Sobol, "points", last)
    picture = mcaa.render(lambda x, y: (x > 3.2).to(x.dtype), (8, 8), estimator=mcaa.Shared(mcaa.Sobol()), spp=16)
    assert bool(picture.stderr.isfinite().all())


def test_the_benchmark_prints_a_row_a_scene(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["tolerance.py", "--only", "ramp"])
    monkeypatch.setattr(benchmark, "scenes_of", lambda: {"ramp": lambda generator: scenes.Ramp(2e-3, 1e-3)})
    benchmark.main()
    rows = capsys.readouterr().out.strip().splitlines()
    assert len(rows) == 3 and rows[2].startswith("| ramp | ") and "1.0 Shared" in rows[2]


@pytest.mark.parametrize("size", [64, 256])
def test_a_relative_tolerance_of_black(size: int) -> None:
    """Where nothing is allowed and nothing is seen the tolerance is met; a shape on black asks for more about its edge alone."""
    wanted = mcaa.Tolerance(relative=0.01)
    black = mcaa.render(lambda x, y: 0 * x, (size, size), tolerance=wanted, spp=64)
    assert black.stopped == "tolerance" and float(black.spp.to(torch.float64).mean()) < 2
    disc = mcaa.render(lambda x, y: (torch.hypot(x - 32, y - 32) < 20).to(x.dtype), (size, size), tolerance=wanted, spp=64)
    assert bool(disc.image.isfinite().all()) and float(disc.spp.to(torch.float64).mean()) <= 64
