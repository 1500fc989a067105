"""A coordinate network as an integrand, and EXR-ready layers saved as NPZ."""

import torch

import torch_mcaa as mcaa

generator = torch.Generator().manual_seed(1)
first, second = torch.randn(2, 64, generator=generator) * 0.2, torch.randn(64, 3, generator=generator) * 0.3


def network(points: torch.Tensor) -> torch.Tensor:
    return torch.sigmoid(torch.sin(points @ first.to(points)) @ second.to(points))


picture = mcaa.render(mcaa.from_points(network), (96, 128), filter=mcaa.Mitchell(), spp=16)
picture.save("network.npz")
print(f"{picture.image.shape[0]} channels, standard error at most {float(picture.stderr.max()):.2g}")
