"""One accumulator for all estimators: counts, means and centred second moments, mergeable."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.sums import add_rows


@dataclass(frozen=True)
class Moments:
    """Count, mean and sum of squared deviations of terms, in float64.

    Second moments are centred before they are squared, so (10) is never a difference of two large numbers; merging is exact
    (Chan, Golub and LeVeque, 1979).

    Attributes:
        count: the number of terms, of a shape that broadcasts to the mean's.
        mean: their mean, NaN where there is no term.
        m2: the sum of their squared deviations from it, 0 where there is no term.
    """

    count: Tensor
    mean: Tensor
    m2: Tensor

    @classmethod
    def of(cls, terms: Tensor, dim: int, valid: Tensor | None = None) -> Moments:
        """The moments along `dim`; terms that are not `valid` (a bool tensor that broadcasts) do not count."""
        terms = terms.to(torch.float64)
        if valid is None:
            mean = terms.mean(dim, keepdim=True)
            count = torch.full_like(mean, terms.shape[dim])
            deviation = terms - mean
        else:
            kept = valid.expand_as(terms)
            count = kept.sum(dim, keepdim=True).to(torch.float64)
            mean = torch.where(kept, terms, 0).sum(dim, keepdim=True) / count
            deviation = torch.where(kept, terms - mean, 0)
        # the mean of the deviations is the rounding of the mean
        m2 = deviation.square().sum(dim) - deviation.sum(dim).square() / count.squeeze(dim).clamp_min(1)
        return cls(count.squeeze(dim), mean.squeeze(dim), m2.clamp_min(0))

    @classmethod
    def by_stratum(cls, terms: Tensor, stratum: Tensor, strata: int, valid: Tensor | None = None) -> Moments:
        """The moments (C, strata, P) of terms (C, n, P) that belong to the strata `stratum` (n, P), int64."""
        terms = terms.to(torch.float64)
        kept = torch.ones_like(stratum, dtype=torch.float64) if valid is None else valid.to(torch.float64)
        count = kept.new_zeros(strata, kept.shape[1]).scatter_add_(0, stratum, kept)
        index = stratum.expand_as(terms)
        zeros = terms.new_zeros(len(terms), *count.shape)
        clean = terms if valid is None else torch.where(valid, terms, 0)
        mean = add_rows(zeros.clone(), stratum, clean) / count
        deviation = (terms - mean.gather(1, index)).square_()
        if valid is not None:
            deviation = torch.where(valid, deviation, 0)
        return cls(count, mean, add_rows(zeros, stratum, deviation))

    def merge(self, other: Moments) -> Moments:
        """The moments of both sets of terms together."""
        count = self.count + other.count
        share = other.count / count.clamp_min(1)
        # where one side has no term its mean is NaN, and says nothing
        ours, theirs = torch.where(self.count > 0, self.mean, other.mean), torch.where(other.count > 0, other.mean, self.mean)
        step = theirs - ours
        return Moments(count, ours + step * share, self.m2 + other.m2 + step.square().nan_to_num(nan=0.0) * self.count * share)

    @property
    def variance(self) -> Tensor:
        """The unbiased variance of one term; +inf where there are fewer than two."""
        return torch.where(self.count > 1, self.m2 / (self.count - 1).clamp_min(1), torch.inf)

    @property
    def variance_of_mean(self) -> Tensor:
        """The variance of the mean of independent terms: (10), from the terms themselves; +inf where there are fewer than two."""
        return self.variance / self.count.clamp_min(1)
