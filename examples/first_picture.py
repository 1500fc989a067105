"""Three functions at once, one a channel: rings, a zone plate and a disc."""

import torch

import torch_mcaa as mcaa


def f(x: torch.Tensor, y: torch.Tensor) -> tuple[torch.Tensor, ...]:
    r = torch.hypot(x - 128, y - 128)
    return (torch.remainder(r, 24) < 12).float(), 0.5 + 0.5 * torch.cos(0.01 * r * r), (torch.hypot(x - 90, y - 150) < 70).float()


picture = mcaa.render(f, (256, 256), spp=16)
picture.save("first_picture.png")
print(f"largest standard error {float(picture.stderr.max()):.2g}, {picture.evaluations / 256**2:.1f} evaluations a pixel in all")
