"""What others do about aliasing, on the same scenes: one method a file, listed here.

`python -m benchmarks.peers` compares them with ours, `--check` says which are installed.
"""

from __future__ import annotations

from .base import Outcome, Peer
from .cases import CASES, Case


def _has_distance(case: Case) -> bool:
    return case.distance is not None


GRIDS = (1, 4, 16, 64, 256)

PEERS = [
    Peer("grid + kornia gaussian_blur2d + stride", "kornia_blur", "kornia", required=True, budgets=GRIDS),
    Peer("grid + separable strided convolution", "expert", budgets=GRIDS),
    Peer("grid + F.interpolate(antialias=True)", "resized", function="interpolated"),
    Peer("grid + skimage resize(anti_aliasing=True)", "resized", "scikit-image", function="scikit"),
    Peer("per pixel, Owen-scrambled Sobol', PyTorch", "sobol_pixels"),
    Peer("per pixel, Owen-scrambled Sobol', numba", "numba_owen", "numba", required=True),
    Peer("shared lattice, numba", "numba_lattice", "numba", required=True, budgets=(2, 4, 16, 64, 256)),
    Peer("scipy.stats.qmc", "scipy_qmc", "scipy", required=True),
    Peer("torchquad MonteCarlo", "torchquad_pixels", "torchquad", required=True, function="monte_carlo"),
    Peer("torchquad Simpson", "torchquad_pixels", "torchquad", required=True, function="simpson"),
    Peer("torchquad VEGAS", "torchquad_pixels", "torchquad", required=True, function="vegas", budgets=(64, 256)),
    Peer("vegas", "vegas_pixels", "vegas", required=True, budgets=(16, 64, 256)),
    Peer("Mitsuba 3, textured rectangle", "mitsuba_texture", "mitsuba", budgets=(4, 16, 64)),
    Peer("smoothstep(fwidth)", "fwidth", budgets=(1,), fits=_has_distance),
]

__all__ = ["CASES", "PEERS", "Case", "Outcome", "Peer"]
