"""A coordinate network trained on pictures below its own resolution.

Four pictures of 16 x 16 pixels, half a pixel apart, show a scene of 64 x 64 units: each pixel is a mean over 4 x 4 units and more. Trained
through the layer the network is asked for such means, and learns what lies between the pixels from the four together; trained on
the values at the pixels' centres it is taught the means as if they were points, and learns a blur.
"""

import torch
from torch import Tensor

import torch_mcaa as mcaa

UNITS, PIXELS, STEPS = 64, 16, 500
SHIFTS = [(0.0, 0.0), (2.0, 0.0), (0.0, 2.0), (2.0, 2.0)]


def scene(x: Tensor, y: Tensor) -> Tensor:
    return 0.5 + 0.25 * torch.cos(0.5 * x + 0.2 * y) + 0.25 * torch.sin(0.4 * y - 0.1 * x)


def network(seed: int) -> torch.nn.Module:
    generator = torch.Generator().manual_seed(seed)
    features = torch.randn(2, 32, generator=generator) * 0.2
    layers = torch.nn.Sequential(torch.nn.Linear(64, 48), torch.nn.Tanh(), torch.nn.Linear(48, 1))
    for parameter in layers.parameters():
        torch.nn.init.normal_(parameter, std=0.15, generator=generator)

    class Fourier(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.layers = layers

        def forward(self, x: Tensor, y: Tensor) -> Tensor:
            phase = x[..., None] * features[0] + y[..., None] * features[1]
            return self.layers(torch.cat([phase.sin(), phase.cos()], -1))[..., 0]

    return Fourier()


layers = [
    mcaa.Supersampler((PIXELS, PIXELS), extent=(dx, UNITS + dx, dy, UNITS + dy), estimator=mcaa.Shared(), spp=16)
    for dx, dy in SHIFTS
]
with torch.no_grad():
    pictures = [layer(scene) for layer in layers]
centres = (torch.arange(PIXELS) + 0.5) * (UNITS / PIXELS)
fine = torch.arange(8.0, UNITS - 8, 0.5)


def train(through_the_layer: bool) -> tuple[list[float], float]:
    """The losses of the steps, and the root mean square error at points of the scene."""
    net = network(seed=0)
    descent = torch.optim.Adam(net.parameters(), lr=0.015)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(descent, STEPS)
    losses = []
    for step in range(STEPS):
        descent.zero_grad()
        number = step % len(SHIFTS)
        dx, dy = SHIFTS[number]
        seen = layers[number](net) if through_the_layer else net(*torch.meshgrid(centres + dx, centres + dy, indexing="xy"))[None]
        loss = (seen - pictures[number]).square().mean()
        loss.backward()
        descent.step()
        schedule.step()
        losses.append(float(loss.detach()))
    with torch.no_grad():
        points = torch.meshgrid(fine, fine, indexing="xy")
        return losses, float((net(*points) - scene(*points)).square().mean().sqrt())


for through_the_layer, name in ((True, "through the layer"), (False, "on pixel centres")):
    losses, error = train(through_the_layer)
    steps = ", ".join(f"{losses[k]:.2g}" for k in (0, 50, 100, STEPS - 1))
    print(f"{name}: loss {steps}; error at points of the scene {error:.2g}")
