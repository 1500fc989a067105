"""Edges between patterns: `python benchmarks/patterns.py` prints what values alone tell of them, and what f's decisions do.

A line between two tones, the level beyond it higher by 1 or not, 192 x 192 pixels, Gaussian of 0.5 px, float64; root mean square error in the
pixels less than 2 px from it. `render` sees values; the layer traces f.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass

import numpy as np
import torch
from scipy.special import wofz
from torch import Tensor

import torch_mcaa as mcaa

SIZE, STD = 192, 0.5
FILTER = mcaa.Gaussian(STD, radius=8 * STD)
TONES = {
    "0.02 and 0.03 c/px": ((0.02, 0.01), (-0.01, 0.03)),
    "0.1 and 0.16 c/px": ((0.1, 0.05), (-0.05, 0.15)),
    "0.3 and 0.2 c/px": ((0.3, 0.1), (-0.1, 0.2)),
    "0.5 and 0.4 c/px": ((0.45, 0.2), (-0.2, 0.35)),
}


@dataclass(frozen=True)
class Patterned:
    angle: float
    tones: tuple[tuple[float, float], tuple[float, float]]
    level: float

    @property
    def normal(self) -> tuple[float, float, float]:
        c, s = math.cos(self.angle), math.sin(self.angle)
        return c, s, SIZE / 2 * (c + s) + 3.3

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        c, s, offset = self.normal
        low, high = (0.5 * torch.cos(2 * math.pi * (u * x + v * y)) for u, v in self.tones)
        return torch.where(x * c + y * s >= offset, high + self.level, low)

    def exact(self) -> tuple[Tensor, Tensor]:
        """The means, and the pixels near the line: under a normal density a tone shifts the normal distribution function's argument."""
        c, s, offset = self.normal
        x, y = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5)
        d, total = x * c + y * s - offset, np.zeros((SIZE, SIZE))
        for (u, v), level, side in zip(self.tones, (0, self.level), (-1, 1), strict=True):
            kx, ky = 2 * math.pi * u, 2 * math.pi * v
            tone = np.exp(1j * (kx * x + ky * y) - (STD * math.hypot(kx, ky)) ** 2 / 2)
            share = _normal(side * (d + 1j * STD**2 * (kx * c + ky * s)) / STD)
            total += np.real(0.5 * tone * share) + level * np.real(_normal(side * d / STD + 0j))
        return torch.from_numpy(total), torch.from_numpy(np.abs(d) < 2)


def _normal(z: np.ndarray) -> np.ndarray:
    """The normal distribution function of complex numbers."""
    w = np.where(np.real(z) >= 0, z, -z) / math.sqrt(2)
    tail = 0.5 * np.exp(-w * w) * wofz(1j * w)
    return np.where(np.real(z) >= 0, 1 - tail, tail)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    arguments = parser.parse_args()
    print("| tones, step | a pixel | `Shared(Lattice())` | `Auto()` from values | `Auto()` in the layer |\n|---|---|---|---|---|")
    for name, tones in TONES.items():
        for level in (0.0, 1.0):
            for spp in (16, 64):
                errors: list[list[Tensor]] = [[], [], []]
                for seed in range(arguments.seeds):
                    scene = Patterned(0.3 + 1.1 * seed, tones, level)
                    truth, near = scene.exact()
                    layer = mcaa.Supersampler((SIZE, SIZE), filter=FILTER, spp=spp, seed=seed).double()
                    pictures = [
                        mcaa.render(scene, (SIZE, SIZE), filter=FILTER, estimator=e, spp=spp, seed=seed, dtype=torch.float64).image
                        for e in (mcaa.Shared(), mcaa.Auto())
                    ]
                    for error, picture in zip(errors, (*pictures, layer(scene)), strict=True):
                        error.append((picture[0] - truth)[near])
                cells = " | ".join(f"{float(torch.cat(e).square().mean().sqrt()):.1e}" for e in errors)
                print(f"| {name}, {level:g} | {spp} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
