"""The ratios that are kept from getting worse: what is measured, by interleaved pairs, and what is asked of each."""

from __future__ import annotations

import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import torch
from peers import CASES, PEERS, Case, expert, kornia_blur, numba_lattice, numba_owen
from peers.grid import BAND
from peers.ours import OURS, uncompiled
from peers.race import race
from torch import Tensor

import torch_mcaa as mcaa

SPP = 16
WHOLE = bool(os.environ.get("MCAA_WHOLE"))
"""Whether to time 8192 x 8192 pixels, where 4096 x 4096 else stand for them."""


class Missing(Exception):
    """What a ratio needs is not here."""


@dataclass(frozen=True)
class Ratio:
    """The median of the ratios of pairs, and half of their interquartile range over the root of their number."""

    value: float
    spread: float = 0.0

    @classmethod
    def of(cls, ratios: list[float]) -> Ratio:
        low, _, high = statistics.quantiles(ratios, n=4) if len(ratios) > 1 else (ratios[0],) * 3
        return cls(statistics.median(ratios), (high - low) / 2 * 1.6 / math.sqrt(len(ratios)))


@dataclass(frozen=True)
class Row:
    """One line of the table: `measure` gives the ratio, `reach` is what it should come to."""

    name: str
    reach: float
    measure: Callable[[], Ratio]


WORSE = 1.3


def verdict(found: Ratio, before: float | None, reach: float) -> str:
    """WORSE: over `WORSE` times what was stored, by more than three of its own spreads."""
    if before is not None and found.value - 3 * found.spread > WORSE * before:
        return "WORSE"
    return "" if reach == math.inf else "reached" if found.value <= reach else "not reached"


def timed(work: Callable[[], object]) -> float:
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def pairs(ours: Callable[[], object], theirs: Callable[[], object], count: int = 9) -> Ratio:
    """Each once to warm up, then in turn."""
    ours()
    theirs()
    return Ratio.of([timed(ours) / timed(theirs) for _ in range(count)])


def _picture(case: Case, **more: Any) -> Callable[[], object]:
    return lambda: mcaa.render(case.scene, (case.size, case.size), **{"estimator": mcaa.Shared(), "spp": SPP, **more})


def _compiled(case: Case, estimator: mcaa.Estimator | None = None, spp: int = SPP) -> Callable[[], object]:
    estimator = mcaa.Shared() if estimator is None else estimator
    if refused := uncompiled(estimator):
        raise Missing(refused)
    return _picture(case, compile=True, estimator=estimator, spp=spp)


def over_numba(name: str, size: int, count: int) -> Ratio:
    case = CASES[name](size)
    return pairs(_compiled(case), lambda: numba_lattice.picture(case, SPP, 1), count)


_WHOLE = 2**40
"""Samples in a band: all of them, where peers otherwise work on bands of rows that stay in the cache."""


def over_expert(name: str, spp: int, band: int, compile: bool) -> Ratio:
    case = CASES[name](512)
    ours = _compiled(case, spp=spp) if compile else _picture(case, compile=False, spp=spp)
    return pairs(ours, lambda: expert.picture(case.scene, case.size, math.isqrt(spp), band=band), 15)


def auto_over_blur(spp: int, band: int) -> Ratio:
    """On a disc, at `spp` evaluations a pixel, over a 9 x 9 grid and kornia's blur, which errs some hundred times as much."""
    case = CASES["curves"](512)
    ours = _picture(case, estimator=mcaa.Auto(), compile=False, spp=spp)
    return pairs(ours, lambda: kornia_blur.picture(case.scene, case.size, 9, band=band), 15)


def training_step(estimator: mcaa.Estimator, over: mcaa.Estimator, jumps: str | bool = "auto") -> Ratio:
    """A picture of 256 x 256 pixels of a disc and its gradient, 64 evaluations a pixel; the other one with `jumps`."""
    place, colours = torch.tensor([130.0, 120.0, 80.0], requires_grad=True), torch.tensor([0.2, 0.7], requires_grad=True)

    def f(x: Tensor, y: Tensor) -> Tensor:
        return torch.where(torch.hypot(x - place[0], y - place[1]) < place[2], colours[1], colours[0])

    def step(estimator: mcaa.Estimator, jumps: str | bool) -> Callable[[], None]:
        layer = mcaa.Supersampler((256, 256), spp=64, estimator=estimator, discontinuities=jumps)  # type: ignore[arg-type]

        def work() -> None:
            layer(f).square().sum().backward(inputs=[place, colours])

        return work

    return pairs(step(estimator, "auto"), step(over, jumps), 9)


