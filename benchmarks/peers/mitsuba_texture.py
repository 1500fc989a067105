"""Mitsuba 3 on a rectangle that emits the picture as a texture, seen head on.

Fair: a renderer of surfaces cannot call f, so f is sampled on a k x k grid in every pixel, and as many samples are taken of that texture. The
camera is orthographic, the sampler multi-jittered, the reconstruction filter the Gaussian of 0.5 px; the texture is read bilinearly and in
linear light. The variant is `scalar_rgb`, which runs on all cores: `llvm_ad_rgb` compiles with whatever LLVM the system has, and an old one
ends the process.
"""

from __future__ import annotations

import importlib
import math
from typing import Any

import torch

from .base import STD, Outcome
from .cases import Case
from .grid import MARGIN, samples


def _mitsuba() -> Any:
    mitsuba: Any = importlib.import_module("mitsuba")
    mitsuba.set_variant("scalar_rgb")
    return mitsuba


def render(case: Case, spp: int, seed: int) -> Outcome:
    mitsuba = _mitsuba()
    size, k = case.size, max(1, math.isqrt(spp // 2))
    texels = samples(case.scene, slice(0, size), size, k)
    wide = size + 2 * MARGIN
    transform = mitsuba.ScalarTransform4f
    scene = mitsuba.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct", "hide_emitters": False},
            "sensor": {
                "type": "orthographic",
                "to_world": transform().look_at([0, 0, 1], [0, 0, 0], [0, 1, 0]).scale([size / wide, size / wide, 1]),
                "film": {
                    "type": "hdrfilm",
                    "width": size,
                    "height": size,
                    "pixel_format": "luminance",
                    "component_format": "float32",
                    "rfilter": {"type": "gaussian", "stddev": STD},
                },
                "sampler": {"type": "multijitter", "sample_count": k * k},
            },
            "picture": {
                "type": "rectangle",
                "emitter": {
                    "type": "area",
                    "radiance": {
                        "type": "bitmap",
                        "bitmap": mitsuba.Bitmap(texels.flip(0).contiguous().numpy()[:, :, None]),
                        "raw": True,
                        "wrap_mode": "clamp",
                    },
                },
            },
        }
    )
    image = torch.tensor(mitsuba.TensorXf(mitsuba.render(scene, seed=seed)).numpy())[:, :, 0]
    return Outcome(image, k * k * wide * wide + k * k * size * size)
