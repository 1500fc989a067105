"""The convolution of a lattice's sample planes with its fixed weights, batch by batch of planes."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor

from torch_mcaa.estimators.lattice.lattice_weights import Geometry, LatticeWeights
from torch_mcaa.grid import Cell
from torch_mcaa.integrand import BLOCK, width_of

_PLANES = 24
"""Planes are weighed along x in blocks of f's size, and summed along y about so many at once: shorter products wait for their sums."""
_COLUMNS = 16
"""Their columns come in so many: the last few of a product of matrices have other last bits under other numbers of threads."""


@dataclass(frozen=True)
class _Term:
    """One product of a batch's weights: taps along x, each (planes, 1), by group of planes, and matrices along y.

    `matrix` (B, 2 R, depth x planes) has the rows of the value and those of the character that changes over strips only; `signed`
    (B, 2 R, depth x planes) those of the two that change over columns, for samples weighed with every second tap negative.
    """

    taps: list[list[Tensor]]
    matrix: Tensor
    signed: Tensor | None


@dataclass(frozen=True)
class Batch:
    """Planes [start, start + count), evaluated in groups of at most `group`."""

    start: int
    count: int
    terms: list[_Term]


@dataclass
class Sums:
    """The sums of one channel over a cell, by block: the value's rows and one character's, and the other two characters'."""

    plain: Tensor
    signed: Tensor | None
    buffers: list[tuple[Tensor, Tensor | None]] = field(default_factory=list)


