"""Gradients through edges: `python benchmarks/gradients.py [--seeds 200]` prints bias and standard deviation of derivative images.

12 x 12 pixels, 64 evaluations of f a pixel in all: those that the scan for edges leaves are samples of a lattice, whose derivative automatic
differentiation gives. The truth is a central difference of closed forms in float64. Columns in per cent of the root mean square
of the true derivative image: what plain automatic differentiation misses; the bias of ours, with its Monte Carlo error; its standard deviation.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass

import torch
from jumping import FILTERED, MORE, SIZE, TABLE, THIN, Case
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.filters import Filter
from torch_mcaa.grid import Cell, Screen
from torch_mcaa.integrand import Function
from torch_mcaa.traced.boundary import LINES, Elements, elements, margins, splat

EVALUATIONS = 64


def interior(case: Case, seed: int, spp: int) -> Tensor:
    """(C, H, W): the derivative of the samples, by automatic differentiation; 0 where only edges depend on the parameter."""

    def tangent(x: Tensor, y: Tensor) -> Tensor:
        # a parameter of each point's own
        theta = torch.full_like(x, case.theta).requires_grad_()
        with torch.enable_grad():
            (slope,) = torch.autograd.grad(case.make(theta)(x, y).sum(), theta)
        return slope

    if not case.inner:
        return torch.zeros(1, *SIZE, dtype=torch.float64)
    return mcaa.render(tangent, SIZE, filter=case.filter, estimator=mcaa.Shared(), spp=spp, seed=seed, dtype=torch.float64).image


def edges(case: Case, seed: int, lines: int) -> tuple[Tensor, float]:
    """(C, H, W): the boundary term's derivative; and the evaluations a pixel that it took."""
    theta = torch.tensor(case.theta, dtype=torch.float64, requires_grad=True)
    f, screen, spent = case.make(theta), Screen.of(SIZE), [0]

    def tally(col: Tensor, row: Tensor) -> None:
        spent[0] += int(((col >= 0) & (col < SIZE[1]) & (row >= 0) & (row < SIZE[0])).sum())

    met = elements(f, screen, Cell(0, 0, *SIZE), case.filter, seed, lines, dtype=torch.float64, tally=tally)
    # the margins are asked for once more
    tally(met.col, met.row)
    return boundary_image(f, screen, met, case.filter, theta), spent[0] / (SIZE[0] * SIZE[1])


def boundary_image(f: Function, screen: Screen, met: Elements, filter: Filter, theta: Tensor) -> Tensor:
    """(C, H, W): the derivative of the boundary term by a scalar."""
    picture = torch.zeros(len(met.jump), screen.height * screen.width, dtype=torch.float64)
    if len(met):
        # the derivative of a gradient by what it is linear in gives every margin's own
        unit = torch.ones(len(met), dtype=torch.float64, requires_grad=True)
        (total,) = torch.autograd.grad((unit * margins(f, screen, met)).sum(), theta, create_graph=True)
        (slope,) = torch.autograd.grad(total, unit)
        rows, cols, weights = splat(met, screen, filter)
        amount = met.jump[:, :, None] * ((slope * met.weight)[:, None] * weights)
        picture.index_add_(1, (rows * screen.width + cols).flatten(), amount.flatten(1))
    return picture.view(-1, screen.height, screen.width)


@dataclass(frozen=True)
class Score:
    """In per cent of the true derivative image: plain differentiation's error, ours, what of it chance explains, standard deviation."""

    plain: float
    bias: float
    chance: float
    deviation: float
    evaluations: float


def score(case: Case, seeds: int, lines: int = LINES) -> Score:
    """Of `seeds` independent derivative images."""
    truth = case.derivative()
    scale = float(truth.square().mean().sqrt()) / 100
    images, plain, spent = [], [], 0.0
    for seed in range(seeds):
        edge, evaluations = edges(case, seed, lines)
        inner = interior(case, seed, max(1, round(EVALUATIONS - evaluations)))
        images.append(inner + edge)
        plain.append(inner)
        spent += evaluations / seeds
    spread = torch.stack(images).var(0).mean().sqrt()
    return Score(
        float((torch.stack(plain).mean(0) - truth).square().mean().sqrt()) / scale,
        float((torch.stack(images).mean(0) - truth).square().mean().sqrt()) / scale,
        float(spread) / math.sqrt(seeds) / scale,
        float(spread) / scale,
        spent,
    )


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--lines", type=int, default=LINES)
    parser.add_argument("--cases", default="")
    chosen = parser.parse_args(arguments)
    print(
        "| derivative | plain AD misses | bias (chance) | standard deviation | asked | evaluations of the scan a pixel |\n|"
        + "---|" * 6
    )
    for case in (*TABLE, *MORE, *THIN, *FILTERED):
        if chosen.cases in case.name:
            s = score(case, chosen.seeds, chosen.lines)
            asked = "–" if math.isnan(case.asked) else f"{case.asked} %"
            print(
                f"| {case.name} | {s.plain:.0f} % | {s.bias:.2f} % ({s.chance:.2f} %) | {s.deviation:.2f} % | {asked} | {s.evaluations:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
