"""Samples a second on a CUDA device against what the card can do, for eager blocks, the compiled graph, and the graph captured and replayed.

`python benchmarks/gpu.py` prints the table and writes it to `benchmarks/results/gpu.json` with the card and the date. Two ceilings are
measured in the same run: a device-to-device copy (bytes read and written), and f alone on points that are there already, its result summed
and not kept. The splat reads and writes memory several times a sample; what it would take at the copy's speed is the third ceiling.
"""

from __future__ import annotations

import argparse
import datetime
import json
import statistics
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.arguments import task_of
from torch_mcaa.estimators import Shared
from torch_mcaa.estimators.lattice.audit import Audit
from torch_mcaa.estimators.lattice.fused import Fused
from torch_mcaa.estimators.lattice.lattice_weights import LatticeWeights
from torch_mcaa.grid import Cell, Screen
from torch_mcaa.patterns import Lattice

RESULTS = Path(__file__).parent / "results" / "gpu.json"


def disc(x: Tensor, y: Tensor) -> Tensor:
    return (torch.hypot(x - 512, y - 512) < 400).float()


def zone_plate(x: Tensor, y: Tensor) -> Tensor:
    return 0.5 + 0.5 * torch.cos((x * x + y * y) * 0.003)


def colours(x: Tensor, y: Tensor) -> tuple[Tensor, ...]:
    return torch.sin(x * 0.01), (torch.hypot(x - 300, y - 300) < 200).float(), torch.cos(y * 0.02)


SCENES = {"disc": disc, "zone plate": zone_plate, "three channels": colours}


def seconds(work: Callable[[], object], repeats: int = 15) -> float:
    """The median time of `work` on the device, host included, after two warm-ups."""
    times = []
    for number in range(repeats + 2):
        begin, end = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
        torch.cuda.synchronize()
        begin.record()
        work()
        end.record()
        torch.cuda.synchronize()
        if number > 1:
            times.append(begin.elapsed_time(end) * 1e-3)
    return statistics.median(times)


def copy_rate() -> float:
    """Bytes a second, read and written."""
    source = torch.rand(2**28, device="cuda")
    target = torch.empty_like(source)
    return 2 * source.numel() * 4 / seconds(lambda: target.copy_(source))


def function_rate(f: Callable[[Tensor, Tensor], Tensor | tuple[Tensor, ...]]) -> float:
    """Points a second of f compiled alone, the results summed: what its arithmetic takes with nothing to write."""
    x, y = (torch.rand(2**24, device="cuda") * 1024 for _ in "xy")

    def summed(x: Tensor, y: Tensor) -> Tensor:
        values = f(x, y)
        return sum((v.sum() for v in values[1:]), values[0].sum()) if isinstance(values, tuple) else values.sum()

    compiled = torch.compile(summed, fullgraph=True, dynamic=False)
    return x.numel() / seconds(lambda: compiled(x, y))


def captured(f: Callable[..., object], size: int, spp: int) -> tuple[float, int]:
    """Seconds of the compiled graph of one cell as large as the picture, replayed, and its samples."""
    task = task_of(f, Screen.of((size, size)), mcaa.Gaussian(0.5), "extend", "raise", 0, torch.float32, "cuda")
    strip = Lattice().strip(spp, 0, True, (0.3, 0.6))
    weights = LatticeWeights(task, strip)
    height, width = Shared().cell(task, spp, False)
    cell = Cell(0, 0, min(height, size), min(width, size))
    fused = Fused(weights, Audit(task, strip, 0), cell.height, cell.width)
    at = weights.geometry(cell)
    fused.weigh(cell, at)
    inputs = fused.inputs(cell, at)
    graph = torch.cuda.CUDAGraph()
    with torch.no_grad(), torch.cuda.graph(graph):
        fused.graph(*inputs)
    return seconds(graph.replay), fused.strips * inputs[0].numel()


def rates(name: str, size: int, spp: int, compile: bool) -> dict[str, float]:
    """Samples a second of whole pictures: of `Shared` and `Auto` by eager blocks, or of `Shared` compiled and its graph alone, captured."""
    f = SCENES[name]

    def rate(estimator: mcaa.Estimator, repeats: int) -> float:
        def render() -> None:
            mcaa.render(f, (size, size), estimator=estimator, spp=spp, compile=compile, device="cuda", progress=False)

        return size * size * spp / seconds(render, repeats)

    if not compile:
        return {"eager": rate(Shared(), 15), "auto": rate(mcaa.Auto(), 5)}
    took, samples = captured(f, size, spp)
    return {"compiled": rate(Shared(), 15), "captured": samples / took}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=RESULTS)
    arguments = parser.parse_args()
    if not torch.cuda.is_available():
        raise SystemExit("benchmarks/gpu.py needs a CUDA device, and there is none here")
    torch.set_grad_enabled(False)
    copied = copy_rate()
    tasks = [(name, size, 16) for name in SCENES for size in (1024, 4096)]
    # first what is not compiled: the compiler's helpers take the processor while they start
    eager = [rates(*task, compile=False) for task in tasks]
    alone = {name: function_rate(f) for name, f in SCENES.items()}
    rows = []
    print(f"{torch.cuda.get_device_name()}, torch {torch.__version__}; copy: {copied / 1e12:.2f} TB/s\n")
    print(
        "| 10⁹ samples a second | eager | compiled | captured | `Auto` | ceiling: f alone | ceiling: memory |\n|---|---|---|---|---|---|---|"
    )
    for (name, size, spp), plain in zip(tasks, eager, strict=True):
        # a sample is written once and read for the taps, the two sums along x written and read
        memory = copied / (6 * 4 * (3 if name == "three channels" else 1))
        found = {"f alone": alone[name], **plain, **rates(name, size, spp, compile=True), "memory": memory}
        rows.append({"scene": name, "size": size, "spp": spp, **found})
        shown = " | ".join(f"{found[key] / 1e9:.2f}" for key in ("eager", "compiled", "captured", "auto", "f alone", "memory"))
        print(f"| {name} {size}², {spp} | {shown} |", flush=True)
    arguments.output.parent.mkdir(exist_ok=True)
    facts = {
        "card": torch.cuda.get_device_name(),
        "date": datetime.date.today().isoformat(),
        "torch": torch.__version__,
        "copy, bytes a second": copied,
        "samples a second": rows,
    }
    arguments.output.write_text(json.dumps(facts, indent=1) + "\n")


if __name__ == "__main__":
    main()
