"""Work until every pixel is good to the tolerance: flat parts stop early, edges go on."""

import torch

import torch_mcaa as mcaa


def f(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    return (torch.hypot(x - 60, y - 50) < 30).float()


picture = mcaa.render(f, (256, 256), tolerance=2e-2, spp=64)
low, high = picture.interval(0.95)
mean, least, most = float(picture.spp.double().mean()), int(picture.spp.min()), int(picture.spp.max())
print(f"stopped by {picture.stopped} at {mean:.1f} evaluations a pixel ({least} to {most})")
print(f"widest 95 % interval {float((high - low).max()):.3f}")
