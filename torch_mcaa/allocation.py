"""How many evaluations each pixel gets: whole numbers with exact totals and floors.

Equations are those of Halton, Monte Carlo Anti-Aliasing. "The variance" of a pixel is that of one evaluation, λ_h − φ_h² of (10), so
that n_h evaluations leave variance / n_h. Where a pixel has strata that are themselves shared out by (16), [Σ_j √(μ_hj − φ_h²)]² / m²
in its place turns (14) into (19) and (15) into (20).

Every count is the same, bit for bit, for any number of threads.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, final

import torch
from torch import Tensor

from torch_mcaa.errors import McaaError

MOST = 2**48
"""Bound on a total: below it whole float64 numbers add up exactly in any order, and a threshold's last bit moves no count by 2."""


class Allocation(ABC):
    """How the evaluations of a round are shared out over the pixels.

    In every `variance`, NaN and +inf (a second moment that is not there) count as the largest finite value, or as 1 where there is
    none, so that one pixel does not draw everything.
    """

    unseen: ClassVar[float] = 1.0
    """Weight of the one more observation that a pilot's variances get, as if half the range of values had been met and missed.

    Measured on discs, edges and hairlines with pilots of 4 and 16: less leaves the worst pixel worse than even counts would; for a sum of
    variances, where roots are shared out, a quarter measures best.
    """

    @abstractmethod
    def counts(self, variance: Tensor, total: int, floor: int = 1, cap: int | None = None) -> Tensor:
        """Evaluations of each pixel, (H, W) int64, adding up to `total`, each at least `floor` and at most `cap`.

        Args:
            variance: (H, W) real and not negative, the variance of one evaluation in each pixel; only ratios matter.
            total: evaluations of the whole picture.
            floor: the fewest that a pixel gets, at least 1.
            cap: the most that a pixel gets; None for no bound.

        Raises:
            McaaError: no such counts exist, or an argument of the wrong kind, shape or sign.
        """

    @abstractmethod
    def predicted(self, variance: Tensor, total: int) -> float:
        """What the theory promises for `total` evaluations shared out in real numbers, without floor or cap.

        Raises:
            McaaError: an argument of the wrong kind, shape or sign.
        """


@dataclass(frozen=True, eq=False, repr=False)
class _Greedy(Allocation):
    """`floor` everywhere, then one evaluation at a time to the pixel below `cap` that gains most; even where there is no variance.

    Attributes:
        known: (H, W) variance of one evaluation in each pixel where it is known beforehand, for instance stderr**2 * spp of the
            frame before; rendering then needs no pilot. Kept as a float64 copy.

    Raises:
        McaaError: `known` is not (H, W), real, finite and not negative.
    """

    known: Tensor | None = None

    def __post_init__(self) -> None:
        if self.known is None:
            return
        if not isinstance(self.known, Tensor):
            raise McaaError(
                f"known must be a (H, W) tensor, got {type(self.known).__name__}: pass for instance frame.stderr**2 * spp"
            )
        known = self.known
        if known.is_floating_point() and known.numel():
            # a closed form such as phi (1 - phi) may round to just below 0
            known = torch.where((known < 0) & (known >= -1e-6 * known.abs().max()), 0, known)
        values = _picture("known", known)
        if not values.isfinite().all():
            bad = int((~values.isfinite()).sum())
            raise McaaError(
                f"known must be finite, got {bad} values of {values.numel()} that are not: put the largest finite one there"
            )
        object.__setattr__(self, "known", values.clone())

    def __repr__(self) -> str:
        return f"{type(self).__name__}({'' if self.known is None else f'known=<{self.known.shape[0]} x {self.known.shape[1]}>'})"

    @abstractmethod
    def _gain(self, variance: Tensor, n: Tensor) -> Tensor:
        """What the step from n to n + 1 is worth; it falls with n."""

    @abstractmethod
    def _reach(self, ratio: Tensor) -> Tensor:
        """The real n at which the gain is the threshold, given variance / threshold; may work in place."""

    def counts(self, variance: Tensor, total: int, floor: int = 1, cap: int | None = None) -> Tensor:
        variance = _usable(variance)
        cap = _check_total(variance, total, floor, cap)
        drawing = variance > 0
        full = int(drawing.sum())
        if full * cap + (variance.numel() - full) * floor <= total:
            return _even(~drawing, total - full * cap).masked_fill_(drawing, cap)
        # A power of two changes no quotient's digits; the bound keeps the smallest within reach of the lowest threshold.
        scale = 2.0 ** (math.frexp(variance.max().item())[1] - 1)
        variance = torch.where(drawing, (variance / scale).clamp_(min=2.0**-900), 0)

        def taken(threshold: float) -> Tensor:
            return self._reach(variance / threshold).ceil_().clamp_(floor, cap)

        low, high = 2.0**-1000, 2.0
        many, few = taken(low), taken(high)
        while (many - few).max() > 1:
            middle = math.sqrt(low) * math.sqrt(high)
            counts = taken(middle)
            if counts.sum() > total:
                low, many = middle, counts
            else:
                high, few = middle, counts
        places = _spread_places(many > few)
        gains = self._gain(variance.view(-1)[places], few.view(-1)[places])
        counts = few.to(torch.int64)
        left = total - int(counts.sum())
        counts.view(-1)[places[gains.argsort(descending=True, stable=True)[:left]]] += 1
        return counts


