"""The values a chart compares with, and their own error."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from torch_mcaa.charting.subject import Subject
from torch_mcaa.errors import McaaError
from torch_mcaa.estimators import Auto, Estimator, Importance, Shared
from torch_mcaa.filters import Gaussian
from torch_mcaa.grid import Screen
from torch_mcaa.patterns import Sobol
from torch_mcaa.render import render

ESTIMATES: tuple[tuple[Estimator, int], ...] = ((Importance(Sobol()), 8), (Shared(), 32), (Auto(), 4))
"""Of a truth without a closed form, and the times the largest budget that each is given."""
_BLOCK = 16
_AGREED = 2.0
_SEED = 2**64 - 1
_BUSY = 1e-2


@dataclass(frozen=True)
class Truth:
    """The pixel values, float64.

    Attributes:
        value: (C, H, W).
        error: (C, H, W) the standard error of `value`; for a closed form a bound.
        kind: "closed form" or "reference".
        how: a sentence.
    """

    value: Tensor
    error: Tensor
    kind: str
    how: str

    @property
    def span(self) -> float:
        """The range of the values, all channels together; their magnitude where all are equal, and 1 where that is 0."""
        return float(self.value.max() - self.value.min()) or float(self.value.abs().max()) or 1.0

    @property
    def busy(self) -> Tensor:
        """(C, H, W) bool: the pixels that are not flat, where the values of 3 x 3 pixels differ by over a hundredth of the range; all if none do."""
        high, low = (functional.max_pool2d(sign * self.value[None], 3, 1, 1)[0] for sign in (1, -1))
        mask = high + low > _BUSY * (self.value.amax((1, 2), True) - self.value.amin((1, 2), True))
        return mask if bool(mask.any()) else torch.ones_like(mask)

    @property
    def typical(self) -> float:
        """Root mean square of `error` over the pixels that are not flat."""
        return float(self.error[self.busy].square().mean().sqrt())


def closed_form(subject: Subject) -> Truth | None:
    """What `f.exact(cx, cy, filter)` says, as built-in scenes do; None where f has none under this filter, or an extent moves it.

    Its error is that of the tails that a Gaussian filter is cut off from (1.2e-6 of the range at 5 std), or of rounding.

    Raises:
        McaaError: an `exact` that raises anything but `McaaError`, or returns another shape.
    """
    exact: Callable[..., Tensor] | None = getattr(subject.f, "exact", None)
    if not callable(exact) or subject.extent is not None:
        return None
    x, y = Screen.of(subject.size).centres()
    try:
        value = exact(x[None, :], y[:, None], subject.filter)
        value = torch.as_tensor(value).double().broadcast_to(subject.channels, *subject.size).contiguous()
    except McaaError:
        return None
    except Exception as error:
        what = f"f.exact(cx, cy, filter) must return {subject.channels} channels of {subject.size} pixels"
        raise McaaError(f"{what}, and raised {type(error).__name__}: {error}; mend it, or take it away for a reference") from error
    w = subject.filter
    cut = 2 * math.erfc(w.half_width / (w.std * math.sqrt(2))) if isinstance(w, Gaussian) else 0.0
    bound = max(cut * float(value.max() - value.min()), 1e-12 * float(value.abs().max()))
    return Truth(value, torch.full_like(value, bound), "closed form", f"closed form, good to {bound:.1e}")


def reference(subject: Subject, budget: int) -> Truth:
    """Three estimates of many evaluations, independent of what is measured and of each other: other seeds, and one of them other points.

    The first draws scrambled points for every pixel by itself: it is unbiased, shares nothing between pixels and looks for no jumps. The
    others, a shared lattice and `Auto`, are far more accurate and have to be borne out by it: in blocks of 16 x 16 pixels where they differ from it
    by what the standard errors allow (mean square of the difference over them at most 2) they are averaged with it, the inverse variances as
    weights; in the others they count for nothing. In float64 where f takes it. What no sample of any met is not in the error.
    """
    dtype = torch.float64 if _takes(subject, torch.float64) else torch.float32
    (plain, times), *accurate = ESTIMATES
    first, own = _estimate(subject, plain, times * budget, _SEED, dtype)
    # an error of 0 is one of rounding
    least = 64 * float(torch.finfo(dtype).eps) * (float(first.abs().max()) or 1.0)
    own = own.clamp_min(least).square()
    value, variance, shares = first, own, []
    for number, (estimator, times) in enumerate(accurate, 1):
        other, error = _estimate(subject, estimator, times * budget, _SEED - number, dtype)
        a = error.clamp_min(least).square()
        off = functional.avg_pool2d(((other - first).square() / (a + own))[None], _BLOCK, ceil_mode=True, count_include_pad=False)
        agreed = functional.interpolate(off, scale_factor=_BLOCK)[0, :, : subject.size[0], : subject.size[1]] <= _AGREED
        share = torch.where(agreed, variance / (a + variance), 0.0)
        value = other * share + value * (1 - share)
        variance = a * share.square() + variance * (1 - share).square()
        shares.append(f"{estimator} at {times * budget}, agreeing in {100 * float(agreed.double().mean()):.0f} % of the picture")
    how = f"{plain} at {ESTIMATES[0][1] * budget} evaluations a pixel, with {' and '.join(shares)}; seeds of their own"
    return Truth(value, variance.sqrt(), "reference", how)


def _estimate(subject: Subject, estimator: Estimator, spp: int, seed: int, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    picture = render(
        subject.f,
        subject.size,
        filter=subject.filter,
        extent=subject.extent,
        estimator=estimator,
        spp=spp,
        seed=seed,
        dtype=dtype,
        progress=False,
    )
    if picture.stopped == "interrupted":
        raise KeyboardInterrupt
    seen = (picture.stderr.double().square() - picture.unseen.double().square()).clamp_min(0).sqrt()
    # where f has no second moment, a large number, so that sums stay numbers
    return picture.image.double(), seen.nan_to_num(posinf=1e30)


def _takes(subject: Subject, dtype: torch.dtype) -> bool:
    task = subject.task(dtype)
    x, y = task.screen.centres()
    try:
        task.integrand(x[:1].to(dtype), y[:1].to(dtype))
    except McaaError:
        return False
    return True
