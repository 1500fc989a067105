"""Pictures on disk: linear light in memory, the sRGB curve only where the file has 8 or 16 bits.

============  ==========================================================================================
extension     what `write_picture` writes
============  ==========================================================================================
.png          image (1, 3 or 4 channels), 8 or 16 bits, sRGB curve, alpha linear and straight; no more fits
.exr          float32 channels: image as Y, R G B or R G B A, or as image.0, image.1, ... for any other
              number of them; stderr.R ... under the same suffixes; spp.Y, invalid.Y, model.Y
.tif, .tiff   float32, a page for each of image, stderr, spp, invalid, model, named by its description
.npz          image, stderr (H, W, C); spp, invalid, model (H, W); under these names, in their precision
.npy          image (H, W, C); no more fits
============  ==========================================================================================

float32 holds the counts in EXR and TIFF exactly up to 2**24.
"""

from __future__ import annotations

from torch_mcaa.image_io.read import read_image
from torch_mcaa.image_io.srgb import srgb_decode, srgb_encode
from torch_mcaa.image_io.write import check_channels, check_target, to_srgb8, write_picture

__all__ = ["check_channels", "check_target", "read_image", "srgb_decode", "srgb_encode", "to_srgb8", "write_picture"]
