"""A walk through Halton's Monte Carlo Anti-Aliasing: what each equation predicts, beside what the library does.

    python examples/paper.py [folder]

prints predictions, observations and their ratios, and puts pictures of n_h, the numbers of evaluations, into the folder. Each row has a
seed of its own; ± is the standard error of its ratio, from the spread of the errors themselves, and 0 where nothing is random.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa import scenes
from torch_mcaa.estimators import Estimator
from torch_mcaa.filters import Filter
from torch_mcaa.grid import Screen
from torch_mcaa.image_io import srgb_decode, write_picture
from torch_mcaa.strata import strata_counts

Function = Callable[[Tensor, Tensor], Tensor]
Pair = tuple[float, float]

A = 0.25
"""The variance of w = N(0, a I), in square pixels."""
W = mcaa.Gaussian(math.sqrt(A))
SIDE = 128
TILE = 16
DISC = scenes.Disc(8.1, 7.9, 5.2)


@dataclass(frozen=True)
class Row:
    """One line of a table; `spread` is the standard error of `ratio`."""

    equation: str
    what: str
    predicted: float
    observed: float
    spread: float = 0.0

    @property
    def ratio(self) -> float:
        return self.observed / self.predicted


def mean_row(equation: str, what: str, truth: Tensor | float, values: Tensor) -> Row:
    """The mean of `values` against that of `truth`."""
    wanted = float(torch.as_tensor(truth, dtype=torch.float64).expand_as(values).mean())
    error = float((values - truth).std()) / math.sqrt(values.numel())
    return Row(equation, what, wanted, float(values.mean()), error / abs(wanted))


def variance_row(equation: str, what: str, variance: Tensor | float, error: Tensor) -> Row:
    """The mean of squared errors against that of the variances."""
    wanted, squares = torch.as_tensor(variance, dtype=torch.float64).expand_as(error), error.square()
    spread = float((squares - wanted).square().sum().sqrt() / wanted.sum())
    return Row(equation, what, float(wanted.mean()), float(squares.mean()), spread)


def render(f: Function, size: tuple[int, int], estimator: Estimator, spp: int, seed: int) -> mcaa.Rendering:
    return mcaa.render(f, size, filter=W, estimator=estimator, spp=spp, seed=seed, dtype=torch.float64)


def one(x: Tensor, y: Tensor) -> Tensor:
    return torch.ones_like(x)


def tiled(scene: scenes.Scene) -> Function:
    """The scene on every tile, so that one picture has many pixels of one kind; the scene ends well inside its tile."""

    def f(x: Tensor, y: Tensor) -> Tensor:
        values = scene(x % TILE, y % TILE)
        assert isinstance(values, Tensor)
        return values

    return f


def exact(scene: scenes.Scene, filter: Filter = W, size: tuple[int, int] = (TILE, TILE), side: int = SIDE) -> Tensor:
    """(1): the true values of the pixels, repeated to (side, side)."""
    x, y = Screen.of(size).centres()
    return scene.exact(x[None], y[:, None], filter).repeat(side // size[0], side // size[1])


def coin(coverage: Tensor) -> Tensor:
    """λ - φ² where f is 0 or 1 and w' = w: then λ = φ."""
    return (coverage * (1 - coverage)).clamp_min(0)


def second_moment(b: float | Pair, centre: Pair = (0.0, 0.0)) -> float:
    """(11), (13) for f = 1, w = N(0, a I) and a normal density of variances b about `centre`; the integral has a factor an axis."""
    pair = b if isinstance(b, tuple) else (b, b)
    if min(pair) <= A / 2:
        return math.inf
    return math.prod(v / math.sqrt(A * (2 * v - A)) * math.exp(d * d / (2 * v - A)) for v, d in zip(pair, centre, strict=True))


def plane(step: float = 0.01) -> tuple[Tensor, Tensor, float]:
    """Midpoints dx, dy of squares over the support of w, and their area; edges at multiples of the step fall between them."""
    half = round(max(W.radius) / step)
    d = (torch.arange(-half, half, dtype=torch.float64) + 0.5) * step
    return d[None], d[:, None], step * step


