"""Does f jump where no decision was seen? Bisection on values where the signatures agree."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.filters import Box
from torch_mcaa.grid import Screen
from torch_mcaa.integrand import Function
from torch_mcaa.rng import check_seed
from torch_mcaa.traced.asked import Asked
from torch_mcaa.traced.boundary import elements
from torch_mcaa.traced.inside import transformed
from torch_mcaa.traced.pieces import HALVED, Pieces, pieces
from torch_mcaa.traced.program import Program, probe

STEPS, PART = 36, 1e-3
"""What is no jump, in changes over a piece: of a bend 2^-30 is left, or what float32 rounds to."""
_SELDOM = 8
_NARROW = 8
"""As `narrow` says of 32 samples."""
_TOUCHED = 0.05
"""Of the largest jump: less is the foot of a wider ramp, at which a piece ends."""
_CELL = 64
_MOST = 1 << 16
"""Segments looked at."""
_FOLLOWED = 1024
_NAMED = 8


def narrow(spp: int) -> int:
    """Halvings of 1 px until what is left is met by next to no sample of so many a pixel: by one in `_SELDOM` pixels of an edge."""
    return math.ceil(math.log2(_SELDOM * spp))


@dataclass(frozen=True)
class Jump:
    """A jump, or a ramp like one, that no decision explains: screen column and row in pixels, f's x and y, and its size (largest channel)."""

    col: float
    row: float
    x: float
    y: float
    size: float


@dataclass(frozen=True)
class Discontinuities:
    """What `check_discontinuities` found; `str` of it is a report.

    Attributes:
        decisions: (file:line, operation, jumps met on lines across the screen) for every decision of f.
        jumps: those that no decision explains.
        ramps: changes within 2^-8 px that no decision explains, to all samples a jump.
        problems: sentences about what the trace cannot follow.
        probes: how many pieces of lines were looked at, and followed.
        random: f gave two values for one point: it is random, or mixes the points that it is asked for at once.
    """

    decisions: tuple[tuple[str, str, int], ...]
    jumps: tuple[Jump, ...]
    ramps: tuple[Jump, ...]
    problems: tuple[str, ...]
    probes: tuple[int, int]
    random: bool

    @property
    def ok(self) -> bool:
        """Every jump that was met is one that gradients can follow."""
        return not (self.jumps or self.ramps or self.problems or self.random)

    def __str__(self) -> str:
        lines = [f"decisions of f ({len(self.decisions)}), and the jumps that lines across the screen met there:"]
        lines += [f"  {where}  {name}: {count or 'none'}" for where, name, count in self.decisions] or ["  none"]
        if self.random:
            lines.append(
                "f is random, or mixes the points it is asked for: it gave two values for one point, so that nothing else can be said"
            )
        if self.problems:
            lines += ["what the trace cannot follow:", *(f"  {problem}" for problem in self.problems)]
        if self.jumps:
            lines.append(f"jumps that no decision explains ({len(self.jumps)} of {self.probes[1]} places that were followed):")
            lines += _named(self.jumps)
            lines.append(
                "  their gradients are missing: declare the jump inside f with torch_mcaa.level_set(g), g crossing zero there"
            )
        if self.ramps:
            lines.append(
                f"ramps within 1/{2**_NARROW} px that no decision explains ({len(self.ramps)} of {self.probes[1]} places that were followed):"
            )
            lines += _named(self.ramps)
            lines.append(
                "  next to no sample meets them, and gradients of what moves them are missing, or noise: let f decide, as by g > 0 in the place of a "
                "ramp across g = 0"
            )
        if not (self.jumps or self.ramps or self.random):
            lines.append(f"no other jump in {self.probes[0]} pieces of lines")
        return "\n".join(lines)


def _named(jumps: tuple[Jump, ...]) -> list[str]:
    """A line for each of the first ones."""
    lines = [f"  at column {j.col:.3f}, row {j.row:.3f} (x = {j.x:.6g}, y = {j.y:.6g}): {j.size:.3g}" for j in jumps[:_NAMED]]
    return lines if len(jumps) <= _NAMED else [*lines, f"  and {len(jumps) - _NAMED} more"]


