"""The convolution of a lattice's sample planes with its fixed weights, group by group of planes."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.estimators.lattice_weights import Geometry, LatticeWeights
from torch_mcaa.grid import Cell


@dataclass(frozen=True)
class _Term:
    """One product of the weights of a group of planes: taps along x (each (planes, 1)), a matrix along y, and both with signs."""

    taps: list[Tensor]
    signed_taps: list[Tensor]
    matrix: Tensor
    signed: Tensor | None


@dataclass(frozen=True)
class Group:
    """A group of planes, the terms of its weights."""

    planes: slice
    terms: list[_Term]


class Splat:
    """Weights of one shape of cell, placed in the picture's dtype; `start` gives the sums of one channel of one cell.

    The value of a pixel and, at every second pixel, the three character sums D_j = sum of character_j times weight times sample. They
    are the same sums over the four cosets of the lattice's double, in other signs, and see what changes between neighbouring samples.
    """

    def __init__(self, weights: LatticeWeights, cell: Cell, at: Geometry, group: int, contrast: bool) -> None:
        strip, task = weights.strip, weights.task
        self.cell, self.at, self.reach, self.contrast = cell, at, weights.reach, contrast
        self.block_strips = weights.block_strips
        banded, signs, norm = weights.along_y(cell, at)

        def place(tensor: Tensor) -> Tensor:
            return tensor.to(task.device, task.dtype).contiguous()

        self.norm = None if norm is None else place(norm)
        alternating = torch.tensor([1.0 - 2.0 * (k % 2) for k in range(-self.reach, self.reach + 1)], dtype=torch.float64)
        self.groups: list[Group] = []
        for start in range(0, strip.count, group):
            planes = slice(start, min(start + group, strip.count))
            characters = torch.from_numpy(strip.characters[:, planes]).to(torch.float64)
            sign = signs[:, None, None, :, None] * characters[:, None, None, None, :]
            terms = []
            for along_x, along_y in zip(weights.along_x[:, :, planes, None], banded[..., planes], strict=True):
                terms.append(
                    _Term(
                        list(place(along_x).unbind(0)),
                        list(place(along_x * alternating[:, None, None]).unbind(0)),
                        place(along_y.flatten(2)),
                        place((along_y[None, :, ::2] * sign).flatten(3)) if contrast else None,
                    )
                )
            self.groups.append(Group(planes, terms))
        self._buffers: dict[tuple[int, int], Tensor] = {}

    def start(self) -> tuple[Tensor, Tensor | None]:
        """Empty sums: (blocks, R, width), and (3, blocks, R / 2, width / 2)."""
        matrix, blocks = self.groups[0].terms[0].matrix, self.at.blocks
        rows = matrix.shape[1]
        value = matrix.new_zeros(blocks, rows, self.cell.width)
        return value, matrix.new_zeros(3, blocks, rows // 2, -(-self.cell.width // 2)) if self.contrast else None

    def add(self, sums: tuple[Tensor, Tensor | None], group: Group, samples: Tensor) -> None:
        """Add a group's samples (strips, planes, cols) of one channel to its sums."""
        value, characters = sums
        for term in group.terms:
            along = self._along_x(samples, term.taps, 1)
            value.baddbmm_(self._for_blocks(term.matrix), self._by_block(along))
            if characters is not None and term.signed is not None:
                even = self._by_block(along[..., ::2].contiguous())
                signed = self._by_block(self._along_x(samples, term.signed_taps, 2))
                characters[0].baddbmm_(self._for_blocks(term.signed[0]), even)
                characters[1].baddbmm_(self._for_blocks(term.signed[1]), signed)
                characters[2].baddbmm_(self._for_blocks(term.signed[2]), signed)

    def finish(self, sums: tuple[Tensor, Tensor | None]) -> tuple[Tensor, Tensor | None]:
        """The values (h, w), and the sum of the squared character sums (ceil(h / 2), ceil(w / 2))."""
        value, characters = sums
        power = None if characters is None else (characters * characters).sum(0).flatten(0, 1)[: -(-self.cell.height // 2)]
        return value.flatten(0, 1)[: self.cell.height], power

    def _along_x(self, samples: Tensor, taps: list[Tensor], stride: int) -> Tensor:
        """(all strips of the blocks, planes, columns / stride): the samples weighed along x, at every `stride`-th column."""
        cell, at = self.cell, self.at
        width = -(-cell.width // stride)
        all_strips = (at.blocks - 1) * self.block_strips + at.depth
        key = (stride, samples.shape[1])
        if key not in self._buffers:
            self._buffers[key] = samples.new_zeros(all_strips, samples.shape[1], width)
        buffer = self._buffers[key]
        out = buffer[at.lead : at.lead + at.strips]
        first = True
        for k, tap in zip(range(-self.reach, self.reach + 1), taps, strict=True):
            # columns c of the cell whose sample c + k exists
            low = -(-max(0, at.col - cell.col - k) // stride)
            high = -(-min(cell.width, at.col + at.cols - cell.col - k) // stride)
            if low >= high:
                continue
            source = samples[..., cell.col + low * stride + k - at.col :: stride][..., : high - low]
            if first and low == 0 and high == width:
                torch.mul(source, tap, out=out)
            else:
                if first:
                    out.zero_()
                out[..., low:high].addcmul_(source, tap)
            first = False
        return buffer

    def _for_blocks(self, matrix: Tensor) -> Tensor:
        return matrix.expand(self.at.blocks, -1, -1)

    def _by_block(self, along: Tensor) -> Tensor:
        """(blocks, depth x planes, columns): overlapping views of the strips of each block."""
        _, planes, width = along.shape
        return along.as_strided((self.at.blocks, self.at.depth * planes, width), (self.block_strips * planes * width, width, 1))
