"""A disc, a polygon and a checkerboard's frequency fitted to a target picture by gradient descent through the layer.

f is a plain comparison in all three: automatic differentiation of its samples gives no gradient, and the parameters do not move. With the
boundary term, the layer's default, the loss falls to less than a hundredth. `fit_shapes.png` has the curves.
"""

import warnings
from collections.abc import Callable

import torch
from matplotlib.figure import Figure
from torch import Tensor

import torch_mcaa as mcaa

SIZE, STEPS = (48, 48), 60
Function = Callable[[Tensor, Tensor], Tensor]


def disc(p: Tensor) -> Function:
    """p: centre and radius."""
    return lambda x, y: (torch.hypot(x - p[0], y - p[1]) < p[2]).to(x)


def polygon(p: Tensor) -> Function:
    """p: the corners of a convex polygon, one after the other."""
    corners = p.view(-1, 2)
    sides = corners.roll(-1, 0) - corners

    def f(x: Tensor, y: Tensor) -> Tensor:
        left = [sx * (y - cy) - sy * (x - cx) > 0 for (cx, cy), (sx, sy) in zip(corners, sides, strict=True)]
        return torch.stack(left).all(0).to(x)

    return f


def checkerboard(p: Tensor) -> Function:
    """p: squares a pixel."""
    return lambda x, y: torch.remainder(torch.floor(x * p[0]) + torch.floor(y * p[0]), 2)


# what to find, and a start: half a radius off; half a radius off; a quarter of a period off at the picture's far side
FITS = {
    "disc": (disc, [24.0, 22.0, 12.0], [30.0, 22.0, 9.0], 0.5),
    "polygon": (polygon, [12.0, 10.0, 36.0, 14.0, 33.0, 38.0, 10.0, 32.0], [18.0, 10.0, 42.0, 14.0, 39.0, 38.0, 16.0, 32.0], 0.5),
    "checkerboard": (checkerboard, [1 / 12], [1 / 12 + 0.5 / 48], 4e-4),
}


def fit(name: str, jumps: bool, steps: int) -> tuple[list[float], float]:
    """The losses of the steps, and how far the parameters have moved."""
    make, wanted, start, rate = FITS[name]
    target = mcaa.render(make(torch.tensor(wanted)), SIZE, spp=64, seed=1, progress=False).image
    p = torch.tensor(start, requires_grad=True)
    layer = mcaa.Supersampler(SIZE, estimator=mcaa.Shared(), discontinuities="auto" if jumps else False)
    descent = torch.optim.Adam([p], lr=rate, betas=(0.5, 0.9))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(descent, steps)
    losses = []
    for _ in range(steps):
        descent.zero_grad()
        loss = (layer(make(p)) - target).square().mean()
        loss.backward()
        descent.step()
        schedule.step()
        losses.append(float(loss.detach()))
    return losses, float((p.detach() - torch.tensor(start)).abs().max())


figure = Figure(figsize=(10, 3), layout="constrained")
panels = figure.subplots(1, len(FITS), sharey=True)
for name, panel in zip(FITS, panels, strict=True):
    losses, moved = fit(name, jumps=True, steps=STEPS)
    print(f"{name}: loss " + ", ".join(f"{losses[k]:.2g}" for k in (0, 10, 20, 40, STEPS - 1)) + f", moved by {moved:.3g}")
    assert losses[-1] < 0.01 * losses[0]
    panel.semilogy([loss / losses[0] for loss in losses], label="with the boundary term")
    with warnings.catch_warnings():
        # the layer says that no gradient reaches the parameters
        warnings.simplefilter("ignore", mcaa.McaaWarning)
        losses, moved = fit(name, jumps=False, steps=STEPS)
    panel.semilogy([loss / losses[0] for loss in losses], "--", label="without")
    panel.set(title=name, xlabel="step")
    print(f"    without the boundary term: loss {losses[0]:.2g}, {losses[-1]:.2g}, moved by {moved:.3g}")
    assert moved == 0
panels[0].set(ylabel="loss over the first one")
panels[0].legend()
figure.savefig("fit_shapes.png")
