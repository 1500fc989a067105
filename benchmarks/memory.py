"""Memory and time of large pictures by the shared lattice: `python benchmarks/memory.py` prints a table.

Three channels at 16 evaluations a pixel; `--large` adds 8192 x 8192 pixels (some 4 GiB and minutes).
"""

from __future__ import annotations

import argparse
import subprocess
import sys

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
    parser.add_argument("--large", action="store_true")
    arguments = parser.parse_args()
    print("| size | time | ns a pixel | results, MiB | peak above the results, MiB |\n|---|---|---|---|---|")
    for size in (512, 2048, *((8192,) if arguments.large else ())):
        run = subprocess.run([sys.executable, "-c", LARGE, str(size)], capture_output=True, text=True, check=True)
        print(run.stdout.strip(), flush=True)


if __name__ == "__main__":
    main()