def printed_moment(sigma: float, pixel: Pair = (1.0, 1.0), m: int = 1, centre: Pair = (0.0, 0.0)) -> float:
    """(30) as printed, with m = 1 (29), for f = 1 and pixels of the given width and height in f's coordinates, by quadrature."""
    dx, dy, cell = plane()
    area = pixel[0] * pixel[1]
    r2 = ((dx - centre[0]) * pixel[0]).square() + ((dy - centre[1]) * pixel[1]).square()
    inner = (W(dx, dy) / area).square() * torch.exp(m / area * r2 / (2 * sigma))
    return area / m * 2 * math.pi * sigma * float(inner.sum()) * cell * area


def sub_pixels(strata: tuple[int, int]) -> list[Pair]:
    """(24): the centres of the sub-pixels about that of their pixel, row by row."""
    m1, m2 = strata
    return [((i + 0.5) / m1 - 0.5, (j + 0.5) / m2 - 0.5) for j in range(m2) for i in range(m1)]


def crude(n: int = 16) -> list[Row]:
    """(1)-(5): crude sampling is right for the pixel's own box, and for nothing else."""
    side, filter = 2 * SIDE, mcaa.Box()
    box, wanted, size = exact(DISC, filter, side=side), exact(DISC, side=side), (side, side)
    edge = coin(box) > 0
    right = mcaa.render(tiled(DISC), size, filter=filter, estimator=mcaa.Crude(), spp=n, dtype=torch.float64).image[0]
    wrong = render(tiled(DISC), size, mcaa.Crude(biased_ok=True), n, 1).image[0]
    near = coin(wanted) > 1e-3
    error = (wrong - wanted)[near]
    predicted = float((coin(box) / n + (box - wanted).square())[near].mean())
    spread = float(error.square().std()) / math.sqrt(error.numel()) / predicted
    return [
        mean_row("(1)-(5)", "crude, Box, discs: mean of the edges' pixels", box[edge], right[edge]),
        variance_row("(4)", "crude, Box, discs: φ(1 - φ) / n", coin(box)[edge] / n, (right - box)[edge]),
        Row("(3)", "crude, Gaussian: mean square error, bias included", predicted, float(error.square().mean()), spread),
    ]


def importance(n: int = 32) -> list[Row]:
    """(6), (10), (11), (25), (26), (29): f = 1, where the weights w / w' alone vary; and half-planes, where w' = w and λ = φ."""
    rows, size = [], (SIDE, SIDE)
    b = 0.4
    estimator = mcaa.Importance(mcaa.Independent(), mcaa.Normal(b))
    picture = render(one, size, estimator, n, 1)
    rows.append(variance_row("(10),(11)", f"f = 1, w' = N(0, {b})", (second_moment(b) - 1) / n, picture.image - 1))
    assert picture.predicted_variance is not None
    rows.append(
        mean_row("(10)", "    the same: Rendering.predicted_variance", (second_moment(b) - 1) / n, picture.predicted_variance)
    )
    rows.append(mean_row("(6)", "    the same: the mean", 1.0, picture.image))
    for seed, (b, centre) in enumerate([(0.25, (0.3, 0.1)), (0.5, (0.3, -0.2))], start=2):
        picture = render(one, size, mcaa.Importance(mcaa.Independent(), mcaa.Normal(b, centre)), n, seed)
        wanted = (second_moment(b, centre) - 1) / n
        rows.append(variance_row("(10),(11)", f"f = 1, w' = N({centre}, {b})", wanted, picture.image - 1))
    # σ is isotropic in f's coordinates, so not in pixels of 1.25 x 0.8
    sigma, width, height = 0.4, 1.25, 0.8
    gamma = width * height * sigma
    estimator = mcaa.Importance(mcaa.Independent(), mcaa.Normal((gamma / width**2, gamma / height**2)))
    extent = (0.0, SIDE * width, 0.0, SIDE * height)
    image = mcaa.render(one, size, filter=W, estimator=estimator, spp=n, extent=extent, seed=4, dtype=torch.float64).image
    wanted = (printed_moment(sigma, (width, height)) - 1) / n
    rows.append(variance_row("(25)-(29)", "f = 1, pixels of 1.25 x 0.8, σ = 0.4: λ by (29)", wanted, image - 1))
    scene, size = scenes.HalfPlane(0.0, 2.3), (8192, 5)
    truth = exact(scene, size=(1, 5), side=5)[:1].expand(size)
    error = render(scene, size, mcaa.Importance(mcaa.Independent()), n, 5).image[0] - truth
    return [*rows, variance_row("(10),(11)", "half-plane, w' = w, λ = φ: φ(1 - φ) / n", coin(truth) / n, error)]


