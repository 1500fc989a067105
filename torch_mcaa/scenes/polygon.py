"""A polygon, by integrals along its edges."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.filters.base import Filter
from torch_mcaa.filters.box import Box
from torch_mcaa.filters.gauss import standard
from torch_mcaa.filters.gaussian import Gaussian
from torch_mcaa.scenes.base import REACH, ClosedForm, Scene

_SQRT_2PI = 2.5066282746310002


@dataclass(frozen=True)
class Polygon(Scene):
    """1 inside a closed polygon, else 0; vertices (x, y) in pixels, in either direction.

    An outline that crosses itself counts a region as often as it winds around it. By Green's theorem the
    integral over the polygon is one over its edges, ∮ W(x − cx) w(y − cy) dy with W = ∫ w: exact for the box,
    where the integrand is piecewise linear; for the Gaussian a quadrature of one dimension good to 1e-12.
    Raises McaaError for fewer than three vertices, or an outline that encloses nothing.
    """

    vertices: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        if len(self.vertices) < 3 or self._signed_area() == 0:
            raise McaaError(f"Polygon needs three or more vertices around an area, got {self.vertices}: give an outline")

    def _edges(self) -> Sequence[tuple[tuple[float, float], tuple[float, float]]]:
        return list(zip(self.vertices, (*self.vertices[1:], self.vertices[0]), strict=True))

    def _signed_area(self) -> float:
        x0, y0 = self.vertices[0]
        return sum((ax - x0) * (by - y0) - (bx - x0) * (ay - y0) for (ax, ay), (bx, by) in self._edges()) / 2

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        turns, sign = torch.zeros_like(x), 1 if self._signed_area() > 0 else -1
        for (ax, ay), (bx, by) in self._edges():
            if ay != by:
                ray = ax + (y - ay) * ((bx - ax) / (by - ay)) > x
                within = (y >= min(ay, by)) & (y < max(ay, by))
                turns = turns + (within & ray).to(x.dtype) * (sign if by > ay else -sign)
        return turns

    def _closed_forms(self) -> Mapping[type[Filter], ClosedForm]:
        return {Gaussian: self._gaussian, Box: self._box}

    def _gaussian(self, cx: Tensor, cy: Tensor, std: float) -> Tensor:
        return self._around(cx, cy, std, REACH, torch.special.ndtr, _normal_density, standard(64))

    def _box(self, cx: Tensor, cy: Tensor, width: float) -> Tensor:
        return self._around(cx, cy, width, 0.5, lambda t: t + 0.5, torch.ones_like, standard(1))

    def _around(
        self,
        cx: Tensor,
        cy: Tensor,
        scale: float,
        reach: float,
        cdf: Callable[[Tensor], Tensor],
        pdf: Callable[[Tensor], Tensor],
        rule: tuple[np.ndarray, np.ndarray],
    ) -> Tensor:
        """∮ cdf(x) pdf(y) dy in units of the filter's scale; pdf is 0, and cdf 0 or 1, beyond the reach."""
        total = torch.zeros_like(cx)
        for (ax, ay), (bx, by) in self._edges():
            if ay == by:
                continue
            # An upright edge becomes upright to rounding: its quotients below are huge then, never 0 / 0.
            dx, dy = (bx - ax) / scale or 1e-300, (by - ay) / scale
            x, y = (ax - cx) / scale, (ay - cy) / scale
            start, end = _between(y, dy, reach, torch.zeros_like(x), torch.ones_like(x))
            enter, leave = _between(x, dx, reach, start, end)
            beyond = (leave, end) if dx > 0 else (start, enter)
            low, high = ((y + t * dy).clamp(-reach, reach) for t in beyond)
            total += cdf(high) - cdf(low)
            near = leave > enter
            if near.any():
                x, y, enter, leave = x[near], y[near], enter[near], leave[near]
                nodes, weights = (torch.as_tensor(a, device=cx.device)[:, None] for a in rule)
                t = (enter + leave) / 2 + nodes * (leave - enter) / 2
                total[near] += (weights * cdf(x + t * dx) * pdf(y + t * dy)).sum(0) * (leave - enter) / 2 * dy
        return total if self._signed_area() > 0 else -total


def _normal_density(t: Tensor) -> Tensor:
    return torch.exp(-0.5 * t * t) / _SQRT_2PI


def _between(at: Tensor, slope: float, reach: float, start: Tensor, end: Tensor) -> tuple[Tensor, Tensor]:
    """The part of start ≤ t ≤ end in which |at + slope t| ≤ reach; of no length where there is none."""
    first, last = sorted((-reach, reach), reverse=slope < 0)
    low, high = (first - at) / slope, (last - at) / slope
    return torch.minimum(torch.maximum(low, start), end), torch.minimum(torch.maximum(high, start), end)
