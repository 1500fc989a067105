"""One shift of a lattice corrected for the jumps along its lines: each pixel along the axis that its edges cross."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.edges.bisect import Crossings, bisect_all, joined, placed, sided
from torch_mcaa.edges.candidates import Finder, Segments, without
from torch_mcaa.edges.candidates import joined as together
from torch_mcaa.edges.chains import between, continued
from torch_mcaa.edges.correction import Window
from torch_mcaa.edges.ends import ends
from torch_mcaa.edges.foretell import narrowed_all
from torch_mcaa.edges.lines import Lines, norm, scattered, summed
from torch_mcaa.edges.pixels import Pixels
from torch_mcaa.estimators.base import dilated
from torch_mcaa.estimators.located.blocks import told
from torch_mcaa.estimators.located.counted import Counted, Spent, on_screen
from torch_mcaa.estimators.located.regular import regular
from torch_mcaa.estimators.located.sides import sides
from torch_mcaa.estimators.located.thin_pieces import THINNEST, ThinPieces, share_of, widened
from torch_mcaa.integrand import BLOCK as INTEGRAND
from torch_mcaa.integrand import width_of
from torch_mcaa.patterns import Lattice

FEWEST_LINES = 3
"""Of a lattice whose jumps are to be located."""
_PREFERRED = 1.15
"""What the horizontal lines' density of jumps is multiplied by, so that chance does not choose where both are alike."""
_CORE = 0.03
"""A pixel's share of the greatest density of jumps around it, from which on a second shift is made for it."""
_NONE = 0.05
_DECIDED = 0.5
"""Of a decision whose jump is not known, what it counts for in means of all."""
_SHIFT = 0x11E5
_AT_ONCE = 4 * INTEGRAND
"""Samples of a shift that are held at a time."""


def odd(count: int) -> int:
    """Points of a lattice, no more than so many: it has an odd number."""
    return count - 1 + count % 2


@dataclass(frozen=True)
class Axes:
    """What the axes count for in some pixels (P,): `share`, that of crossings along x, and where it has to be left open; open elsewhere."""

    pixels: Pixels
    share: Tensor
    open: Tensor

    def used(self, axis: int, wanted: Tensor) -> Tensor:
        """Which pixels of `wanted`, bool (h, w), need the crossings along an axis."""
        used, at = wanted.clone(), (self.pixels.rows, self.pixels.cols)
        used[at] &= (self.share > 0 if axis == 0 else self.share < 1) | self.open
        return used


@dataclass(frozen=True)
class Level:
    """One shift's result in some pixels, (P,) or (C, P).

    Attributes:
        value: `plain` the weighted mean of its samples alone; `spread` the variance of its brackets.
        near: bool, the pixels whose filter reaches a crossing; `core` those where it weighs much.
        crossings: along either axis, on the `lines`.
        axes: what they count for; for another shift, one axis alone where thin pieces are.
    """

    pixels: Pixels
    value: Tensor
    plain: Tensor
    spread: Tensor
    near: Tensor
    core: Tensor
    crossings: list[Crossings]
    lines: Lines
    axes: Axes


