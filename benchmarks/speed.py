"""Time and memory of the shared lattice against the expert's way, ratios in one run.

`python benchmarks/speed.py` prints the table of the README; `--large` adds 8192 x 8192 pixels in three channels (some 4 GiB and minutes).
"""

from __future__ import annotations

import argparse
import itertools
import statistics
import subprocess
import sys
import time
from collections.abc import Callable

import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa import scenes

SCENES: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "disc": lambda x, y: (torch.hypot(x - 256, y - 256) < 200).float(),
    "zone plate": lambda x, y: 0.5 + 0.5 * torch.cos((x * x + y * y) * 0.003),
}


def expert(f: Callable[[Tensor, Tensor], Tensor], size: int, k: int, std: float = 0.5, reach: int = 2) -> Tensor:
    """A k x k grid in every pixel and two separable strided convolutions with a Gaussian of 5 standard deviations."""
    places = (torch.arange((size + 2 * reach + 1) * k - k) + 0.5) / k - reach
    values = f(places[None, :].expand(len(places), -1), places[:, None].expand(-1, len(places)))[None, None]
    d = (torch.arange((2 * reach + 1) * k) + 0.5) / k - reach - 0.5
    weight = torch.exp(-0.5 * (d / std) ** 2)
    weight = weight / weight.sum()
    along = torch.nn.functional.conv2d(values, weight.view(1, 1, 1, -1), stride=(1, k))
    return torch.nn.functional.conv2d(along, weight.view(1, 1, -1, 1), stride=(k, 1))


def compare(name: str, k: int, size: int, pairs: int) -> None:
    f, spp = SCENES[name], k * k
    # the clock at the beginning, after the expert's way, eager blocks and the compiled graph
    clocks = []
    for _ in range(pairs + 1):
        clock = [time.perf_counter()]
        expert(f, size, k)
        clock.append(time.perf_counter())
        for compile in (False, True):
            mcaa.render(f, (size, size), estimator=mcaa.Shared(), spp=spp, compile=compile)
            clock.append(time.perf_counter())
        clocks.append(clock)
    times = [[b - a for a, b in itertools.pairwise(clock)] for clock in clocks[1:]]
    cells = [f"{name} {size}², {spp}", *(f"{statistics.median(t) * 1e3:.0f} ms" for t in zip(*times, strict=True))]
    for way in (1, 2):
        ratios = [t[way] / t[0] for t in times]
        cells.append(f"{statistics.median(ratios):.2f} ({min(ratios):.2f}-{max(ratios):.2f})")
    print(f"| {' | '.join(cells)} |", flush=True)


def blurred(f: Callable[[Tensor, Tensor], Tensor], size: int, k: int, reach: int = 2) -> Tensor:
    """A k x k grid in every pixel (k odd), kornia's blur with a Gaussian of 0.5 px, and every k-th value."""
    import kornia

    places = (torch.arange((size + 2 * reach) * k) + 0.5) / k - reach
    values = f(places[None, :].expand(len(places), -1), places[:, None].expand(-1, len(places)))
    blur = kornia.filters.gaussian_blur2d(values[None, None], (4 * k + 1, 4 * k + 1), (0.5 * k, 0.5 * k))
    first = reach * k + k // 2
    return blur[0, 0, first::k, first::k][:size, :size]


def located(size: int, pairs: int) -> None:
    """A disc by `Auto` at few evaluations against a 9 x 9 grid and kornia's blur: errors, and the ratio of times."""
    disc, centre = scenes.Disc(size / 2 + 0.3, size / 2 - 0.9, 0.39 * size), torch.arange(size, dtype=torch.float64) + 0.5
    truth = disc.exact(centre[None], centre[:, None], mcaa.Gaussian(0.5, radius=4.0))
    busy = (truth > 1e-3) & (truth < 1 - 1e-3)
    for spp in (5, 8, 16):
        ratios, errors = [], []
        for pair in range(pairs + 1):
            begin = time.perf_counter()
            theirs = blurred(disc, size, 9)
            middle = time.perf_counter()
            ours = mcaa.render(disc, (size, size), spp=spp).image[0]
            end = time.perf_counter()
            if pair:
                ratios.append((end - middle) / (middle - begin))
            errors = [float((image - truth)[busy].square().mean().sqrt()) for image in (theirs, ours)]
        print(
            f"| {spp} | {errors[0]:.1e} | {errors[1]:.1e} | {statistics.median(ratios):.2f} ({min(ratios):.2f}-{max(ratios):.2f}) |",
            flush=True,
        )


LARGE = """
import sys, time, torch, torch_mcaa as mcaa
size = int(sys.argv[1])
def f(x, y):
    return torch.sin(x * 0.01), (torch.hypot(x - 300, y - 300) < 200).float(), torch.cos(y * 0.02)
mcaa.render(f, (64, 64), estimator=mcaa.Shared())
def status(key):
    return next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith(key))
before = status("VmRSS")
begin = time.perf_counter()
picture = mcaa.render(f, (size, size), estimator=mcaa.Shared())
seconds = time.perf_counter() - begin
results = sum(t.numel() * t.element_size() for t in (picture.image, picture.stderr, picture.spp, picture.invalid, picture.model))
peak = status("VmHWM") - before
print(f"| {size}² x 3 | {seconds:.1f} s | {seconds / size**2 * 1e9:.0f} | {results / 2**20:.0f} | {peak / 1024 - results / 2**20:.0f} |")
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=9)
    parser.add_argument("--large", action="store_true")
    arguments = parser.parse_args()
    print(f"torch {torch.__version__}, {torch.get_num_threads()} threads\n")
    print(
        "| scene, evaluations a pixel | grid + two strided convolutions | torch_mcaa, with the standard error | compiled "
        "| ratio: median (range) | compiled |\n|---|---|---|---|---|---|"
    )
    for k in (4, 8):
        for name in SCENES:
            compare(name, k, 512, arguments.pairs)
    print(
        "\n| disc 512², `Auto` at | RMSE of a 9 x 9 grid + kornia | RMSE of `Auto` | ratio of times: median (range) |\n|---|---|---|---|"
    )
    located(512, arguments.pairs)
    print("\n| size | time | ns a pixel | results, MiB | peak above the results, MiB |\n|---|---|---|---|---|")
    for size in (512, 2048, *((8192,) if arguments.large else ())):
        run = subprocess.run([sys.executable, "-c", LARGE, str(size)], capture_output=True, text=True, check=True)
        print(run.stdout.strip(), flush=True)


if __name__ == "__main__":
    main()
