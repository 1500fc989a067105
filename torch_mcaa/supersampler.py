"""`Supersampler`: anti-aliased pictures as a differentiable layer."""

from __future__ import annotations

from typing import Any, Literal

import torch
from torch import Tensor

from torch_mcaa.arguments import task_of
from torch_mcaa.compiling import uncompiled
from torch_mcaa.dense import described, pictures
from torch_mcaa.errors import McaaError, warn
from torch_mcaa.estimators import Auto, Estimator, JumpCorrected
from torch_mcaa.estimators.base import Task
from torch_mcaa.filters import Filter, Gaussian
from torch_mcaa.grid import Screen
from torch_mcaa.integrand import Function
from torch_mcaa.render import render
from torch_mcaa.replay.autocast import Autocast
from torch_mcaa.replay.function import Replayed
from torch_mcaa.replay.gradients import Replay
from torch_mcaa.replay.looks import Looks
from torch_mcaa.replay.of_texels import OfTexels
from torch_mcaa.replay.plan import followed, plan
from torch_mcaa.texture import Texture
from torch_mcaa.traced.inside import transformed

_TRIED = 256
"""Evaluations a pixel, at most, of the picture of one pixel by which a layer's arguments are tried."""


class Supersampler(torch.nn.Module):
    """A layer from functions, or textures, to anti-aliased pictures, differentiable in everything they depend on.

    The picture is that of `render`, except that where the trace can follow f, `Auto()` and `JumpCorrected()` take the jumps at its decisions
    from those, located by what crosses zero there, as the gradient does. Its gradient is that of (1): with respect to what f(x, y) uses
    (parameters of a module, tensors of a closure), and, with the derivative moved onto the filter, with respect to an `extent`, the
    `transform` of a `Texture` and the std of a `Gaussian`. The forward pass keeps no tape: the backward pass evaluates f again, in blocks, so
    memory does not grow with `spp`. The variables that a plain Python function f reads are held at what they were; whatever else f reads must
    not change between the two (McaaError; PyTorch's own error for a change in place), and f must not draw random numbers (a warning).

    A `Texture` whose rows and columns are the screen's, such as those of a batch, is exact under `Auto()`, and so is the gradient of its texels.

    With `estimator=Shared(Lattice())` and `decorrelate=False` the backward pass has the forward's points, and its gradient with respect to
    what f uses is the exact derivative of the returned value.

    Pictures are float32 (float64 where that is the default dtype) on the CPU unless the layer is converted, as by `layer.double()` or
    `layer.to("cuda")`; textures bring their own.

    Attributes:
        calls: how often the layer was called, part of its `state_dict`. A call has `seed` plus the calls before it as its seed.
    """

    def __init__(
        self,
        size: tuple[int, int],
        *,
        filter: Filter | None = None,
        estimator: Estimator | None = None,
        spp: int = 16,
        extent: tuple[float, float, float, float] | Tensor | None = None,
        boundary: Literal["extend", "zero", "renormalize"] = "extend",
        seed: int = 0,
        redraw: bool = True,
        decorrelate: bool = True,
        discontinuities: Literal["auto", False] = "auto",
    ) -> None:
        """Set what all pictures have in common; what is not explained here is explained in `render`.

        Args:
            size: (height, width) in pixels.
            filter: `Gaussian(std)` with a tensor `std` that requires a gradient gives it one; a `Parameter` becomes one of the layer's.
            spp: a cap on the mean number of evaluations of f in a pixel, in each pass; a look at f's decisions, some thousand points, and margins
                as in `render` come on top.
            extent: (x0, x1, y0, y1); a tensor of the four that requires a gradient gets one.
            redraw: new points at each call.
            decorrelate: points of its own for the backward pass, independent of what the loss made of the picture: the gradient of a loss that is
                quadratic in the picture is unbiased. Of another loss what is left is that its own slope is taken at a picture with noise.
            discontinuities: "auto" traces f's decisions, and counts what its jumps contribute as they move, too; it warns of what it cannot
                trace, and where f is found to change as by a jump and decides nothing. False is plain automatic differentiation of the
                picture of `render`.

        Raises:
            McaaError: an argument that cannot be used.
        """
        super().__init__()
        if transformed():
            raise McaaError(
                "a layer cannot be made inside a transform of functions (torch.func.grad, vmap and the like); make it outside"
            )
        if discontinuities is not False and not (isinstance(discontinuities, str) and discontinuities == "auto"):
            raise McaaError(f"discontinuities must be 'auto' or False, got {discontinuities!r}")
        for name, flag in (("redraw", redraw), ("decorrelate", decorrelate)):
            if not isinstance(flag, bool):
                raise McaaError(f"{name} must be True or False, got {flag!r}")
        self.size, self.spp, self.seed = size, spp, seed
        self.boundary: Literal["extend", "zero", "renormalize"] = boundary
        self.redraw, self.decorrelate, self.discontinuities = redraw, decorrelate, discontinuities
        self.filter = Gaussian(0.5) if filter is None else filter
        self.estimator = Auto() if estimator is None else estimator
        self.extent = extent
        self.calls = 0
        self._since_recomputed = 0
        self._looks = Looks()
        # holds nothing but the layer's dtype and device
        default = torch.get_default_dtype()
        dtype = default if default == torch.float64 else torch.float32
        self.register_buffer("_like", torch.empty(0, dtype=dtype), persistent=False)
        self._like: Tensor
        # `render` refuses now what it would refuse later; many samples would take their time
        Screen.of(size, self._extent())
        few = min(spp, _TRIED) if isinstance(spp, int) else spp
        self._render(lambda x, y: torch.zeros_like(x), (1, 1), few, seed, torch.float32, torch.device("cpu"))
        for number, parameter in enumerate(self.filter.learned):
            if isinstance(parameter, torch.nn.Parameter):
                self.register_parameter(f"filter_{number}", parameter)

    @uncompiled
    def forward(self, f: Function | Tensor, call: int | None = None) -> Tensor:
        """The picture of f, (C, H, W), or the pictures (B, C, H, W) of textures (B, C, h, w) that cover the screen once, bilinear.

        Args:
            f: as in `render`, or a floating tensor of textures.
            call: which points to take, a number from 0 on: equal numbers give equal points. By default the layer counts its calls. Where
                `torch.utils.checkpoint` calls again in the backward pass, the points of the last call are taken again; a layer called
                several times before the backward pass is to be told which.

        Raises:
            McaaError: a call inside torch.func.grad, vmap or the like;
                an f that breaks its contract, lies on another device or uses tensors in a way that cannot be followed; a
                transform whose horizon lies on the screen, or a filter or boundary for which a wanted gradient does not exist. From the
                backward pass: f raised, changed since the forward pass, or used tensors it had not used before; a second derivative was
                asked for.
        """
        if transformed() or torch.autograd.forward_ad._current_level >= 0:
            raise McaaError(
                "the layer has a backward pass of its own and works with torch.autograd: loss.backward() or torch.autograd.grad(); it was called "
                "inside a transform of functions (torch.func.grad, vjp, jvp, vmap and the like, or forward_ad), which it cannot be part of"
            )
        seed = (self.seed + self._number(call)) % 2**64
        if not isinstance(f, Tensor):
            return self._picture(f, seed, self._like.dtype, self._like.device)
        if not pictures(f) or f.ndim != 4:
            raise McaaError(
                f"textures must be a dense floating tensor (B, C, h, w) that is not empty, got {described(f)}; for one of (C, h, w) pass "
                "Texture(image)"
            )
        texture = Texture(f.flatten(0, 1))
        return self._picture(texture, seed, texture.image.dtype, f.device).to(f.dtype).unflatten(0, f.shape[:2])

    def _picture(self, f: Function, seed: int, dtype: torch.dtype, device: torch.device) -> Tensor:
        if device.type == "meta":
            raise McaaError("a picture needs values, and tensors on meta have none; move the layer to another device")
        if isinstance(f, torch.nn.Module):
            for name, tensor in f.named_parameters():
                if tensor.device != device:
                    raise McaaError(
                        f"the layer's pictures are on {device}, f's parameter {name} on {tensor.device}; move one by layer.to() or f.to()"
                    )
        autocast = Autocast.now(device.type)
        with torch.autocast(device.type, enabled=False):
            task = self._task(f, seed, dtype, device)
            replay = self._replay(task, autocast) if torch.is_grad_enabled() else None
            function = autocast.of(f)
            # margins of half precision say little of where they are 0; a texture's values show its jumps as well as its decisions do
            follows = self.discontinuities and autocast.dtype is None and not isinstance(f, Texture)
            if follows and isinstance(self.estimator, Auto | JumpCorrected):
                function = followed(task, function)
            picture = self._render(function, self.size, self.spp, seed, dtype, device)
        if replay is None or not replay.parameters:
            return picture
        return Replayed.apply(replay, picture, *replay.parameters)  # pyright: ignore[reportReturnType]

    def _render(self, f: Function, size: tuple[int, int], spp: int, seed: int, dtype: torch.dtype, device: torch.device) -> Tensor:
        return render(
            f,
            size,
            filter=self.filter,
            estimator=self.estimator,
            spp=spp,
            extent=self._extent(),
            boundary=self.boundary,
            seed=seed,
            dtype=dtype,
            device=device,
            progress=False,
        ).image

    def _task(self, f: Function, seed: int, dtype: torch.dtype, device: torch.device) -> Task:
        screen = Screen.of(self.size, self._extent())
        return task_of(f, screen, self.filter, self.boundary, "raise", seed, dtype, device, self.extent is None)

    def _replay(self, task: Task, autocast: Autocast) -> Replay | OfTexels:
        extent = self.extent
        wanted = extent if isinstance(extent, Tensor) and extent.requires_grad else None
        exact = OfTexels.of(task, wanted) if isinstance(self.estimator, Auto) else None
        return exact or plan(
            task, autocast, self.spp, wanted, self.decorrelate, bool(self.discontinuities), self._looks.due(task.integrand.function)
        )

    def _extent(self) -> Any:
        return self.extent.tolist() if isinstance(self.extent, Tensor) else self.extent

    def _number(self, call: int | None) -> int:
        """The number of a call, which is counted if it is a new one."""
        if call is not None:
            if isinstance(call, bool) or not isinstance(call, int) or call < 0:
                raise McaaError(f"call must be an integer from 0 on, got {call!r}")
            return call
        if not self.redraw:
            return 0
        # the identity of the backward pass that this thread is in; only what is run again is called there
        if torch._C._current_graph_task_id() != -1 and self.calls:
            if self._since_recomputed > 1:
                warn(
                    f"a checkpoint calls the layer again, which was called {self._since_recomputed} times since: the points of the last "
                    "call are taken; say which call is meant by layer(f, call=...)"
                )
            self._since_recomputed = 0
            return self.calls - 1
        self.calls += 1
        self._since_recomputed += 1
        return self.calls - 1

    def get_extra_state(self) -> Tensor:
        return torch.tensor(self.calls)

    def set_extra_state(self, state: Tensor) -> None:
        self.calls = int(state)

    def extra_repr(self) -> str:
        return f"{self.size}, filter={self.filter}, estimator={self.estimator}, spp={self.spp}, boundary={self.boundary!r}, seed={self.seed}"
