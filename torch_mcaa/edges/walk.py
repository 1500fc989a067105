"""Thin pieces followed over lines: foretold from the last two, on many at once, and bisected where they are found."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_mcaa.edges.bisect import Crossings, ask_on, bisect, joined
from torch_mcaa.edges.candidates import brackets
from torch_mcaa.edges.lines import Ask
from torch_mcaa.edges.pieces import SAME, Known, Numbered, Pieces, inside, place_of

STEEPEST = 3.0
"""Px a px: pieces that change their place faster from line to line are not followed along it."""
_WITHIN = 2.0**-10
"""Px: how far off its ends may be where the last two lines foretell them."""
_GOLDEN = (5**0.5 - 1) / 2
_STRIDE = 64
"""The most lines that a piece is foretold on at once."""
_TWICE = 5e-4
"""Px: crossings of one jump closer than this are one that was found twice."""


class Walk:
    """Pieces followed over lines; it gathers what it finds."""

    def __init__(
        self,
        ask: Ask,
        grid: Numbered,
        known: Known,
        wanted: Tensor,
        origin: tuple[int, int],
        finest: float,
        seed: int,
    ) -> None:
        self.ask, self.grid, self.known, self.wanted, self.origin = ask, grid, known, wanted, origin
        self.finest, self.seed, self.axis = finest, seed, grid.axis
        self.found: list[Crossings] = []
        self.reached: list[Tensor] = []

    def reached_mask(self, pieces: Pieces) -> Tensor:
        """Which pieces a walk ended at."""
        mask = torch.zeros(len(pieces), dtype=torch.bool, device=pieces.line.device)
        for index in self.reached:
            mask[index] = True
        return mask

    def follow(self, pieces: Pieces, direction: int, behind: Tensor) -> Tensor:
        """Follow pieces towards higher (+1) or lower (-1) lines; which of them were found on the next line."""
        width = pieces.width
        # the slopes, in px a line, from the piece on the line behind or from one close by
        slope1, slope2 = torch.zeros_like(width), torch.zeros_like(width)
        old = behind >= 0
        if bool(old.any()):
            there = self.known.pieces.take(behind[old])
            slope1[old], slope2[old] = pieces.first[old] - there.first, pieces.second[old] - there.second
        fresh = (~old).nonzero()[:, 0]
        alive = torch.ones(len(pieces), dtype=torch.bool, device=pieces.line.device)
        if len(fresh):
            near = pieces.take(fresh)
            step = 0.2 * torch.minimum(near.width, torch.full_like(near.first, 1 / self.grid.count))
            across = self.grid.across(near.line) + direction * step
            ok, one, two = self._meet(near, across, near.first, near.second, 0.6)
            per_line = 1 / (self.grid.count * step)
            slope1[fresh[ok]] = (one.place - near.first[ok]) * per_line[ok]
            slope2[fresh[ok]] = (two.place - near.second[ok]) * per_line[ok]
            alive[fresh[~ok]] = False
        steep = torch.minimum(slope1.abs(), slope2.abs()) * self.grid.count > STEEPEST
        alive &= ~steep
        moved = torch.zeros_like(alive)
        index = alive.nonzero()[:, 0]
        current, slope1, slope2 = pieces.take(index), slope1[index], slope2[index]
        # as many lines at once as went on as they were foretold
        stride, begun = torch.ones_like(index), False
        while len(index):
            walk = torch.arange(len(index), device=index.device).repeat_interleave(stride)
            ahead = 1 + torch.arange(len(walk), device=index.device) - (stride.cumsum(0) - stride)[walk]
            like = current.take(walk)
            line = like.line + direction * ahead
            first, second = like.first + ahead * slope1[walk], like.second + ahead * slope2[walk]
            middle, across = (first + second) / 2, self.grid.across(line)
            go = (second - first > 1e-3) & inside(self.wanted, self.origin, self.axis, middle, across)
            met = torch.where(go, self.known.at(line, first, second, like.inside, like.tolerance, 0.05), -1)
            clear = _until(~go | (met >= 0), walk, ahead, stride)
            asked = (ahead <= clear[walk]).nonzero()[:, 0]
            walked, one, two = self._next(
                like.take(asked), across[asked], first[asked], second[asked], walk[asked], ahead[asked], clear
            )
            self.found += [one, two]
            arrived = (met >= 0) & (walked == clear)[walk] & (ahead == 1 + clear[walk])
            self.reached.append(self.known.order[met[arrived]])
            if not begun:
                moved[index[walked > 0]] = True
                moved[index[walk[arrived]]] = True
                begun = True
            on = walked > 0
            on[walk[arrived]] = False
            # the crossings are those of the lines walked, one after another
            last = (walked.cumsum(0) - 1)[on]
            one, two, lines = one.take(last), two.take(last), walked[on]
            index, before = index[on], current.take(on)
            slope1, slope2 = (one.place - before.first) / lines, (two.place - before.second) / lines
            stride = torch.where(lines == stride[on], (2 * lines).clamp_max(_STRIDE), lines)
            colour = (one.after + two.before) / 2
            current = Pieces(before.line + direction * lines, one.place, two.place, one.before, colour, two.after)
        return moved

    def _next(
        self, like: Pieces, across: Tensor, first: Tensor, second: Tensor, walk: Tensor, ahead: Tensor, most: Tensor
    ) -> tuple[Tensor, Crossings, Crossings]:
        """How many lines each walk (W,) goes on for, and the crossings there.

        Of pieces foretold at [first, second] on the lines that are `ahead` (N,) of each `walk` (N,), up to the first that is not within `_WITHIN`
        of it; on the next line they are looked for as `_meet` does, too.
        """
        inner = torch.minimum((second - first) / 4, torch.full_like(first, _WITHIN))
        # the brackets of a straight edge would else err alike on all lines
        outer = _WITHIN * (0.75 + 0.5 * (self.grid.number(across) * _GOLDEN).frac())
        places = torch.stack([first - outer, first + inner, second - inner, second + outer])
        values = ask_on(self.ask, self.axis, places.flatten(), across.repeat(4)).unflatten(1, places.shape)
        told = torch.stack([like.before, like.inside, like.inside, like.after], 1)
        close = ((values - told).abs().amax(0) <= like.tolerance).all(0)
        where = (ahead <= _until(~close, walk, ahead, most)[walk]).nonzero()[:, 0]
        ok, one, two = self._ends(across[where], places[:, where], values[:, :, where])
        found = torch.zeros_like(close)
        found[where[ok]] = True
        far = (~close & (ahead == 1)).nonzero()[:, 0]
        if len(far):
            again, one_far, two_far = self._meet(like.take(far), across[far], first[far], second[far], 0.3)
            found[far[again]] = True
            order = torch.argsort(torch.cat([where[ok], far[again]]))
            one, two = joined([one, one_far]).take(order), joined([two, two_far]).take(order)
        walked = _until(~found, walk, ahead, most)
        kept = (ahead <= walked[walk])[found]
        return walked, one.take(kept), two.take(kept)

    def _meet(
        self, like: Pieces, across: Tensor, first: Tensor, second: Tensor, margin: float
    ) -> tuple[Tensor, Crossings, Crossings]:
        """Find the ends of pieces foretold at [first, second]: which were (N,), and the crossings of those at their two ends."""
        width, middle = second - first, (first + second) / 2
        places = torch.stack([first - margin * width, middle, middle, second + margin * width])
        values = ask_on(self.ask, self.axis, places[[0, 1, 3]].flatten(), across.repeat(3)).unflatten(1, (3, -1))
        a, b, c = values.unbind(1)
        ok = (b - like.inside).abs().amax(0) <= like.tolerance
        # each outer end must be of the colour beside the piece
        ok &= (a - like.before).abs().amax(0) <= (a - like.inside).abs().amax(0)
        ok &= (c - like.after).abs().amax(0) <= (c - like.inside).abs().amax(0)
        where = ok.nonzero()[:, 0]
        both, one, two = self._ends(across[where], places[:, where], values[:, :, where][:, [0, 1, 1, 2]])
        ok = torch.zeros_like(ok)
        ok[where[both]] = True
        return ok, one, two

    def _ends(self, across: Tensor, places: Tensor, values: Tensor) -> tuple[Tensor, Crossings, Crossings]:
        """Bisect the two ends of pieces, [places[0], places[1]] and [places[2], places[3]], with `values` (C, 4, N)."""
        count, line = len(across), self.grid.number(across)
        before, after = values[:, [0, 2]].flatten(1), values[:, [1, 3]].flatten(1)
        lines = line.repeat(2)
        segments = brackets(
            self.axis,
            across.repeat(2),
            places[[0, 2]].flatten(),
            places[[1, 3]].flatten(),
            before,
            after,
            self.grid.phase(lines),
            lines,
        )
        got = bisect(self.ask, segments, self.finest, self.seed)
        # one clear jump, or it is not the end of the piece
        clear = got.jump.abs().amax(0) > 0.5 * (after - before).abs().amax(0)[got.segment]
        got = got.take(clear.nonzero()[:, 0])
        single = torch.bincount(got.segment, minlength=2 * count) == 1
        both = single[:count] & single[count:]
        got = got.take(both[got.segment % max(1, count)].nonzero()[:, 0])
        return both, got.take(got.segment < count), got.take(got.segment >= count)

    def with_found(self, crossings: Crossings) -> Crossings:
        """The crossings and those found, of a crossing found twice only one."""
        if not self.found:
            return crossings
        everything = joined([crossings, *self.found])
        place = place_of(self.grid.number(everything.across), everything.place)
        order = torch.argsort(place)
        width = everything.width[order]
        same = (place[order][1:] - place[order][:-1] < (_TWICE + (width[1:] + width[:-1]) / 2)) & (
            (everything.jump[:, order][:, 1:] - everything.jump[:, order][:, :-1]).abs().amax(0)
            < SAME * everything.jump[:, order][:, 1:].abs().amax(0)
        )
        new = torch.ones(len(order), dtype=torch.bool, device=order.device)
        new[1:] = ~same
        return everything.take(order[new])


def _until(end: Tensor, walk: Tensor, ahead: Tensor, most: Tensor) -> Tensor:
    """(W,): how many lines of each walk come before its first `end` (N,), at most `most` (W,)."""
    return most.scatter_reduce(0, walk, torch.where(end, ahead - 1, most[walk]), "amin")