def stratified(n: int = 24) -> list[Row]:
    """(7)-(9), (12), (13), (24), (27), (30): f = 1, with normal strata wide enough to have a second moment."""
    rows, size = [], (SIDE, SIDE)
    for seed, m, b in ((0, (2, 1), 0.4), (1, (2, 2), 0.4), (2, (3, 1), 0.3)):
        moments = [second_moment(b, centre) for centre in sub_pixels(m)]
        picture = render(one, size, mcaa.Stratified(m, mcaa.Normal(b), weights="paper"), n, seed)
        # m strata of n / m evaluations each
        wanted = sum(mu - 1 for mu in moments) / (len(moments) * n)
        rows.append(
            variance_row("(12),(13)", f"f = 1, {m[0]} x {m[1]} strata N(b_hj, {b}), paper weights", wanted, picture.image - 1)
        )
        rows.append(mean_row("(7)-(9)", "    the same: Σ_j s_j E[g_hj] = φ", 1.0, picture.image))
    sigma, m = 0.8, (2, 1)
    wanted = sum(printed_moment(sigma, m=2, centre=centre) - 1 for centre in sub_pixels(m)) / (2 * n)
    picture = render(one, size, mcaa.Stratified(m, mcaa.Normal(sigma / 2), weights="paper"), n, 3)
    return [*rows, variance_row("(27),(30)", "f = 1, 2 x 1 strata, σ = 0.8: μ by (30)", wanted, picture.image - 1)]


