"""Pixels in a list: where they are, and what their neighbours in it have."""

from __future__ import annotations

import torch

from torch_mcaa.edges.pixels import Pixels

ROW, COL, MARGIN = -3, 40, 2


def some(seed: int = 1, share: float = 0.5) -> tuple[torch.Tensor, Pixels]:
    mask = torch.rand(7, 9, generator=torch.Generator().manual_seed(seed)) < share
    return mask, Pixels(ROW, COL, mask, MARGIN)


def test_index_finds_each_and_no_other() -> None:
    mask, pixels = some()
    rows, cols = torch.meshgrid(torch.arange(-MARGIN, 7 + MARGIN), torch.arange(-MARGIN, 9 + MARGIN), indexing="ij")
    index = pixels.index(rows + ROW, cols + COL)
    there = torch.nn.functional.pad(mask, (MARGIN,) * 4)
    assert len(pixels) == int(mask.sum())
    assert torch.equal(index[there], torch.arange(len(pixels))) and bool((index[~there] == len(pixels)).all())
    assert torch.equal(pixels.plane(torch.ones(len(pixels))), mask.float())


def test_of_another_list() -> None:
    _, pixels = some()
    _, other = some(seed=2)
    plane = torch.arange(63.0).view(7, 9)
    values = plane[other.rows, other.cols][None]
    expected = torch.where(other.plane(torch.ones(len(other))) > 0, plane, -1.0)[pixels.rows, pixels.cols]
    assert torch.equal(pixels.of(other, values, -1.0)[0], expected)


def test_sums_and_maxima_over_neighbours() -> None:
    """Where all pixels are in the list, those of a plane; outside of it there is nothing."""
    _, pixels = some(share=2.0)
    values = torch.rand(63, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    plane = values.view(1, 1, 7, 9)
    expected = 9 * torch.nn.functional.avg_pool2d(plane, 3, 1, 1)
    assert torch.allclose(pixels.summed(values).view(7, 9), expected[0, 0], rtol=1e-14)
    assert torch.equal(pixels.greatest(values, 2).view(7, 9), torch.nn.functional.max_pool2d(plane, 5, 1, 2)[0, 0])


def test_neighbours_that_are_not_in_the_list_count_nothing() -> None:
    mask = torch.zeros(3, 3, dtype=torch.bool)
    mask[0, 0] = mask[0, 1] = mask[2, 2] = True
    pixels = Pixels(0, 0, mask, 1)
    assert pixels.summed(torch.tensor([1.0, 2.0, 4.0])).tolist() == [3.0, 3.0, 4.0]
    assert pixels.greatest(torch.tensor([1.0, 2.0, 4.0]), 1).tolist() == [2.0, 2.0, 4.0]
