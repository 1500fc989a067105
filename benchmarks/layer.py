"""What the layer's gradients cost: evaluations, time and memory.

`python benchmarks/layer.py` prints two tables. Time, forward and backward at 64 samples a pixel, ratios of medians in one run: with the
boundary term over without, under the default estimator and under `Shared()`, and over automatic differentiation of samples on a grid
with its tape kept, written by hand. Memory: the peak of a process above what it had before, at 16 and 256 samples, with an allocator that
gives back what is freed (`MALLOC_MMAP_THRESHOLD_`): glibc's own habits cost several times as much, and differ from run to run.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.integrand import Function

SIZE = 256


def disc() -> tuple[Sequence[Tensor], Function]:
    place = torch.tensor([130.0, 120.0, 80.0], requires_grad=True)
    return [place], lambda x, y: (torch.hypot(x - place[0], y - place[1]) < place[2]).to(x)


def shaded() -> tuple[Sequence[Tensor], Function]:
    place, colours = torch.tensor([130.0, 120.0, 80.0], requires_grad=True), torch.linspace(0, 1, 6).requires_grad_()

    def f(x: Tensor, y: Tensor) -> tuple[Tensor, ...]:
        inside = torch.hypot(x - place[0], y - place[1]) < place[2]
        wave = torch.sin(0.05 * y)
        return tuple(torch.where(inside, colours[c] + 0.001 * x, colours[c + 3] * wave) for c in range(3))

    return [place, colours], f


def checkerboard() -> tuple[Sequence[Tensor], Function]:
    frequency = torch.tensor(0.05, requires_grad=True)
    return [frequency], lambda x, y: torch.remainder(torch.floor(x * frequency) + torch.floor(y * frequency), 2)


def network() -> tuple[Sequence[Tensor], Function]:
    net = torch.nn.Sequential(torch.nn.Linear(2, 32), torch.nn.Tanh(), torch.nn.Linear(32, 3))
    return list(net.parameters()), mcaa.from_points(lambda points: net(points * 0.02))


SCENES = {make.__name__: make for make in (disc, shaded, checkerboard, network)}


def by_hand(f: Function, size: int, k: int, std: float = 0.5, reach: int = 2) -> Tensor:
    """A k x k grid in every pixel and two strided convolutions, with its tape."""
    places = (torch.arange((size + 2 * reach) * k) + 0.5) / k - reach
    value = f(places[None, :].expand(len(places), -1), places[:, None].expand(-1, len(places)))
    values = torch.stack(list(value)) if isinstance(value, tuple) else value.reshape(-1, *value.shape[-2:])
    d = (torch.arange((2 * reach + 1) * k) + 0.5) / k - reach - 0.5
    weight = torch.exp(-0.5 * (d / std) ** 2)
    weight = weight / weight.sum()
    along = torch.nn.functional.conv2d(values[:, None], weight.view(1, 1, 1, -1), stride=(1, k))
    return torch.nn.functional.conv2d(along, weight.view(1, 1, -1, 1), stride=(k, 1))[:, 0]


def compare(name: str, rounds: int) -> None:
    parameters, f = SCENES[name]()
    asked = [0]

    def counted(x: Tensor, y: Tensor) -> object:
        asked[0] += x.numel()
        return f(x, y)

    ways: dict[str, Callable[[], Tensor]] = {}
    for label, estimator in (("auto", mcaa.Auto()), ("shared", mcaa.Shared())):
        for jumps in ("auto", False):
            layer = mcaa.Supersampler((SIZE, SIZE), spp=64, estimator=estimator, discontinuities=jumps)
            ways[f"{label} {jumps}"] = lambda layer=layer: layer(counted)
    ways["by hand"] = lambda: by_hand(counted, SIZE, 8)
    seconds: dict[str, list[float]] = {way: [] for way in ways}
    evaluations: dict[str, int] = {}
    for number in range(rounds + 1):
        for way, picture in ways.items():
            asked[0] = 0
            begin = time.perf_counter()
            loss = picture().square().sum()
            if loss.requires_grad:
                torch.autograd.backward(loss, inputs=list(parameters))
            if number:
                seconds[way].append(time.perf_counter() - begin)
            evaluations[way] = asked[0]
    median = {way: statistics.median(times) for way, times in seconds.items()}
    more = [f"{evaluations[f'{e} auto'] / evaluations[f'{e} False'] - 1:+.0%}" for e in ("auto", "shared")]
    print(
        f"| {name} | {more[0]}, {median['auto auto'] / median['auto False'] - 1:+.0%} "
        f"| {more[1]}, {median['shared auto'] / median['shared False'] - 1:+.0%} "
        f"| {median['auto auto'] / median['by hand']:.2f} | {median['shared auto'] / median['by hand']:.2f} "
        f"| {median['auto auto'] * 1e3:.0f} ms |",
        flush=True,
    )


MEMORY = """
import sys, warnings, torch, torch_mcaa as mcaa
sys.path.insert(0, sys.argv[1])
import layer as here
warnings.simplefilter("ignore")
torch.set_num_threads(1)
parameters, f = here.SCENES[sys.argv[2]]()
way, spp = sys.argv[3], int(sys.argv[4])
estimator = mcaa.Shared() if way == "shared" else mcaa.Auto()
def run(size, spp):
    picture = here.by_hand(f, size, int(spp**0.5)) if way == "hand" else mcaa.Supersampler((size, size), spp=spp, estimator=estimator)(f)
    picture.square().sum().backward()
run(16, 16)
def status(key):
    return next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith(key))
before = status("VmRSS")
run(here.SIZE, spp)
print((status("VmHWM") - before) / 1024)
"""


def memory(name: str) -> None:
    here = str(Path(__file__).parent)
    environment = {**os.environ, "MALLOC_MMAP_THRESHOLD_": "65536", "MALLOC_TRIM_THRESHOLD_": "65536"}
    cells = []
    for way in ("shared", "auto", "hand"):
        if way == "hand" and name != "shaded":
            cells.append("no gradient" if name in ("disc", "checkerboard") else "not tried: 6 GiB")
            continue
        peak = [
            float(
                subprocess.run(
                    [sys.executable, "-c", MEMORY, here, name, way, str(spp)],
                    capture_output=True,
                    text=True,
                    check=True,
                    env=environment,
                ).stdout
            )
            for spp in (16, 256)
        ]
        cells.append(f"{peak[0]:.0f}, {peak[1]:.0f} MiB: {peak[1] / peak[0]:.2f}")
    print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--scenes", nargs="*", default=list(SCENES))
    arguments = parser.parse_args()
    print(f"torch {torch.__version__}, {torch.get_num_threads()} threads, {SIZE} x {SIZE} pixels\n")
    print(
        "| scene, 64 samples | with jumps over without, Auto() | Shared() | Auto() over by hand | Shared() over by hand | Auto() |"
    )
    print("|---|---|---|---|---|---|")
    for name in arguments.scenes:
        compare(name, arguments.rounds)
    print("\n| scene, 16 and 256 samples | Shared() | Auto() | by hand |\n|---|---|---|---|")
    for name in arguments.scenes:
        memory(name)


if __name__ == "__main__":
    main()