def check_discontinuities(
    f: Function,
    size: tuple[int, int],
    *,
    extent: tuple[float, float, float, float] | None = None,
    seed: int = 0,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str | None = None,
) -> Discontinuities:
    """Where does f jump, which lines of its code decide that, and does it jump anywhere else, where no gradient follows?

    >>> import torch
    >>> radius = torch.tensor(5.0, requires_grad=True)
    >>> report = check_discontinuities(lambda x, y: (torch.hypot(x - 8, y - 8) < radius).float(), (16, 16))
    >>> report.ok, len(report.decisions), report.decisions[0][1]
    (True, 1, 'lt')

    Args:
        f, size, extent, seed, dtype, device: as for `render`.

    Raises:
        McaaError: f breaks its contract, or its Python control flow depends on values.
    """
    if transformed():
        raise McaaError(
            "an audit cannot be made inside a transform of functions (torch.func.grad, vmap and the like); make it outside"
        )
    screen, placed = Screen.of(size, extent), torch.device("cpu" if device is None else device)
    check_seed(seed)
    if not callable(f):
        raise McaaError(f"f must be a function of two tensors x, y, got {type(f).__name__}")
    program = probe(f, screen, dtype, placed)
    counts: Counter[int] = Counter()
    problems = dict.fromkeys(program.problems)
    fixed = tuple(f"{site.where}: {site.name} " for site in program.sites if not site.moves)
    for cell in screen.cells(_CELL, _CELL):
        met = elements(f, screen, cell, Box(), seed, 1, closed=True, program=program, fixed=True, dtype=dtype, device=placed)
        counts.update(met.cause.tolist())
        problems.update((p, None) for p in met.problems if not p.startswith(fixed))
    jumps, ramps, probes, random = untraced(
        f, screen, program, seed, dtype, placed, min(_MOST, 2 * screen.height * screen.width), _FOLLOWED
    )
    decisions = tuple((site.where, site.name, counts[number]) for number, site in enumerate(program.sites))
    return Discontinuities(decisions, jumps, ramps, tuple(problems), probes, random)


@torch.no_grad()
def untraced(
    function: Function,
    screen: Screen,
    program: Program,
    seed: int,
    dtype: torch.dtype,
    device: torch.device,
    looked: int,
    followed: int,
) -> tuple[tuple[Jump, ...], tuple[Jump, ...], tuple[int, int], bool]:
    """The jumps, and the narrow ramps, on `looked` random pieces of lines of up to 1 px, of which the `followed` sharpest are bisected.

    A piece counts only while its ends, and all places asked between them, have one signature. With the jumps come the numbers of pieces
    that were looked at and followed, and whether f is random.
    """
    asked = Asked(function, screen, program.all_moving(), dtype, device, None)
    some = pieces(asked, seed, looked, followed)
    if some is None:
        return (), (), (looked, 0), True
    part = some.halved(asked, _NARROW - HALVED)
    left = part.halved(asked, STEPS - _NARROW)
    least = _TOUCHED * some.size().amax() if len(some) else 0.0
    thin = part.take((part.left() > 0.5) & part.stands_out() & (part.size() > least))
    thin = thin.take(thin.alone(asked))
    ends = thin.halved(asked, STEPS - _NARROW)
    jump, ramp = left.take((left.left() > PART) & left.stands_out()), ends.take(ends.left() <= PART)
    jumps, ramps = _largest(screen, jump, jump.jump), _largest(screen, ramp, ramp.change)
    return jumps, ramps, (looked, len(some)), False


def _largest(screen: Screen, some: Pieces, jumps: Tensor) -> tuple[Jump, ...]:
    """Where the parts lie, with their jumps (C, N) in the channel where they are sharpest, the largest first."""
    cols, rows = some.at(some.high)
    size = jumps.gather(0, some.channel(jumps)[None])[0]
    planes = (cols, rows, screen.x_of(cols), screen.y_of(rows), size)
    return tuple(Jump(*(float(plane[k]) for plane in planes)) for k in torch.argsort(size, descending=True).tolist())
