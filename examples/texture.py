"""A photograph seen in perspective, without aliasing towards the horizon."""

import numpy as np
import skimage.data
import torch

import torch_mcaa as mcaa
from torch_mcaa.image_io import srgb_decode

image = srgb_decode(torch.from_numpy(np.moveaxis(skimage.data.astronaut(), -1, 0) / 255.0).float())
# screen pixels to texels: the top of the screen is six times as far away as the bottom
tilt = torch.tensor([[1.6, 0.907, -217.6], [0.0, 2.167, -8.2], [0.0, 0.00354, 0.15]])
picture = mcaa.render(mcaa.Texture(image, "bilinear", "repeat", transform=tilt), (240, 320), spp=16)
picture.save("texture.png")
print(f"standard error {float(picture.stderr.square().mean().sqrt()):.2g} root mean square")