class Splat:
    """The weights of one shape of cell, placed in the picture's dtype.

    With `contrast` a cell's sums hold the three character sums D_j = sum of character_j times weight times
    sample. They are the sums over the four cosets of the lattice's double, in other signs, and see what changes between neighbouring
    samples. Those of a constant are subtracted, of which 1 alone has some: narrow filters do not cancel it.
    """

    def __init__(self, weights: LatticeWeights, cell: Cell, at: Geometry, contrast: bool) -> None:
        strip, task = weights.strip, weights.task
        self.cell, self.at, self.contrast = cell, at, contrast
        self.width = -(-cell.width // _COLUMNS) * _COLUMNS
        self.reach, self.block_strips, self.rows = weights.reach, weights.block_strips, weights.block_strips * strip.period
        self.group = max(1, BLOCK * width_of(task.device) // at.points)
        along_y, signs, response, norm = weights.along_y(cell, at)

        def place(tensor: Tensor) -> Tensor:
            return tensor.to(task.device, task.dtype).contiguous()

        self.norm = None if norm is None else place(norm)
        self.response = place(response)
        size = self.group * max(1, round(_PLANES / self.group))
        self.batches: list[Batch] = []
        for start in range(0, strip.count, size):
            planes = slice(start, min(start + size, strip.count))
            characters = torch.from_numpy(strip.characters[:, planes]).to(torch.float64)
            # (3, depth, planes)
            sign = signs[:, :, None] * characters[:, None, :]
            terms = []
            for taps, matrix in zip(weights.along_x[:, :, planes, None], along_y[..., planes], strict=True):
                rows, signed = matrix.flatten(2), None
                if contrast:
                    rows = torch.cat([rows, (matrix * sign[0]).flatten(2)], 1)
                    signed = place(torch.cat([(matrix * sign[1]).flatten(2), (matrix * sign[2]).flatten(2)], 1))
                by_group = [list(part.unbind(0)) for part in place(taps).split(self.group, 1)]
                terms.append(_Term(by_group, place(rows), signed))
            self.batches.append(Batch(start, planes.stop - start, terms))

    def moved(self, cell: Cell, at: Geometry) -> None:
        """Serve another cell of the same shape and phase."""
        self.cell, self.at = cell, at

    def start(self) -> Sums:
        """Empty sums for one channel of a cell."""
        term, blocks, width = self.batches[0].terms[0], self.at.blocks, self.width
        new = term.matrix.new_zeros
        return Sums(
            new(blocks, term.matrix.shape[1], width), None if term.signed is None else new(blocks, term.signed.shape[1], width)
        )

    def _buffers(self, sums: Sums, batch: Batch) -> list[tuple[Tensor, Tensor | None]]:
        """For the weighed samples of a batch, by term; strips without samples, and columns beyond the cell, stay 0."""
        # the last batch may have fewer planes
        if not sums.buffers or sums.buffers[0][0].shape[1] != batch.count:
            sums.buffers.clear()
            shape = (self.at.blocks - 1) * self.block_strips + self.at.depth, batch.count, self.width
            new = batch.terms[0].matrix.new_zeros
            sums.buffers += [(new(shape), new(shape) if self.contrast else None) for _ in batch.terms]
        return sums.buffers

    def weigh(self, sums: Sums, batch: Batch, group: int, samples: Tensor) -> None:
        """Weigh the samples (strips, planes, cols) of a batch's group along x."""
        strips, cols = slice(self.at.lead, self.at.lead + self.at.strips), slice(self.cell.width)
        planes = slice(group * self.group, group * self.group + samples.shape[1])
        for term, (plain, signed) in zip(batch.terms, self._buffers(sums, batch), strict=True):
            taps, out = term.taps[group], plain[strips, planes, cols]
            if signed is None:
                self._along_x(samples, taps, range(-self.reach, self.reach + 1), out)
                continue
            # the sums over even and odd k give both the plain and the signed ones
            other = signed[strips, planes, cols]
            self._along_x(samples, taps, range(-self.reach + self.reach % 2, self.reach + 1, 2), out)
            self._along_x(samples, taps, range(-self.reach + 1 - self.reach % 2, self.reach + 1, 2), other)
            out.add_(other)
            torch.add(out, other, alpha=-2, out=other)

    def add(self, sums: Sums, batch: Batch) -> None:
        """Add a weighed batch to the sums along y."""
        for term, (plain, signed) in zip(batch.terms, self._buffers(sums, batch), strict=True):
            sums.plain.baddbmm_(term.matrix.expand(self.at.blocks, -1, -1), self._by_block(plain))
            if signed is not None and term.signed is not None and sums.signed is not None:
                sums.signed.baddbmm_(term.signed.expand(self.at.blocks, -1, -1), self._by_block(signed))

    def finish(self, sums: Sums) -> tuple[Tensor, Tensor | None]:
        """The values (h, w), and the sums (h, w) of the three squared character sums."""
        plain = sums.plain[..., : self.cell.width]
        level = plain[:, : self.rows]
        value = level.flatten(0, 1)[: self.cell.height]
        if sums.signed is None:
            return value, None
        power = torch.zeros_like(level, memory_format=torch.contiguous_format)
        signed = sums.signed[..., : self.cell.width]
        for one, response in zip((plain[:, self.rows :], *signed.split(self.rows, 1)), self.response, strict=True):
            one.addcmul_(level, response, value=-1)
            power.addcmul_(one, one)
        return value, power.flatten(0, 1)[: self.cell.height]

    def _along_x(self, samples: Tensor, taps: list[Tensor], offsets: range, out: Tensor) -> None:
        """out (strips, planes, width) = the sum over the offsets k of the samples k columns on, times taps[k + reach]."""
        cell, at = self.cell, self.at
        empty = True
        for k in offsets:
            # columns c of the cell whose sample c + k exists
            low, high = max(0, at.col - cell.col - k), min(cell.width, at.col + at.cols - cell.col - k)
            if low >= high:
                continue
            first = cell.col + low + k - at.col
            source, tap = samples.narrow(2, first, high - low), taps[k + self.reach]
            if empty and high - low == cell.width:
                torch.mul(source, tap, out=out)
            else:
                if empty:
                    out.zero_()
                out[..., low:high].addcmul_(source, tap)
            empty = False
        if empty:
            out.zero_()

    def _by_block(self, weighed: Tensor) -> Tensor:
        """(blocks, depth x planes, columns): overlapping views of the strips of each block."""
        _, planes, width = weighed.shape
        strides = (self.block_strips * planes * width, width, 1)
        return weighed.as_strided((self.at.blocks, self.at.depth * planes, width), strides)
