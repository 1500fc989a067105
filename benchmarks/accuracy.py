"""The error of every method over families of scenes: `python benchmarks/accuracy.py [--seeds 200]` prints the tables of the README."""

from __future__ import annotations

import argparse

from families import FAMILIES, Method, estimator, grid_and_blur, score

import torch_mcaa as mcaa

METHODS: dict[str, dict[int, Method]] = {
    "Importance(Independent())": {n: estimator(mcaa.Importance(mcaa.Independent()), n) for n in (16, 64)},
    "Importance(MultiJittered())": {n: estimator(mcaa.Importance(mcaa.MultiJittered()), n) for n in (16, 64)},
    "Importance(Sobol())": {n: estimator(mcaa.Importance(mcaa.Sobol()), n) for n in (16, 64)},
    "Shared(Jittered())": {n: estimator(mcaa.Shared(mcaa.Jittered()), n) for n in (16, 64)},
    "Shared(Sobol())": {n: estimator(mcaa.Shared(mcaa.Sobol()), n) for n in (16, 64)},
    "Shared(Lattice(), replicates=2)": {n: estimator(mcaa.Shared(replicates=2), n) for n in (16, 64)},
    "Shared(Lattice())": {n: estimator(mcaa.Shared(), n) for n in (16, 64)},
    "grid + Gaussian blur": {16: grid_and_blur(4), 64: grid_and_blur(8)},
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--methods", default="")
    arguments = parser.parse_args()
    for spp in (16, 64):
        print(f"\n| {spp} a pixel | " + " | ".join(FAMILIES) + " |\n|" + "---|" * (len(FAMILIES) + 1))
        for name, methods in METHODS.items():
            if arguments.methods in name:
                scores = [score(family, methods[spp], arguments.seeds) for family in FAMILIES]
                print(f"| {name} | " + " | ".join(f"{s.rmse:.1e}" for s in scores) + " |", flush=True)
                if not name.startswith("grid"):
                    print(
                        "| reported / true, coverage | " + " | ".join(f"{s.ratio:.2f} {s.coverage:.2f}" for s in scores) + " |",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
