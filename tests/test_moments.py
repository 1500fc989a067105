"""`Moments`: centred, mergeable, exact where plain sums are not."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from torch_mcaa.moments import Moments


def normal(*shape: int, seed: int = 1) -> Tensor:
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def assert_same(a: Moments, b: Moments) -> None:
    """Within the rounding of a few hundred additions."""
    for x, y in ((a.count.expand_as(a.mean), b.count.expand_as(b.mean)), (a.mean, b.mean), (a.m2, b.m2)):
        torch.testing.assert_close(x, y, rtol=1e-12, atol=1e-12, equal_nan=True)


def test_of_agrees_with_numpy() -> None:
    terms = normal(3, 50, 7)
    moments = Moments.of(terms, 1)
    np.testing.assert_allclose(moments.mean, terms.numpy().mean(1), rtol=1e-12)
    np.testing.assert_allclose(moments.variance, terms.numpy().var(1, ddof=1), rtol=1e-12)
    np.testing.assert_allclose(moments.variance_of_mean, terms.numpy().var(1, ddof=1) / 50, rtol=1e-12)


def test_terms_that_are_not_valid_do_not_count() -> None:
    terms, valid = normal(2, 20, 5), normal(20, 5, seed=2) > 0
    valid[:, 4] = False
    moments = Moments.of(torch.where(valid, terms, torch.nan), 1, valid)
    for pixel in range(4):
        kept = terms[:, valid[:, pixel], pixel]
        assert_same(
            Moments(moments.count[:, pixel], moments.mean[:, pixel], moments.m2[:, pixel]),
            Moments.of(kept, 1),
        )
    assert (moments.count[:, 4] == 0).all() and moments.mean[:, 4].isnan().all() and (moments.m2[:, 4] == 0).all()
    assert (moments.variance[:, 4] == torch.inf).all()


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(0, 12), min_size=1, max_size=6), st.integers(0, 2**16))
def test_merging_parts_gives_the_whole(sizes: list[int], seed: int) -> None:
    """In any order of merging; parts may be empty."""
    terms = normal(1, sum(sizes), 3, seed=seed) + 5
    parts = [Moments.of(part, 1, torch.ones(part.shape[1:], dtype=torch.bool)) for part in terms.split(sizes, 1)]
    forward, backward = parts[0], parts[-1]
    for part in parts[1:]:
        forward = forward.merge(part)
    for part in reversed(parts[:-1]):
        backward = part.merge(backward)
    whole = Moments.of(terms, 1, torch.ones(terms.shape[1:], dtype=torch.bool))
    assert_same(forward, whole)
    assert_same(backward, whole)


def test_strata_are_what_their_terms_are_alone() -> None:
    terms = normal(2, 40, 6)
    stratum = (normal(40, 6, seed=3).abs() * 2).long().clamp_max(3)
    valid = normal(40, 6, seed=4) > -1
    moments = Moments.by_stratum(torch.where(valid, terms, torch.inf), stratum, 4, valid)
    for j in range(4):
        for pixel in range(6):
            kept = (stratum[:, pixel] == j) & valid[:, pixel]
            assert moments.count[j, pixel] == kept.sum()
            if kept.any():
                one = terms[:, kept, pixel]
                torch.testing.assert_close(moments.mean[:, j, pixel], one.mean(1), rtol=1e-12, atol=1e-12)
                torch.testing.assert_close(
                    moments.m2[:, j, pixel], (one - one.mean(1, keepdim=True)).square().sum(1), rtol=1e-12, atol=1e-12
                )


@pytest.mark.parametrize("merged", [False, True])
def test_no_cancellation(merged: bool) -> None:
    """f = 10^4 + 10^-3 g keeps three digits of variance, where the difference of the mean square and the squared mean keeps none.

    In float32 the terms themselves are rounded to 2^-10, so the truth is the variance of the rounded terms.
    """
    terms = (1e4 + 1e-3 * normal(1, 64, 100)).to(torch.float32)
    truth = terms.double().var(1)
    moments = Moments.of(terms[:, :40], 1).merge(Moments.of(terms[:, 40:], 1)) if merged else Moments.of(terms, 1)
    torch.testing.assert_close(moments.variance, truth, rtol=1e-3, atol=0)
    naive = (terms.square().mean(1) - terms.mean(1).square()) * 64 / 63
    assert ((naive.double() - truth).abs() >= truth).float().mean() > 0.9


def test_a_constant_has_no_variance_at_all() -> None:
    assert (Moments.of(torch.full((1, 49, 3), 0.1, dtype=torch.float32), 1).m2 < 1e-30).all()
