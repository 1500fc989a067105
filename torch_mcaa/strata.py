"""How many evaluations each stratum of a pixel gets, (16): whole numbers with exact totals and floors."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_mcaa.allocation import MOST, check_whole, real
from torch_mcaa.errors import McaaError


def strata_counts(spread: Tensor, total: Tensor | int, floor: int = 1) -> Tensor:
    """Evaluations of each stratum of every pixel, (16): proportional to `spread`, in whole numbers.

    Shares below `floor` are raised to it and the rest shared out again; then every share is rounded down and what is left goes to the
    largest remainders, ties in an order that rotates from pixel to pixel. With no spread in a pixel its strata get the same. Strata
    whose spread is NaN or +inf count as the largest finite one of their pixel.

    Args:
        spread: (m, *S) real and not negative, √(μ_hj − φ_h²) of each of m strata; only ratios within a pixel matter.
        total: evaluations of every pixel, or (*S) int64 of each.
        floor: the fewest that a stratum gets, at least 0.

    Returns:
        (m, *S) int64 that adds up to `total` over dim 0.

    Raises:
        McaaError: a total below m * floor, or an argument of the wrong kind, shape or sign.
    """
    if spread.ndim < 1 or spread.numel() == 0:
        raise McaaError(f"spread must be (strata, *pixels), got {tuple(spread.shape)}: pass at least one stratum of one pixel")
    share = real("spread", spread)
    strata, pixels = share.shape[0], share.shape[1:]
    check_whole("floor", floor, 0)
    wanted = _strata_total(total, pixels, share.device)
    least, most = int(wanted.min()), int(wanted.max())
    if least < strata * floor or most > MOST:
        raise McaaError(
            f"total must be from {strata * floor} ({strata} strata of at least {floor}) to 2**48 in every pixel, got {least} to {most}: "
            f"raise spp to at least {strata * floor}, or use fewer strata"
        )
    largest = share.amax(0)
    if not largest.isfinite().all():
        known = share.isfinite()
        largest = share.masked_fill(~known, 0).amax(0).masked_fill_(~known.any(0), 1)
        share = torch.where(known, share, largest)
    share = (share / largest).masked_fill_(largest == 0, 1)
    pinned = torch.zeros_like(share, dtype=torch.bool)
    while True:
        # torch promises no order for sum(0) that does not depend on the threads.
        unit = (wanted - floor * _planes(pinned)) / _planes(share)
        exact = (share * unit).masked_fill_(pinned, floor)
        low = exact < floor
        if not low.any():
            break
        pinned |= low
        share.masked_fill_(low, 0)
    whole = exact.floor()
    counts = whole.to(torch.int64)
    left = wanted - counts.sum(0)
    remainder = exact.sub_(whole).masked_fill_(pinned, -1)
    first = (torch.arange(pixels.numel(), device=share.device) % strata).reshape(pixels)
    rank = torch.zeros_like(counts, dtype=torch.int32)
    for j in range(strata):
        for i in range(j):
            ahead = torch.where((first > i) & (first <= j), remainder[i] > remainder[j], remainder[i] >= remainder[j])
            rank[j] += ahead
            rank[i] += ~ahead
    return counts.add_(rank < left)


def _planes(tensor: Tensor) -> Tensor:
    """The sum over dim 0, in order."""
    total = torch.zeros(tensor.shape[1:], dtype=torch.float64, device=tensor.device)
    for plane in tensor:
        total += plane
    return total


def _strata_total(total: Tensor | int, pixels: torch.Size, device: torch.device) -> Tensor:
    """`total` as (*S) int64."""
    if not isinstance(total, Tensor):
        check_whole("total", total, 1)
        return torch.full(pixels, total, dtype=torch.int64, device=device)
    if total.shape != pixels or total.is_floating_point() or total.is_complex() or total.dtype == torch.bool:
        raise McaaError(
            f"total must be int64 of shape {tuple(pixels)}, got {total.dtype} of {tuple(total.shape)}: one number a pixel"
        )
    return total.to(device=device, dtype=torch.int64)