@final
@dataclass(frozen=True, eq=False, repr=False)
class EqualVariance(_Greedy):
    """n_h ∝ variance, (14): every pixel the same variance, which is the least that the largest can be.

    The largest variance / n_h is least over all whole counts within floor and cap, then the next largest, and so on.
    """

    def _gain(self, variance: Tensor, n: Tensor) -> Tensor:
        return variance / n

    def _reach(self, ratio: Tensor) -> Tensor:
        return ratio

    def predicted(self, variance: Tensor, total: int) -> float:
        """(15), the common variance of all pixels: Σ variance / total."""
        check_whole("total", total, 1)
        return _sum(_usable(variance)) / total


@final
@dataclass(frozen=True, eq=False, repr=False)
class Neyman(_Greedy):
    """n_h ∝ √variance (Neyman 1934): the least sum of the pixels' variances, that is the least mean squared error.

    Σ variance / n_h is least over all whole counts within floor and cap.
    """

    unseen: ClassVar[float] = 0.25

    def _gain(self, variance: Tensor, n: Tensor) -> Tensor:
        return variance / (n * (n + 1))

    def _reach(self, ratio: Tensor) -> Tensor:
        return ratio.mul_(4).add_(1).sqrt_().sub_(1).div_(2)

    def predicted(self, variance: Tensor, total: int) -> float:
        """The least sum of the pixels' variances: (Σ √variance)² / total, as (17) has it for strata."""
        check_whole("total", total, 1)
        return _sum(_usable(variance).sqrt()) ** 2 / total


@final
@dataclass(frozen=True)
class Uniform(Allocation):
    """The same for every pixel, whatever its variance; what does not divide is spread evenly over the picture."""

    def counts(self, variance: Tensor, total: int, floor: int = 1, cap: int | None = None) -> Tensor:
        variance = _usable(variance)
        _check_total(variance, total, floor, cap)
        return _even(torch.ones_like(variance, dtype=torch.bool), total)

    def predicted(self, variance: Tensor, total: int) -> float:
        """The sum of the pixels' variances, to compare with Neyman's: (10) with n_h = total / pixels."""
        check_whole("total", total, 1)
        return _sum(_usable(variance)) * variance.numel() / total


