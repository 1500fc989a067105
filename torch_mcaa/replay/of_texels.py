"""The backward pass of a picture that is linear in a texture's texels and was made without samples: the transposed map."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from torch_mcaa.estimators.base import Task
from torch_mcaa.estimators.texels import Texels


@dataclass(frozen=True)
class OfTexels:
    """As `Replay`, exactly."""

    texels: Texels

    @classmethod
    def of(cls, task: Task, extent: Tensor | None) -> OfTexels | None:
        """That of the task, if at most texels are to get a gradient; what moves the texture, or the filter, is known by samples."""
        texels = Texels.of(task)
        others = () if texels is None else (extent, texels.texture.transform, *task.filter.learned)
        return None if texels is None or any(other is not None and other.requires_grad for other in others) else cls(texels)

    @property
    def parameters(self) -> tuple[Tensor, ...]:
        image = self.texels.texture.image
        return (image,) if image.requires_grad else ()

    def gradients(self, grad: Tensor, value: Tensor) -> list[Tensor | None]:
        """With respect to `parameters`, as in `Replay`."""
        return [self.texels.gradient(grad.detach())]
