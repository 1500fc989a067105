"""What is made of f's decisions while they pass: signatures of points, the cause of a change, margins."""

from __future__ import annotations

import functools

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.traced.trace import Lanes, Site

_LANE = 0x1A9E
MANY = 62
_FEW = 8
"""Lanes that are summed one by one, which takes no memory."""


class Signatures:
    """A visitor: one int64 a point, equal where all decisions that move are."""

    def __init__(self, device: torch.device) -> None:
        self.device = device
        self._sum: Tensor | None = None

    def signatures(self, count: int) -> Tensor:
        """(count,): of the first points."""
        return torch.zeros(count, dtype=torch.int64, device=self.device) if self._sum is None else self._sum[:count]

    def __call__(self, number: int, lanes: Lanes, site: Site) -> None:
        if site.moves:
            self.add(number, lanes.codes())

    def add(self, number: int, codes: Tensor) -> None:
        """The sum of the codes times random numbers, modulo 2^64."""
        if self._sum is None:
            self._sum = torch.zeros(len(codes), dtype=torch.int64, device=codes.device)
        if codes.is_floating_point():
            codes = codes.to(torch.int64)
        if codes.shape[1] > _FEW:
            factors = torch.tensor([_factor(number, lane) for lane in range(codes.shape[1])], device=codes.device)
            self._sum.add_((codes * factors).sum(1))
            return
        for lane, code in enumerate(codes.unbind(1)):
            self._sum.add_(code, alpha=_factor(number, lane))


@functools.cache
def _factor(number: int, lane: int) -> int:
    """A random odd number of 64 bits, with a sign."""
    low, high = (int(rng.bits(_LANE, number, lane, half)) for half in (0, 1))
    return ((high << 32 | low | 1) + (1 << 63)) % (1 << 64) - (1 << 63)


class Causes(Signatures):
    """A visitor: the first moving decision in which neighbours differ, of points (R, K) in one row: pairs along `axis`, n of them.

    Attributes:
        cause: (n,) its number, -1 where none differs, and one that has a margin before all that have none; branch: (n, 3) lane and codes at the
            first and at the second.
        margin: (2, n) of that decision, at both points; total: their sum, with a graph, if `sloped`.
        differing: (n,) int64, a bit for each decision that differs; number `MANY` and all after it have one bit.
        behind: (n,) bool, if `sloped`: one that does not move differs before it, so that its margin may jump.
        rival: (4, n), if `sloped`: the number of one that differs too, in another lane or later and not depending on the cause, and its
            branch; -1 where there is none.
    """

    def __init__(self, shape: tuple[int, int], axis: int, sloped: bool, device: torch.device) -> None:
        super().__init__(device)
        self.shape, self.axis, self.sloped = shape, axis, sloped
        rows, columns = shape
        self.pairs = (rows - 1) * columns if axis == 0 else rows * (columns - 1)
        self.cause = torch.full((self.pairs,), -1, dtype=torch.int64, device=device)
        self.branch = self.cause.new_zeros(self.pairs, 3)
        self.margin = torch.zeros(2, self.pairs, dtype=torch.float64, device=device)
        self.total: Tensor | None = None
        self.differing = torch.zeros_like(self.cause)
        self.behind = torch.zeros(self.pairs, dtype=torch.bool, device=device)
        self.rival = self.cause.new_full((4, self.pairs), -1)
        self._met: list[int] = []
        self._blind = torch.zeros_like(self.behind)

    def __call__(self, number: int, lanes: Lanes, site: Site) -> None:
        if not (site.moves or self.sloped):
            return
        codes = lanes.codes()
        if site.moves:
            self.add(number, codes)
        laid = codes[: self.shape[0] * self.shape[1]].view(*self.shape, -1)
        size = self.shape[self.axis] - 1
        differs = (laid.narrow(self.axis, 0, size) != laid.narrow(self.axis, 1, size)).view(self.pairs, -1)
        # most points change nowhere: few operations on all of them
        new = (differs[:, 0] if differs.shape[1] == 1 else differs.any(1)).nonzero()[:, 0]
        if site.moves and len(new):
            self.differing[new] |= 1 << min(number, MANY)
            if self.sloped and not lanes.blind:
                beside = self._beside(number, site, new, differs)
                # the last lane: a cause is the first
                lane = differs.shape[1] - 1 - differs[beside].flip(1).to(torch.int8).argmax(1)
                self.rival[:, beside] = torch.cat([torch.full_like(lane, number)[None], self._branch(codes, beside, lane).T])
        new = new[(self.cause[new] < 0) | (self._blind[new] & (not lanes.blind))]
        if not site.moves:
            self.behind[new] = True
            return
        if len(new) == 0:
            return
        self.cause[new] = number
        branch = self.branch[new] = self._branch(codes, new, differs[new].to(torch.int8).argmax(1))
        self._blind[new] = lanes.blind
        if lanes.blind:
            return
        margin = lanes.margin(torch.cat(self._ends(new)), branch.repeat(2, 1), self.sloped)
        self.margin[:, new] = margin.detach().to(torch.float64).view(2, -1)
        if self.sloped:
            # f may run this part of it under no_grad
            with torch.enable_grad():
                self.total = margin.sum() if self.total is None else self.total + margin.sum()

    def _ends(self, pairs: Tensor) -> tuple[Tensor, Tensor]:
        """The points of pairs: the first and the second."""
        first = pairs if self.axis == 0 else pairs + pairs // (self.shape[1] - 1)
        return first, first + (self.shape[1] if self.axis == 0 else 1)

    def _branch(self, codes: Tensor, pairs: Tensor, lane: Tensor) -> Tensor:
        """(m, 3): the lanes (m,) and the codes there at both points."""
        return torch.stack([lane, *(codes[end, lane].long() for end in self._ends(pairs))], 1)

    def _beside(self, number: int, site: Site, pairs: Tensor, differs: Tensor) -> Tensor:
        """Those of the pairs in which a decision differs that are caused by another, which it does not follow, or by it in two lanes or more."""
        cause = self.cause[pairs]
        others = torch.tensor([k for k in self._met if not site.decisions >> k & 1], dtype=torch.int64, device=pairs.device)
        self._met.append(number)
        beside = torch.isin(cause, others)
        if differs.shape[1] > 1:
            beside |= (cause < 0) & (differs[pairs].sum(1) > 1)
        return pairs[beside]


class Margins(Signatures):
    """A visitor: the margins `total` (N,) of the points' own causes, and the signatures."""

    def __init__(self, cause: Tensor, branch: Tensor, graph: bool) -> None:
        super().__init__(cause.device)
        self.graph = graph
        self.cause, self.branch = cause, branch
        self.wanted = set(cause.unique().tolist())
        self.total = torch.zeros(len(cause), dtype=torch.float64, device=cause.device)

    def __call__(self, number: int, lanes: Lanes, site: Site) -> None:
        super().__call__(number, lanes, site)
        if number in self.wanted and not lanes.blind:
            point = (self.cause == number).nonzero()[:, 0]
            with torch.set_grad_enabled(self.graph):
                margin = lanes.margin(point, self.branch[point], self.graph).to(torch.float64)
                self.total = self.total.index_add(0, point, margin)
