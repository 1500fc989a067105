"""Error and time of several methods on one case, interleaved, and the time each needs to come to a given error."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from .base import Peer
from .cases import Case

TARGET = 2e-3


@dataclass
class Point:
    """One budget of one method: squared errors and seconds of every run, seconds scaled to the whole picture."""

    budget: int
    evaluations: float = 0.0
    squares: list[float] = field(default_factory=list)
    times: list[float] = field(default_factory=list)

    @property
    def rmse(self) -> float:
        return math.sqrt(statistics.mean(self.squares))

    @property
    def seconds(self) -> float:
        return statistics.median(self.times)


@dataclass
class Runner:
    peer: Peer
    points: list[Point] = field(default_factory=list)
    error: str = ""

    def time_to(self, target: float) -> float:
        """Seconds, by a straight line between logarithms of error and time where a budget could lie between; +inf if none comes so far."""
        points = [p for p in self.points if p.squares]
        if not points or min(p.rmse for p in points) > target:
            return math.inf
        if points[0].rmse <= target:
            return points[0].seconds
        for before, after in pairwise(points):
            if after.rmse <= target and after.budget == before.budget + 1:
                return after.seconds
            if after.rmse <= target:
                share = math.log(before.rmse / target) / math.log(before.rmse / max(after.rmse, 1e-12))
                return math.exp((1 - share) * math.log(before.seconds) + share * math.log(after.seconds))
        return math.inf

    def run(self, case: Case, point: Point, seed: int) -> None:
        begin = time.perf_counter()
        outcome = self.peer.load()(case, point.budget, seed)
        seconds, share = time.perf_counter() - begin, outcome.share(case)
        point.times.append(seconds / share)
        point.squares.append(outcome.rmse(case) ** 2)
        point.evaluations = outcome.evaluations / share / case.truth.numel()


def race(case: Case, peers: Sequence[Peer], repetitions: int, target: float = TARGET, longest: float = 8.0) -> list[Runner]:
    """Every method at rising budgets until it comes to `target` or takes `longest` seconds; then all of them again, in turn."""
    runners = [Runner(peer) for peer in peers if peer.fits(case)]
    for runner in runners:
        try:
            runner.peer.load()(case, runner.peer.budgets[0], 0)  # compiles, imports
            for budget in runner.peer.budgets:
                point = Point(budget)
                if runner.peer.warms:
                    runner.peer.load()(case, budget, 0)
                begin = time.perf_counter()
                runner.run(case, point, 0)
                runner.points.append(point)
                if point.rmse <= target or time.perf_counter() - begin > longest:
                    break
        except Exception as problem:
            runner.error = f"{type(problem).__name__}: {problem}"[:200]
    for repetition in range(1, repetitions):
        for runner in runners:
            for point in runner.points:
                runner.run(case, point, repetition)
    return runners
