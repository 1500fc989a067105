"""An accelerator for machines that have none: its tensors live on the CPU, and meeting one of the CPU's is an error, as it is on a real one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map

# places to index with may lie on the CPU, and copies go between devices
_MIXED = ("index", "index_put", "index_put_", "_index_put_impl_", "_unsafe_index", "copy_", "_to_copy", "equal")


class _There(Tensor):
    """A tensor on the pretended device; `held` has its values."""

    held: Tensor

    @staticmethod
    def __new__(cls, held: Tensor) -> _There:
        there = Tensor._make_wrapper_subclass(  # pyright: ignore[reportAttributeAccessIssue]
            cls,
            held.shape,
            strides=held.stride(),
            storage_offset=held.storage_offset(),
            dtype=held.dtype,
            device="lazy:0",
            requires_grad=held.requires_grad,
        )
        there.held = held
        return there

    def __repr__(self, *, tensor_contents: object = None) -> str:
        return f"there({self.held!r})"

    def tolist(self) -> Any:
        return self.held.tolist()

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _run(func, args, kwargs or {})


def _run(func: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    flat, _ = tree_flatten((args, kwargs))
    there = [t for t in flat if isinstance(t, _There)]
    name = func.overloadpacket.__name__
    if there and name not in _MIXED:
        here = [t for t in flat if isinstance(t, Tensor) and not isinstance(t, _There) and t.dim() > 0]
        if here:
            raise RuntimeError(
                f"Expected all tensors to be on the same device, but found at least two devices, lazy:0 and cpu! ({name})"
            )
    device = kwargs.get("device")
    kept = {id(t.held): t for t in there}
    if device is not None and torch.device(device).type == "lazy":
        kwargs = {**kwargs, "device": torch.device("cpu")}
    kwargs = {k: v for k, v in kwargs.items() if k != "pin_memory"}
    args, kwargs = tree_map(lambda t: t.held if isinstance(t, _There) else t, (args, kwargs))
    found = func(*args, **kwargs)
    on_device = torch.device(device).type == "lazy" if device is not None else bool(there)
    if name == "copy_":
        on_device = id(found) in kept

    def placed(t: Any) -> Any:
        if not isinstance(t, Tensor) or not on_device:
            return t
        # what is changed in place stays the tensor that it was
        return kept[id(t)] if id(t) in kept else _There(t)

    return tree_map(placed, found)


class _Factories(TorchFunctionMode):
    """What does not dispatch is made here and placed there, `torch.tensor` and lists as indices."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        if func in (torch.tensor, torch.as_tensor) and kwargs.get("device") is not None:
            return func(*args, **{**kwargs, "device": None}).to(kwargs["device"])
        if func is Tensor.__getitem__:
            index = args[1] if isinstance(args[1], tuple) else (args[1],)
            args = args[0], tuple(torch.tensor(i) if isinstance(i, list) else i for i in index)
        return func(*args, **kwargs)


class _Operations(TorchDispatchMode):
    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _run(func, args, kwargs or {})


@contextmanager
def pretended() -> Iterator[str]:
    """While it is on, tensors of the device whose name it yields are the pretended device's."""
    with _Operations(), _Factories():
        yield "lazy"