def followed_over_values() -> Ratio:
    """The layer, which takes a disc's edge from f's decision, over `render`, which finds it from values."""
    case, radius = CASES["curves"](512), torch.tensor(0.37 * 512)

    def f(x: Tensor, y: Tensor) -> Tensor:
        return (torch.hypot(x - 250.3, y - 257.7) < radius).to(x)

    layer = mcaa.Supersampler((case.size, case.size), spp=SPP)
    return pairs(lambda: layer(f), lambda: mcaa.render(f, (case.size, case.size), spp=SPP, compile=False), 9)


def warp_over_kornia() -> Ratio:
    """A floor of noise, 512 x 512 texels on 240 x 320 pixels, at 16 evaluations a pixel over kornia's one."""
    import kornia
    from kornia_comparison import plane

    src, M = torch.rand(1, 3, 512, 512, generator=torch.Generator().manual_seed(1)), plane(512, 512)
    return pairs(
        lambda: mcaa.warp_perspective(src, M, (240, 320), padding_mode="border"),
        lambda: kornia.geometry.warp_perspective(src, M, (240, 320), padding_mode="border"),
        9,
    )


def owen_over_numba() -> Ratio:
    case = CASES["smooth"](512)
    ours = _compiled(case, mcaa.Importance(mcaa.Sobol()))
    return pairs(ours, lambda: numba_owen.picture(case, SPP, 1), 7)


def corrected_over_shared(name: str) -> Ratio:
    case = CASES[name](512)
    corrected = _picture(case, estimator=mcaa.JumpCorrected(), compile=False)
    return pairs(corrected, _picture(case, compile=False), 9)


class Network(torch.nn.Module):
    """A coordinate network of about a microsecond a point on two cores."""

    def __init__(self) -> None:
        super().__init__()
        generator = torch.Generator().manual_seed(3)
        widths = (2, 160, 160, 160, 160, 3)
        self.weights = [torch.randn(a, b, generator=generator) / math.sqrt(a) for a, b in pairwise(widths)]

    def forward(self, points: torch.Tensor) -> torch.Tensor:
        x = points / 64 - 1
        for weight in self.weights[:-1]:
            x = torch.sin(3 * (x @ weight))
        return torch.sigmoid(x @ self.weights[-1])


def network(estimator: object) -> Ratio:
    """The whole render over f alone, at as many points in blocks of the same size."""
    from torch_mcaa.integrand import BLOCK

    f, size = mcaa.from_points(Network()), (128, 128)
    evaluations = mcaa.render(f, size, estimator=estimator, spp=SPP, compile=False).evaluations  # type: ignore[arg-type]
    x, y = torch.rand(2, evaluations, generator=torch.Generator().manual_seed(1)) * 128

    def alone() -> None:
        with torch.no_grad():
            for a, b in zip(x.split(BLOCK), y.split(BLOCK), strict=True):
                f(a, b)

    return pairs(lambda: mcaa.render(f, size, estimator=estimator, spp=SPP, compile=False), alone, 7)  # type: ignore[arg-type]


FAST = ("expert", "numba_lattice", "numba_owen", "scipy_qmc")
"""The files of the peers that were ever the best of a case; `python -m benchmarks.peers` runs them all."""


def time_to_target(names: tuple[str, ...]) -> Ratio:
    """The worst of the cases; `Auto`'s time to an RMSE of 2e-3 over the best peer's."""
    ratios = []
    for name in names:
        runners = race(CASES[name](512), [OURS[0], *(peer for peer in PEERS if peer.file in FAST)], 3)
        ratios.append(runners[0].time_to(2e-3) / min(runner.time_to(2e-3) for runner in runners[1:]))
    return Ratio(max(ratios))