def balance(n: int = 40) -> list[Row]:
    """V = ∫ f² w² / q - Σ_j s_j (∫ f w ρ_j / q)², q = Σ_j s_j ρ_j: the balance heuristic, at the edge of a half-plane."""
    rows, offset, scene, size = [], 2.3, scenes.HalfPlane(0.0, 2.3), (8192, 5)
    truth = exact(scene, size=(1, 5), side=5)[:1].expand(size)
    dx, dy, cell = plane()
    # the centres of two sub-pixels have variance 1 / 16
    for seed, (name, density, b) in enumerate([("(28)", mcaa.Normal(A / 4), A / 4), ("matched", None, A - 1 / 16)]):
        # by default one evaluation in ten is drawn from w itself
        parts = [(n * 9 // 40, mcaa.Normal(b, centre).pdf(dx, dy)) for centre in sub_pixels((2, 2))] + [(n // 10, W(dx, dy))]
        q = torch.stack([s * rho for s, rho in parts]).sum(0)
        wanted = []
        for column in range(size[1]):
            fw = W(dx, dy) * (dx >= offset - column - 0.5)
            wanted.append(
                cell * float((fw.square() / q).sum()) - sum(s * (cell * float((fw * rho / q).sum())) ** 2 for s, rho in parts)
            )
        error = render(scene, size, mcaa.Stratified((2, 2), density, "balance"), n, seed).image[0] - truth
        variance = torch.tensor(wanted, dtype=torch.float64)
        rows.append(variance_row("V", f"half-plane, 2 x 2 strata {name}, balance weights", variance, error))
    return rows


def between_pixels(spp: int = 64) -> list[Row]:
    """(14), (15) and Neyman's least sum, with known variances: the φ(1 - φ) of discs."""
    side = 2 * SIDE
    truth = exact(DISC, side=side)
    variance, rows = coin(truth), []
    for seed, kind in enumerate((mcaa.EqualVariance, mcaa.Neyman)):
        allocation = kind(known=variance)
        picture = render(tiled(DISC), (side, side), mcaa.Importance(mcaa.Independent(), allocation=allocation), spp, seed)
        optimum, left = allocation.predicted(variance, spp * truth.numel()), variance / picture.spp
        if kind is mcaa.EqualVariance:
            edge = variance > 0.05  # where an error is not once in a while a large one
            error = (picture.image[0] - truth)[edge]
            rows.append(variance_row("(14),(15)", "discs, EqualVariance(known): pixels of φ(1 - φ) > 0.05", optimum, error))
            rows.append(Row("(15)", "    the same: the largest φ(1 - φ) / n_h", optimum, float(left.max())))
        else:
            error = variance_row("Neyman", "discs, Neyman(known): mean square error", left, picture.image[0] - truth)
            least = optimum / truth.numel()
            rows.append(Row(error.equation, error.what, least, error.observed, error.spread * error.predicted / least))
            rows.append(Row("Neyman", "    the same: the mean of φ(1 - φ) / n_h", least, float(left.mean())))
    return rows


def between_strata(n: int = 384) -> list[Row]:
    """(16)-(18): f = 1, strata of unlike μ_hj. A quarter of the evaluations is the pilot, left out of the value and of the prediction."""
    m, b, side = (3, 1), 0.3, 96
    spread = torch.tensor([math.sqrt(second_moment(b, centre) - 1) for centre in sub_pixels(m)], dtype=torch.float64)
    left = n - n // 12 * 3
    least = float(spread.sum() ** 2) / (9 * left)
    s = strata_counts(spread, left)
    estimator = mcaa.Stratified(m, mcaa.Normal(b), weights="paper", counts="optimal", combine="discard_pilot")
    picture = render(one, (side, side), estimator, n, 0)
    return [
        Row("(16),(17)", "f = 1, 3 x 1 strata: (12) with whole numbers s_j", least, float((spread.square() / s).sum()) / 9),
        Row("(18)", "    the same: (12) with equal s_j, never below", least, float(spread.square().sum()) / (3 * left)),
        variance_row("(17)", "    the same: optimal counts from a pilot", least, picture.image - 1),
    ]


def both(n: int = 384) -> list[Row]:
    """(19), (20): f = exp(k x), where every pixel has another variance, in closed form, and every stratum another share of it."""
    m, b, k, size = (3, 1), 0.3, 0.05, (600, 16)
    value = math.exp(k * k * A / 2)
    # w² / ρ_j is in proportion to a normal density of variance a b / (2b - a) about -a d / (2b - a)
    mean = [math.exp(2 * k * (k * A * b - A * d[0]) / (2 * b - A)) for d in sub_pixels(m)]
    moments = [second_moment(b, d) * e for d, e in zip(sub_pixels(m), mean, strict=True)]
    own = sum(math.sqrt(mu - value**2) for mu in moments) ** 2 / 9
    c = Screen.of(size).centres()[0]
    known, truth = (own * torch.exp(2 * k * c)).expand(size), value * torch.exp(k * c)
    allocation = mcaa.EqualVariance(known=known)
    estimator = mcaa.Stratified(
        m, mcaa.Normal(b), weights="paper", counts="optimal", allocation=allocation, combine="discard_pilot"
    )
    picture = render(lambda x, y: torch.exp(k * x), size, estimator, n, 0)
    common = float(known.sum()) / float((picture.spp - picture.spp // 12 * 3).sum())
    return [variance_row("(19),(20)", "f = exp(x / 20): EqualVariance(known) and optimal strata", common, picture.image - truth)]


def pilots() -> list[Row]:
    """Section 9: what becomes of a pilot that chose the numbers of evaluations. Every pixel has coverage 0.10."""
    rows = []
    for seed, combine in enumerate(("fixed", "discard_pilot", "pooled")):
        estimator = mcaa.Importance(mcaa.Independent(), allocation=mcaa.EqualVariance(), combine=combine)
        picture = mcaa.render(
            lambda x, y: (x % 1 < 0.1).float(), (SIDE, SIDE), filter=mcaa.Box(), estimator=estimator, spp=16, seed=seed
        )
        note = " (Rendering.bias says so)" if picture.bias else ""
        rows.append(mean_row("§9", f"two stages, φ = 0.10, combine={combine!r}{note}", 0.1, picture.image.double()))
    return rows


def controlled(sign: int) -> mcaa.Pairs:
    """(C - ψ) / w' with ψ = 2w, and with the given sign its integral: + in truth, - in the paper."""
    return mcaa.Pairs([(lambda f, dx, dy: f - 2 + 2 * sign, mcaa.FilterDensity(W))], check=False)


def ramp(x: Tensor, y: Tensor) -> Tensor:
    return 3 + x / SIDE


def signs() -> list[Row]:
    """(2), (3) and section 9: the sign before the integral of ψ; with a minus the bias is -2 ∫ψ."""
    plus, minus = (render(ramp, (SIDE, SIDE), controlled(sign), 16, seed).image for seed, sign in enumerate((1, -1)))
    return [mean_row("§9", "(C - ψ) / w' + ∫ψ, ∫ψ = 2: φ", 3.5, plus), mean_row("§9", "(C - ψ) / w' - ∫ψ: φ - 2 ∫ψ", -0.5, minus)]


def refusals() -> list[str]:
    """What the library says of what cannot be right."""
    cases = [
        ("(3), crude sampling under a Gaussian", mcaa.Crude()),
        (f"(28) for 2 x 1 strata, where (13) is {second_moment(A / 2)}", mcaa.Stratified((2, 1), weights="paper")),
        ("(3), a minus before ∫ψ", mcaa.Pairs(controlled(-1).pairs, check=True)),
    ]
    said = []
    for what, estimator in cases:
        try:
            render(ramp, (16, 16), estimator, 16, 0)
        except mcaa.McaaError as error:
            said.append(f"{what}\n    McaaError: {error}")
    biased = render(ramp, (16, 16), mcaa.Crude(biased_ok=True), 16, 0)
    return [*said, f"Crude(biased_ok=True)\n    Rendering.bias: {biased.bias[0]}"]


def gains() -> list[Row]:
    """Sections 2, 9, 10: mean squared error over (10) for independent importance sampling; edges are pixels of φ(1 - φ) > 0.001."""
    n, side, independent = 64, 96, mcaa.Independent()
    size = (side, side)
    stripe, blob = scenes.Stripe(0.0, 8.3, 6.0), scenes.Blob(8.3, 7.8, 0.4, 20.0)
    disc, edge, axis, lights = exact(DISC, side=side), exact(stripe, side=side), tiled(stripe), scenes.Highlights((blob,), 0.1)
    light = exact(lights, side=side)
    # f² = height² exp(-ρ² / std²) + 0.2 blob + 0.01
    square = exact(scenes.Blob(blob.cx, blob.cy, blob.std / math.sqrt(2), blob.height**2), side=side) + 0.2 * light - 0.01
    bowl = scenes.Quadratic(48.0, 48.0, 0.01, 0.004, -0.006)
    x, y = (c - 48.0 for c in Screen.of(size).centres())
    slope = (0.02 * x + 0.004 * y[:, None]).square() + (0.004 * x - 0.012 * y[:, None]).square()
    curved = A * slope + A * A * (2 * (0.01**2 + 0.006**2) + 0.004**2)
    cases: list[tuple[str, str, Function, Tensor, Tensor, Estimator]] = [
        ("§2", "edges: Stratified((2, 2), Normal by (28))", axis, edge, coin(edge), mcaa.Stratified((2, 2), mcaa.Normal(A / 4))),
        ("§2", "edges: Stratified((2, 2)), matched", axis, edge, coin(edge), mcaa.Stratified((2, 2), weights="balance")),
        ("§2", "edges: Stratified((8, 8), weights='filter')", axis, edge, coin(edge), mcaa.Stratified((8, 8), weights="filter")),
        ("§9", "highlights: AdaptiveImportance(pattern=Independent())", tiled(lights), light, square - light.square(),
         mcaa.AdaptiveImportance(pattern=independent)),
        ("§9", "highlights: AdaptiveImportance()", tiled(lights), light, square - light.square(), mcaa.AdaptiveImportance()),
        ("§9", "quadratic: ControlVariate()", bowl, exact(bowl, size=size, side=side), curved, mcaa.ControlVariate()),
        ("§10", "axis edges: OrderedStrata()", axis, edge, coin(edge), mcaa.OrderedStrata()),
    ]  # fmt: skip
    rows = []
    for seed, (section, what, f, truth, variance, estimator) in enumerate(cases):
        picture = render(f, size, estimator, n, seed)
        kept = variance > 0.001 if "edges" in what else torch.ones_like(variance, dtype=torch.bool)
        squares, before = (picture.image[0] - truth)[kept].square(), float(variance[kept].mean()) / n
        rows.append(Row(section, what, before, float(squares.mean()), float(squares.std()) / math.sqrt(squares.numel()) / before))
    for seed, kind in enumerate((mcaa.EqualVariance, mcaa.Neyman)):
        estimator = mcaa.Importance(independent, allocation=kind(), combine="discard_pilot")
        picture = render(tiled(DISC), size, estimator, n, seed)
        squares, before = (picture.image[0] - disc).square(), float(coin(disc).mean()) / n
        spread = float(squares.std()) / math.sqrt(squares.numel()) / before
        rows.append(Row("§9", f"discs: two stages, {kind.__name__}(), the second alone", before, float(squares.mean()), spread))
        largest = float((coin(disc) / (picture.spp - n // 4)).max())
        rows.append(Row("§9", "    the same: the largest φ(1 - φ) / n_h", float(coin(disc).max()) / n, largest))
    return rows


def pictures(folder: Path, side: int = 64, spp: int = 64) -> list[Path]:
    """n_h beside the picture, white = the largest: with known variances, and in both stages of estimated ones."""
    scene = scenes.Disc(0.5 * side, 0.5 * side, 0.36 * side)
    known = coin(exact(scene, size=(side, side), side=side))
    kinds, pilot = (mcaa.EqualVariance, mcaa.Neyman), spp // 4
    shots = [
        render(scene, (side, side), mcaa.Importance(mcaa.Independent(), allocation=allocation), spp, 0)
        for allocation in (*(kind(known=known) for kind in kinds), *(kind() for kind in kinds))
    ]
    maps = {
        "known": [beside(shot.image, shot.spp) for shot in shots[:2]],
        "two-stages": [beside(shot.image, torch.full_like(shot.spp, pilot), shot.spp - pilot) for shot in shots[2:]],
    }
    for name, panels in maps.items():
        write_picture(folder / f"counts-{name}.png", image=torch.cat(panels, 1), force=True)
    return [folder / f"counts-{name}.png" for name in maps]


def beside(image: Tensor, *counts: Tensor, zoom: int = 4) -> Tensor:
    """(1, H, W): the picture and maps of counts on one scale; grey is in proportion to the count once saving has applied its curve."""
    largest = max(int(n.max()) for n in counts)
    panels = [image, *(srgb_decode(n[None].double() / largest) for n in counts)]
    panels = [panel.repeat_interleave(zoom, 1).repeat_interleave(zoom, 2) for panel in panels]
    return torch.cat([torch.nn.functional.pad(panel, (4, 4, 4, 4), value=1.0) for panel in panels], 2)


def table(title: str, left: str, right: str, rows: list[Row]) -> None:
    print(f"\n{title:<80}{left:>11}{right:>11}   ratio       ±")
    for row in rows:
        print(f"{row.equation:<10} {row.what:<69}{row.predicted:11.4g}{row.observed:11.4g}{row.ratio:8.3f}{row.spread:8.3f}")


def main(folder: Path) -> None:
    start = time.perf_counter()
    parts = (crude, importance, stratified, balance, between_pixels, between_strata, both, pilots, signs)
    table("Equations: means, and mean squared errors", "predicted", "observed", [row for part in parts for row in part()])
    table("Estimators: mean squared errors of 64 evaluations a pixel", "Importance", "this", gains())
    print("\nRefused, and said\n" + "\n".join(refusals()))
    paths = pictures(folder)
    print(
        f"\nn_h beside the picture: {', '.join(path.name for path in paths)} in {folder.resolve()}; {time.perf_counter() - start:.0f} s"
    )


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
