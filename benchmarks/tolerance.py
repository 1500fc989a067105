"""What a tolerance costs: `python benchmarks/tolerance.py [--tolerance 1e-3] [--seeds 1] [--only NAME]` prints a table.

Pictures of 256 x 256 pixels with closed-form pixel values under the Gaussian of 0.5 px: the scenes of the gallery, random ones of
`benchmarks/jumps.py`, tones. Beside the evaluations that `Auto` takes under a tolerance stand those of the best fixed choice made with
hindsight: of `Shared(Lattice())`, `Shared(Sobol())`, `JumpCorrected()` and `Auto()` the one that comes with the fewest evaluations a pixel to a
true RMSE within the tolerance, over the pixels that are not flat, and no pixel beyond six of them.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from jumps import CASES, FILTER, SIZE, UNCUT, Drawn
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa import scenes
from torch_mcaa.estimators import Estimator

CAP = 512
WORST = 6
"""Tolerances that no pixel may be off by."""
FIXED: tuple[Estimator, ...] = (mcaa.Shared(), mcaa.Auto(), mcaa.JumpCorrected(), mcaa.Shared(mcaa.Sobol()))
COUNTS = [*range(1, 17), 18, 20, 22, 24, 28, 32, 40, 48, 64, 80, 96, 128, 160, 192, 256, 320, 384, 512]
_SLOW = 64
"""The most evaluations that `Shared(Sobol())` is tried with: it is slow, and no match for a lattice where so many are needed."""
TONES = ((0.3, 0.5), (0.9, 0.2), (1.9, -0.8), (1.3, 1.6), (2.6, 1.1), (4.1, 3.3))
Draw = Callable[[torch.Generator], "scenes.Scene | Drawn"]


def _fixed(scene: scenes.Scene) -> Draw:
    return lambda generator: scene


def _tone(u: float, v: float) -> Draw:
    return lambda generator: scenes.Sinusoid(u, v, 2 * math.pi * float(torch.rand((), generator=generator)))


def scenes_of() -> dict[str, Draw]:
    """The scenes by name, random ones as functions of a generator."""
    gallery = scenes.gallery((SIZE, SIZE))
    fixed: dict[str, Draw] = {name: _fixed(scene) for name, scene in gallery.items() if not isinstance(scene, scenes.Mandelbrot)}
    tones: dict[str, Draw] = {f"tone ({u}, {v})": _tone(u, v) for u, v in TONES}
    return fixed | {f"random {name}": draw for name, draw in CASES.items()} | tones


@dataclass(frozen=True)
class Met:
    """Evaluations a pixel, true RMSE over the pixels that are not flat, the worst pixel, reported standard error over true, coverage."""

    spp: float
    rmse: float
    worst: float
    ratio: float
    coverage: float
    seconds: float

    def within(self, tolerance: float) -> bool:
        return self.rmse <= tolerance and self.worst <= WORST * tolerance


def rendered(scene: scenes.Scene | Drawn, truth: Tensor, estimator: Estimator, spp: int, seed: int, tolerance: float | None) -> Met:
    """A picture and how far it is off."""
    picture = mcaa.render(scene, (SIZE, SIZE), filter=FILTER, estimator=estimator, spp=spp, seed=seed, tolerance=tolerance)
    error = picture.image.to(torch.float64) - truth
    spread = torch.nn.functional.max_pool2d(torch.cat([truth, -truth])[None], 3, 1, 1)[0].unflatten(0, (2, -1)).sum(0)
    busy = spread > 1e-2 * (truth.amax((1, 2)) - truth.amin((1, 2)))[:, None, None]
    if not bool(busy.any()):
        busy = torch.ones_like(busy)
    stderr = (picture.stderr.square() - picture.unseen.square()).clamp_min(0).sqrt().to(torch.float64)[busy]
    error = error[busy]
    rmse = float(error.square().mean().sqrt())
    return Met(
        float(picture.spp.to(torch.float64).mean()),
        rmse,
        float(error.abs().max()),
        float(stderr.square().mean().sqrt()) / max(rmse, 1e-300),
        float((error.abs() <= 1.959964 * stderr).to(torch.float64).mean()),
        picture.seconds,
    )


def hindsight(scene: scenes.Scene | Drawn, truth: Tensor, tolerance: float, seed: int) -> tuple[float, str]:
    """Evaluations a pixel of the best fixed choice, and its name."""
    best, name = math.inf, "none"
    for estimator in FIXED:
        for count in COUNTS:
            if count >= best or (count > _SLOW and "Sobol" in repr(estimator)):
                break
            if count >= estimator.fewest:
                met = rendered(scene, truth, estimator, count, seed, None)
                if met.within(tolerance):
                    if met.spp < best:
                        best, name = met.spp, f"{type(estimator).__name__}" + ("(Sobol)" if "Sobol" in repr(estimator) else "")
                    break
    return best, name


def truth_of(scene: scenes.Scene | Drawn) -> Tensor:
    """(C, SIZE, SIZE) float64."""
    centre = torch.arange(SIZE, dtype=torch.float64) + 0.5
    cx, cy = centre[None, :], centre[:, None]
    truth = scene.exact(cx, cy) if isinstance(scene, Drawn) else scene.exact(cx, cy, UNCUT)
    return truth if truth.dim() == 3 else truth[None]


def drawn(name: str, seeds: int) -> Iterator[tuple[int, scenes.Scene | Drawn, Tensor]]:
    """The first `seeds` scenes of a name, with their seeds and closed forms."""
    generator = torch.Generator().manual_seed(20261125)
    for seed in range(seeds):
        scene = scenes_of()[name](generator)
        yield seed, scene, truth_of(scene)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tolerance", type=float, default=1e-3)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--only", default="", help="a part of the scenes' names")
    parser.add_argument("--without-hindsight", action="store_true")
    arguments = parser.parse_args()
    print(
        "| scene | evaluations a pixel | true RMSE | worst pixel | reported / true, coverage | best fixed choice | ratio |\n|"
        + "---|" * 7
    )
    for name in scenes_of():
        if arguments.only not in name:
            continue
        for seed, scene, truth in drawn(name, arguments.seeds):
            met = rendered(scene, truth, mcaa.Auto(), CAP, seed, arguments.tolerance)
            known, ratio = "–", "–"
            if not arguments.without_hindsight:
                best, chosen = hindsight(scene, truth, arguments.tolerance, seed)
                known, ratio = f"{best:.1f} {chosen}", f"{met.spp / best:.2f}"
            failed = "" if met.within(arguments.tolerance) else " (!)"
            print(
                f"| {name} | {met.spp:.1f} ({met.seconds:.1f} s) | {met.rmse:.1e} | {met.worst:.0e}{failed} "
                f"| {met.ratio:.2f}, {met.coverage:.0%} | {known} | {ratio} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