def flat() -> Ratio:
    """Time a pixel of a large picture over a small one's."""
    f = CASES["curves"](256).scene
    size = 8192 if WHOLE else 4096
    few = (size // 256) ** 2

    def ours() -> object:
        return mcaa.render(f, (size, size), estimator=mcaa.Shared(), spp=SPP, compile=False)

    def theirs() -> float:
        return statistics.median(
            timed(lambda: mcaa.render(f, (256, 256), estimator=mcaa.Shared(), spp=SPP, compile=False)) for _ in range(25)
        )

    theirs()
    ratios = []
    for _ in range(1 if WHOLE else 3):
        before, middle, after = theirs(), timed(ours), theirs()
        ratios.append(middle / few / ((before + after) / 2))
    return Ratio.of(ratios)


def cold_start() -> Ratio:
    """Seconds that `mcaa render` of 512 x 512 pixels takes more than `import torch`; the one row that is a difference."""
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "scene.py"
        scene.write_text(
            "import torch\n\n\ndef f(x, y):\n    return (torch.hypot(x - 256, y - 256) < 200).float()\n", encoding="utf8"
        )
        picture = [
            *(sys.executable, "-c", "from torch_mcaa.cli import main; main()"),
            *("render", f"{scene}:f", "--size", "512x512", "-o", f"{folder}/disc.png"),
        ]
        plain = [sys.executable, "-c", "import torch"]

        def run(command: list[str]) -> float:
            (Path(folder) / "disc.png").unlink(missing_ok=True)
            return timed(lambda: subprocess.run(command, check=True, capture_output=True))

        run(picture)
        run(plain)
        return Ratio.of([run(picture) - run(plain) for _ in range(7)])


ROWS = [
    Row("Shared, compiled / numba, waves 512²", 1 / 6, lambda: over_numba("smooth", 512, 15)),
    Row("Shared, compiled / numba, waves 2048²", 1 / 6, lambda: over_numba("smooth", 2048, 5)),
    Row("Shared, compiled / numba, disc 512²", 1 / 6, lambda: over_numba("curves", 512, 15)),
    *(
        Row(
            f"Shared, {'compiled' if compile else 'eager'} / convolutions{said}, {scene}, {spp}",
            0.15 if compile else 0.45,
            partial(over_expert, name, spp, band, compile),
        )
        for spp in (SPP, 64)
        for said, band in (("", BAND), (" of whole tensors", _WHOLE))
        for scene, name in (("waves", "smooth"), ("disc", "curves"))
        for compile in (True, False)
    ),
    Row("per pixel Owen + Gaussian, compiled / numba", 1 / 2, owen_over_numba),
    Row("JumpCorrected / Shared(Lattice), disc", 1.5, lambda: corrected_over_shared("curves")),
    Row("JumpCorrected / Shared(Lattice), polygon", 1.5, lambda: corrected_over_shared("polygons")),
    *(
        Row(f"Auto at {spp} / 9 x 9 grid + kornia's blur{said}, disc", 0.2, partial(auto_over_blur, spp, band))
        for spp in (5, 8)
        for said, band in (("", BAND), (" of whole tensors", _WHOLE))
    ),
    Row("training step, Auto / Shared, disc", math.inf, partial(training_step, mcaa.Auto(), mcaa.Shared())),
    Row("training step, Auto, with / without jumps, disc", 1.3, partial(training_step, mcaa.Auto(), mcaa.Auto(), False)),
    Row("training step, Shared, with / without jumps, disc", 1.3, partial(training_step, mcaa.Shared(), mcaa.Shared(), False)),
    Row("layer, decisions followed / values alone, disc", math.inf, followed_over_values),
    Row("warp_perspective at 16 / kornia's", math.inf, warp_over_kornia),
    Row("network, Shared / f alone", 1.05, lambda: network(mcaa.Shared())),
    Row("network, Auto / f alone", 1.05, lambda: network(mcaa.Auto())),
    Row(
        "time to RMSE 2e-3, Auto / best peer: edges, curves, polygons",
        1 / 10,
        lambda: time_to_target(("edges", "curves", "polygons")),
    ),
    Row("time to RMSE 2e-3, Auto / best peer: smooth", 1 / 2, lambda: time_to_target(("smooth",))),
    Row("time to RMSE 2e-3, Auto / best peer: noise, resonance", 1.05, lambda: time_to_target(("noise", "resonance"))),
    Row(f"time a pixel, {8192 if WHOLE else 4096}² / 256²", 1.1, flat),
    Row("cold `mcaa render` - `import torch`, 512², seconds", 1.5, cold_start),
]
