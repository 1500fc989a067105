"""The peers of `benchmarks/peers`: each draws the scenes that are compared, with the error that its kind has; and how they are compared.

Those that are not installed are skipped with the reason; `.ci/run` asks for the required ones before.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from peers import CASES, PEERS, Outcome, Peer
from peers.__main__ import check
from peers.cases import Grain
from peers.race import Point, Runner, race
from ratios import Ratio, verdict
from rich.console import Console

# RMSE on a disc and on waves at 64 evaluations a pixel (1 for smoothstep): the largest of five seeds, and a quarter more
EXPECTED = {
    "grid + kornia gaussian_blur2d + stride": (4.0e-3, 5e-7),
    "grid + separable strided convolution": (5.5e-3, 5e-7),
    "grid + F.interpolate(antialias=True)": (3.3e-2, 3.9e-2),
    "grid + skimage resize(anti_aliasing=True)": (4.0e-3, 3.0e-5),
    "per pixel, Owen-scrambled Sobol', PyTorch": (1.6e-2, 5.4e-3),
    "per pixel, Owen-scrambled Sobol', numba": (1.6e-2, 5.4e-3),
    "shared lattice, numba": (5.5e-3, 8e-7),
    "scipy.stats.qmc": (1.9e-2, 1.0e-2),
    "torchquad MonteCarlo": (4.8e-2, 4.5e-2),
    "torchquad Simpson": (4.3e-2, 4.0e-2),
    "torchquad VEGAS": (2.0e-1, 2.0e-1),
    "vegas": (6.0e-2, 6.0e-2),
    "Mitsuba 3, textured rectangle": (1.4e-2, 2.0e-2),
    "smoothstep(fwidth)": (1.7e-2, math.nan),
}


def _ready(peer: Peer) -> None:
    if not peer.installed:
        pytest.skip(
            f"{peer.distribution} is not installed: pip install '.[bench]'" + ("" if peer.required else f" {peer.distribution}")
        )


NUMBA = next(peer for peer in PEERS if peer.file == "numba_lattice")


@pytest.mark.parametrize("name", ["curves", "smooth"])
@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer.name)
def test_a_peer_comes_as_near_as_its_kind_does(peer: Peer, name: str) -> None:
    _ready(peer)
    case = CASES[name](64)
    if not peer.fits(case):
        return
    budget = 64 if 64 in peer.budgets else peer.budgets[0]
    outcome = peer.load()(case, budget, 1)
    assert outcome.rmse(case) < EXPECTED[peer.name][name == "smooth"]
    pixels = case.truth.numel() if outcome.pixels is None else len(outcome.pixels)
    assert outcome.evaluations / pixels >= 0.2 * budget


@pytest.mark.parametrize("name", list(CASES))
def test_scenes_for_compilers_are_the_scenes(name: str) -> None:
    from peers import kernels

    case = CASES[name](96)
    x, y = torch.rand(2, 400, generator=torch.Generator().manual_seed(2)) * 96
    f = getattr(kernels, case.kernel)
    theirs = torch.tensor(
        [float(f(np.float32(a), np.float32(b), case.numbers)) for a, b in zip(x.tolist(), y.tolist(), strict=True)]
    )
    # a rounding beside an edge may go either way
    assert ((theirs - case.scene(x, y)).abs() > 1e-3).sum() <= 1


def test_grain_has_the_values_of_a_fine_grid() -> None:
    grain, k = Grain(), 400
    at = (torch.arange(6 * k, dtype=torch.float64) + 0.5) / k - 3
    w = torch.exp(-2 * at * at)
    w = w / w.sum()
    for column, row in ((0, 0), (5, 9), (11, 2)):
        x, y = (at + column + 0.5)[None].expand(len(at), -1), (at + row + 0.5)[:, None].expand(-1, len(at))
        value = w @ grain.field()(x, y) @ w
        # the grid's own error on squares of 55 samples a side
        assert abs(value - grain.exact(12)[row, column]) < 2e-4


def test_numba_calls_the_vector_library_where_it_is_installed() -> None:
    _ready(NUMBA)
    from peers import numba_lattice
    from peers.compiler import libraries, vectorised

    if not libraries():
        pytest.skip("SVML is not installed: pip install intel-cmplr-lib-rt")
    numba_lattice.picture(CASES["smooth"](64), 4, 1)
    assert vectorised(numba_lattice.kernel("zone_plate")[0])


def test_the_numba_lattice_brings_a_standard_error() -> None:
    _ready(NUMBA)
    from peers import numba_lattice

    case = CASES["curves"](64)
    image, stderr = numba_lattice.picture(case, 16, 3)
    error = (torch.from_numpy(image).double() - case.truth)[case.busy]
    reported = torch.from_numpy(stderr).double()[case.busy]
    assert 0.5 < float(reported.square().mean().sqrt() / error.square().mean().sqrt()) < 3


def test_a_missing_required_peer_fails_the_check(monkeypatch: pytest.MonkeyPatch) -> None:
    console = Console(record=True, width=132, quiet=True)
    gone = [Peer("a", "expert", "no-such-thing"), Peer("b", "expert")]
    monkeypatch.setattr("peers.__main__.PEERS", gone)
    assert check(console)
    monkeypatch.setattr("peers.__main__.PEERS", [*gone, Peer("c", "expert", "no-such-thing", required=True)])
    assert not check(console)


def test_the_time_to_an_error_lies_on_a_straight_line_of_logarithms() -> None:
    def runner(*points: tuple[float, float], step: int = 4) -> Runner:
        return Runner(PEERS[0], [Point(n * step, squares=[e * e], times=[t]) for n, (e, t) in enumerate(points)])

    assert runner((1e-2, 1.0), (1e-4, 100.0)).time_to(1e-3) == pytest.approx(10)
    assert runner((1e-2, 1.0), (1e-4, 100.0), step=1).time_to(1e-3) == 100  # nothing lies between
    assert runner((1e-3, 2.0), (1e-4, 9.0)).time_to(2e-3) == 2
    assert runner((1e-2, 1.0)).time_to(2e-3) == math.inf


def test_a_race_stops_where_the_error_is_reached_and_says_what_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    case = CASES["smooth"](32)

    def load(self: Peer) -> object:
        def render(case: object, spp: int, seed: int) -> Outcome:
            if self.name == "bad":
                raise RuntimeError("no")
            return Outcome(case.truth + 1 / spp, spp * 32 * 32)  # type: ignore[attr-defined]

        return render

    monkeypatch.setattr(Peer, "load", load)
    good, bad = race(case, [Peer("good", "", budgets=(1, 10, 100, 1000)), Peer("bad", "")], repetitions=2, target=0.05)
    assert [p.budget for p in good.points] == [1, 10, 100] and all(len(p.times) == 2 for p in good.points)
    assert bad.error == "RuntimeError: no" and bad.time_to(1) == math.inf


def test_a_ratio_is_worse_only_beyond_its_own_spread() -> None:
    found = Ratio.of([1.0, 1.1, 1.2, 1.3, 1.4])
    assert found.value == 1.2 and 0 < found.spread < 0.2
    assert verdict(Ratio(1.5, 0.01), 1.0, 2.0) == "WORSE"
    assert verdict(Ratio(1.5, 0.1), 1.0, 2.0) == "reached"
    assert verdict(Ratio(1.5, 0.1), None, 1.0) == "not reached"