class Leveller:
    """Shifts of lattices over the cell that f is asked in.

    Attributes:
        plain: (C, h, w) the weighted means of a lattice that was sampled everywhere.
        finest: px, how narrow a bracket has to be.
        thin: the thin pieces, and the blocks that are lost to sampling.
    """

    def __init__(self, ask: Counted, seed: int, plain: Tensor) -> None:
        self.ask, self.cell, self.seed, self.plain = ask, ask.cell, seed, plain
        self.window = Window(ask.task.filter, plain.device)
        self.finest, self.thin = 0.0, ThinPieces(ask, self.window)
        self.smooth = self.deciding = self.plain.new_zeros(0)

    def worthwhile(self, found: list[Segments]) -> list[Segments]:
        """The segments without those whose decisions do not make f jump, which are left out on other shifts, too."""
        from torch_mcaa.estimators.located.decided import worthwhile

        found, self.smooth, self.deciding = worthwhile(self.ask, self.cell, found, self.seed)
        return found

    def pixels(self, mask: Tensor) -> Pixels:
        """Those of a mask of the cell, bool (h, w)."""
        return Pixels(self.cell.row, self.cell.col, mask, self.window.margin)

    def axes(self, found: Sequence[Segments]) -> tuple[Axes, list[Tensor]]:
        """What the axes count for as far as candidates tell, and what either sees (P,)."""
        window = self.window
        middles = [((s.low + s.high) / 2, s.across) for s in found]
        pixels = self.pixels(self.reached(middles))
        seen = [window.density(pixels, s.axis, *middle, _sizes(s)) for s, middle in zip(found, middles, strict=True)]
        share, open_ = _share(*seen), seen[0] + seen[1] == 0
        # how often samples hit a thin piece says little of its direction; along the other axis it may end up to 1 px beyond the last hit
        for segments, (along, across) in zip(found, middles, strict=True):
            if bool(segments.single.any()):
                hits = segments.single.to(torch.float64)
                hit = pixels.plane(window.density(pixels, segments.axis, along, across, hits) > 0)
                open_ |= dilated(hit, 1)[pixels.rows, pixels.cols]
        return Axes(pixels, share, open_), seen

    def reached(self, places: Sequence[tuple[Tensor, Tensor]]) -> Tensor:
        """The pixels (h, w) whose filter may reach places on lines along x and along y."""
        reach, cell = self.window.reach, self.cell
        mask = torch.zeros(cell.height + 2 * reach, cell.width + 2 * reach, dtype=torch.bool, device=self.window.device)
        for axis, (along, across) in enumerate(places):
            x, y = placed(axis, along, across)
            row, col = y.floor().long() - (cell.row - reach), x.floor().long() - (cell.col - reach)
            inside = (row >= 0) & (row < mask.shape[0]) & (col >= 0) & (col < mask.shape[1])
            mask[row[inside], col[inside]] = True
        return dilated(mask, reach)[reach:-reach, reach:-reach]

    def shift(self, count: int, number: int, wanted: Tensor, known: Level | None = None) -> Level:
        """A shift of a lattice of `count`, asked as far as the pixels `wanted` (h, w) need it; the axes of `known` are taken over."""
        window, halo, cell = self.window, self.window.halo, self.cell
        sx, sy = (float(rng.uniform(self.seed, _SHIFT, number, axis, dtype=torch.float64)) for axis in (0, 1))
        strip = Lattice().strip(count, number, False, (sx, sy), lines=True, sides=self.ask.task.once(sides))
        x, y = (torch.from_numpy(places).to(window.device) for places in (strip.x, strip.y))
        asked = torch.nn.functional.pad(wanted, (halo,) * 4)
        # those at the cell's border have no pixel of their own beside them that would be asked for more
        beside = dilated(asked, 1)
        beside[halo:-halo, halo:-halo] = wanted
        asked = dilated(beside, max(1, halo - 1))
        row, col = cell.row - halo, cell.col - halo
        asked &= on_screen(self.ask.task, row, col, (asked.shape[0], asked.shape[1]))
        coded = self.ask.task.followed is not None
        pixels, lines, finder = self.pixels(wanted), Lines(x, y, number), Finder()
        inner = (slice(halo, halo + cell.height), slice(halo, halo + cell.width))
        self.ask.check(count * int(asked[inner].count_nonzero()))
        plain = torch.zeros(len(self.plain), len(pixels), dtype=torch.float64, device=window.device)
        step = max(1, _AT_ONCE * width_of(window.device) // max(1, int(asked.count_nonzero())))
        for first in range(0, count, step):
            some = slice(first, first + step)
            samples = scattered(self.ask.coded if coded else self.ask, x[some], y[some], row, col, asked, number, coded)
            plain += summed(samples, window.filter, pixels.rows + cell.row, pixels.cols + cell.col, halo)
            finder.look(samples, first)
        plain /= norm(lines, window.filter, halo)
        found = finder.found()
        if coded:
            found = [told(self.cell, without(s, self.smooth), self.deciding) for s in found]
        if known is None:
            return self._level(lines, found, self.axes(found)[0], wanted, pixels, plain)
        return self._level(lines, found, known.axes, wanted, pixels, plain, known)

    def first(self, lines: Lines, found: list[Segments], axes: Axes, wanted: Tensor) -> Level:
        """The lattice that was sampled everywhere, in the pixels `wanted` (h, w) that a crossing reaches."""
        return self._level(lines, found, axes, wanted)

    def _level(
        self,
        lines: Lines,
        found: list[Segments],
        axes: Axes,
        wanted: Tensor,
        pixels: Pixels | None = None,
        plain: Tensor | None = None,
        known: Level | None = None,
    ) -> Level:
        """Bisect the candidates of the axis that each pixel takes, and add what they miss."""
        window, seed = self.window, self.seed + lines.number
        used = [axes.used(axis, wanted) for axis in (0, 1)]
        taken = [segments.take(self.reaching(segments, here)) for segments, here in zip(found, used, strict=True)]
        before = self.ask.left
        bisected = self._bisected(taken, lines, known, seed)
        every = self.thin.completed(
            bisected, lines, used, seed, min(self.finest, THINNEST), before - self.ask.left, known is not None
        )
        if self.ask.task.followed is None:
            every = [
                self._continued(c, lines, here, seed, share_of(known is not None)) for c, here in zip(every, used, strict=True)
            ]
        if lines.number == 0 and self.ask.task.dtype != torch.float64:
            # that lattice was not asked as jumps are
            every = [self._sided(c) for c in every]
        if pixels is None or plain is None:
            pixels = self.pixels(self.reached([(c.place, c.across) for c in every]) & wanted)
            plain = self.plain[:, pixels.rows, pixels.cols]
        scale = norm(lines, window.filter, window.halo)
        corrections, spreads, densities = zip(*(window.correction(pixels, c, scale) for c in every), strict=True)
        # now that all is known, the mixture where both axes were followed
        share, open_ = pixels.of(axes.pixels, axes.share, 0.0), pixels.of(axes.pixels, axes.open, True)
        share = torch.where(((share > 0) & (share < 1)) | open_, _share(*densities), share)
        value, spread = plain.clone(), torch.zeros_like(plain)
        mixed = bool(((share > 0) & (share < 1)).any())
        for axis, weight in enumerate((share, 1 - share)):
            correction = corrections[axis]
            if mixed:
                correction = correction + ends(window, pixels, every[1 - axis], lines)
            value += weight * correction
            spread += weight**2 * spreads[axis]
        density = torch.lerp(densities[1], densities[0], share)
        near = density > 0
        core = near & (density > _CORE * pixels.greatest(density, window.reach))
        # where both axes have followed thin pieces and see them alike, one does for the next shift, the same all along a piece
        alike = open_ & (share > 0) & (share < 1)
        if bool((alike & near).any()):
            for _ in range(4):
                densities = tuple(pixels.summed(d) for d in densities)
            share = torch.where(alike, (_PREFERRED * densities[0] >= densities[1]).to(share), share)
        return Level(pixels, value, plain, spread, near, core, every, lines, Axes(pixels, share, torch.zeros_like(near)))

    def _sided(self, crossings: Crossings) -> Crossings:
        try:
            return sided(self.ask.sampled, crossings)
        except Spent:
            return crossings

    def _continued(self, crossings: Crossings, lines: Lines, used: Tensor, seed: int, share: float) -> Crossings:
        """The crossings with those of their edges that do not stand out, as far as a share of what is left pays for them."""
        # no further than there are samples: beyond, every edge ends, and none weighs anything
        reach = self.window.halo - 1
        wanted, origin = widened(used & ~self.thin.lost, reach), (self.cell.row - reach, self.cell.col - reach)
        try:
            with self.ask.keeping(1 - share):
                return continued(self.ask, crossings, lines, wanted, origin, self.finest, seed)
        except Spent:
            return crossings

    def _bisected(self, segments: list[Segments], lines: Lines, known: Level | None, seed: int) -> list[Crossings]:
        """The crossings of the segments along either axis; without any known, every second line foretells the others."""
        if any(bool((s.decided > 0).any()) for s in segments):
            from torch_mcaa.estimators.located.decided import crossings

            told, left = zip(*(crossings(self.ask, s.take(s.decided > 0), seed) for s in segments), strict=True)
            rest = [together([s.take(s.decided == 0), more]) for s, more in zip(segments, left, strict=True)]
            found = self._bisected(rest, lines, known, seed)
            return [joined([a, b]) for a, b in zip(told, found, strict=True)]
        apart = 2.5 / lines.count
        if known is not None:
            short = narrowed_all(self.ask, segments, known.crossings, apart, seed)
            if self.ask.task.followed is None:
                more = [between(self.ask, c, known.lines, lines, s) for c, s in zip(known.crossings, segments, strict=True)]
                short = [together([s, m]) for s, m in zip(short, more, strict=True)]
            return bisect_all(self.ask, short, self.finest, seed)
        odd = [
            torch.argsort(torch.argsort(across))[s.key[:, 0]] % 2 == 1
            for s, across in zip(segments, (lines.y, lines.x), strict=True)
        ]
        others = [s.take(~o) for s, o in zip(segments, odd, strict=True)]
        first = bisect_all(self.ask, others, self.finest, seed)
        even, lost = regular(self.cell, [s.take(o) for s, o in zip(segments, odd, strict=True)], others, first, apart)
        self.thin.lost = self.thin.lost | lost
        rest = narrowed_all(self.ask, even, first, apart, seed)
        second = bisect_all(self.ask, rest, self.finest, seed)
        return [joined([a, b]) for a, b in zip(first, second, strict=True)]

    def reaching(self, segments: Segments, wanted: Tensor) -> Tensor:
        """Which segments begin where the filter of a pixel `wanted` (h, w) reaches; bool (S,)."""
        reach = self.window.reach + 1
        wide = widened(wanted, reach)
        x, y = placed(segments.axis, segments.low, segments.across)
        row = (y.floor().long() - self.cell.row + reach).clamp(0, wide.shape[0] - 1)
        col = (x.floor().long() - self.cell.col + reach).clamp(0, wide.shape[1] - 1)
        return wide[row, col]


def _sizes(segments: Segments) -> Tensor:
    """(S,): by how much f changes; of a decision, whose jump is not known yet, at least half the mean of all."""
    size = (segments.after - segments.before).abs().amax(0).to(torch.float64)
    decided = segments.decided > 0
    if not bool(decided.any()):
        return size
    return torch.where(decided, size.clamp_min(_DECIDED * float(size[decided].mean())), size)


def _share(horizontal: Tensor, vertical: Tensor) -> Tensor:
    """What the horizontal lines' crossings count for: sharply, by the eighth powers of what the lines see of the edges."""
    a, b = (density.square().square().square() for density in (horizontal, vertical))
    share = a / (a + b).clamp_min(1e-300)
    return torch.where(share < _NONE, 0, torch.where(share > 1 - _NONE, 1, share))