def dense(counts: Tensor) -> Tensor:
    """Counts of few different values, for pixels of one count are sampled together: those within 7 % of each other are evened out.

    No count leaves its band [1.07^k, 1.07^(k + 1)) but for rounding up, and their sum stays what it is; any shape, int64.
    """
    flat = counts.reshape(-1)
    values, sizes = flat.unique(return_counts=True)
    bands: dict[int, list[tuple[int, int]]] = {}
    for value, size in zip(values.tolist(), sizes.tolist(), strict=True):
        if value > 0:
            bands.setdefault(math.floor(math.log(value) / math.log(1.07)), []).append((value, size))
    evened = flat.clone()
    for band in bands.values():
        if len(band) > 2:
            each, more = divmod(sum(value * size for value, size in band), sum(size for _, size in band))
            places = ((flat >= band[0][0]) & (flat <= band[-1][0])).nonzero().squeeze(1)
            evened[places] = each
            evened[places[flat[places].argsort(descending=True, stable=True)[:more]]] += 1
    return evened.view_as(counts)


def _even(chosen: Tensor, total: int) -> Tensor:
    """`total` shared out evenly over the chosen pixels, 0 elsewhere; (H, W) int64."""
    places = _spread_places(chosen)
    each, more = divmod(total, max(places.numel(), 1))
    counts = chosen.to(torch.int64) * each
    counts.view(-1)[places[:more]] += 1
    return counts


def _spread_places(chosen: Tensor) -> Tensor:
    """Flat indices of the chosen pixels of (H, W), in an order whose every beginning is spread evenly over the picture.

    The order of the fractional parts of row / g + column / g², g**3 = g + 1 (Roberts, "The unreasonable effectiveness of quasirandom
    sequences", 2018), in 32 bits.
    """
    height, width = chosen.shape
    rows = torch.arange(height, device=chosen.device)[:, None] * 3242174889
    key = (rows + torch.arange(width, device=chosen.device) * 2447445414) & 0xFFFFFFFF
    places = chosen.reshape(-1).nonzero().squeeze(1)
    return places[key.view(-1)[places].argsort(stable=True)]


def _sum(variance: Tensor) -> float:
    """The sum, the same for any number of threads: torch adds pieces of this size in one thread."""
    return math.fsum(piece.sum().item() for piece in variance.reshape(-1).split(16384))


def real(name: str, values: Tensor) -> Tensor:
    if values.is_complex() or values.dtype == torch.bool:
        raise McaaError(f"{name} must be real numbers, got {values.dtype}: convert to torch.float64")
    if (values < 0).any():
        raise McaaError(f"{name} must not be negative, got {values.min().item():g}: clamp at 0")
    return values.detach().to(torch.float64).contiguous()


def _picture(name: str, variance: Tensor) -> Tensor:
    if variance.ndim != 2 or variance.numel() == 0:
        raise McaaError(f"{name} must be (H, W), one value a pixel, got {tuple(variance.shape)}: combine the channels first")
    return real(name, variance)


def _usable(variance: Tensor) -> Tensor:
    variance = _picture("variance", variance)
    finite = variance.isfinite()
    if finite.all():
        return variance
    largest = variance[finite].max().item() if finite.any() else 1.0
    return torch.where(finite, variance, largest)


def check_whole(name: str, value: object, least: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise McaaError(f"{name} must be a whole number >= {least}, got {value!r}: pass an int")


def _check_total(variance: Tensor, total: int, floor: int, cap: int | None) -> int:
    """The cap, or what bounds every pixel where there is none."""
    for name, value in (("total", total), ("floor", floor), ("cap", total if cap is None else cap)):
        check_whole(name, value, 1)
    pixels = variance.numel()
    shown = f"{total} evaluations for {variance.shape[0]} x {variance.shape[1]} pixels"
    if total < floor * pixels:
        raise McaaError(f"{shown} are too few for {floor} in each: raise spp to at least {floor}")
    if cap is not None and total > cap * pixels:
        raise McaaError(f"{shown} are too many for at most {cap} in each: lower spp to at most {cap}, or raise the cap")
    if total > MOST:
        raise McaaError(f"{shown} are more than 2**48: render the picture in parts")
    return total if cap is None else cap
