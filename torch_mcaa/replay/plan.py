"""What the backward pass of a picture is to ask: found before the picture is made."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.errors import McaaError, warn
from torch_mcaa.estimators.base import Task
from torch_mcaa.integrand import Function
from torch_mcaa.replay.adjoint import reach_of
from torch_mcaa.replay.autocast import Autocast
from torch_mcaa.replay.bound import bound
from torch_mcaa.replay.dependencies import dependencies, unheard
from torch_mcaa.replay.gradients import Replay
from torch_mcaa.replay.moved import Moved, is_continuous
from torch_mcaa.replay.steep import steep
from torch_mcaa.replay.straight_through import straight_through
from torch_mcaa.replay.unchanged import Noted
from torch_mcaa.texture import Texture
from torch_mcaa.traced.followed import Followed
from torch_mcaa.traced.program import Program, probe

_PROBED = 256
_PROBE, _BACKWARD = 0x9806, 0xBAC4


def plan(
    task: Task, autocast: Autocast, spp: int, extent: Tensor | None, decorrelate: bool, discontinuities: bool, look: bool
) -> Replay:
    """The backward pass of the picture of `task`, whose f runs under `autocast`.

    extent: the tensor that the screen's extent is from, if it is to have a gradient. decorrelate: points of its own.
    discontinuities: jumps count too. look: for ramps that are jumps to all samples, and for slopes that f's values do not have.

    Warns (`McaaWarning`) where no gradient will reach what f uses, or a module's parameters.

    Raises:
        McaaError: see `Supersampler.forward`.
    """
    f, moved = _held(task, extent)
    exact = bound(f)
    task = replace(task, integrand=replace(task.integrand, function=autocast.of(exact)))
    col, row = task.screen.whole.places(_PROBED, task.seed, _PROBE)
    x, y = (t.to(task.device, task.dtype) for t in (task.screen.x_of(col), task.screen.y_of(row)))
    found = dependencies(task.integrand, x, y)
    if isinstance(f, torch.nn.Module):
        learned = {id(parameter) for parameter in f.parameters() if parameter.requires_grad}
        if learned and not learned & {id(tensor) for tensor in found.tensors}:
            warn(f"f uses none of its {len(learned)} parameters that require a gradient: they get none")
    program, deciding = None, task
    # a texture's values do not jump as its texels change, and its transform, if it is not one of its tensors here, is in `moved`
    if found.tensors and discontinuities and not (isinstance(f, Texture) and not _asks(f.transform)):
        deciding = _deciding(task, exact)
        program = _program(deciding)
        if look:
            for said in _looked(deciding, program, found.tensors, spp):
                warn(said)
    elif not found.tensors and discontinuities and not isinstance(f, Texture) and (hidden := _hidden(task)):
        warn(
            f"{hidden}; f uses no tensor that requires a gradient where that can be seen, and the picture gets no gradient from what it "
            "uses there: write it in PyTorch, or say by torch.no_grad() that none is wanted"
        )
    elif found.severed:
        warn(
            f"f turns a tensor that requires a gradient into a number by {', '.join(sorted(found.severed))}, and no gradient passes there; "
            "let f use the tensor itself"
        )
    elif found.tensors and not found.smooth:
        warn(
            "f's values have no gradient to the tensors that f uses, which decide between values at most: they get none; "
            "use discontinuities='auto'"
        )
    if decorrelate:
        high, low = (int(rng.bits(task.seed, _BACKWARD, half)) for half in (0, 1))
        task = replace(task, seed=high << 32 | low)
    noted = Noted.now(task.integrand.function, x, y, (*task.filter.learned, *moved.parameters))
    if noted.found is None:
        warn(
            "f is random, or changes something that it reads: asked twice for the same points it did not do the same, and the backward pass, "
            "which asks it again, differentiates something else than the picture"
        )
    function, decides = (found.apart(each.integrand.function) for each in (task, deciding))
    task = replace(task, integrand=replace(task.integrand, function=function))
    return Replay(task, spp, program if program and program.sites else None, decides, found, moved, noted)


def _deciding(task: Task, exact: Function) -> Task:
    """The task with the f whose jumps are located: in full precision, if f can do without the autocast of the forward pass."""
    if task.integrand.function is exact:
        return task
    other = replace(task, integrand=replace(task.integrand, function=exact))
    try:
        _probed(other, exact)
    except McaaError as error:
        warn(f"f runs under autocast alone, so that its decisions, and where it jumps, are as coarse as that: {error}")
        return task
    return other


def followed(task: Task, function: Function) -> Function:
    """`function`, that of the task, with its decisions, if it takes any and the trace can follow them all."""
    try:
        program = _probed(task, function)
    except McaaError:
        # who asks for a gradient is told why
        return function
    return Followed(function, program.all_moving()) if program.sites and not program.problems else function


def _probed(task: Task, function: Function) -> Program:
    with unheard():
        return probe(function, task.screen, task.dtype, task.device)


def _hidden(task: Task) -> str:
    """What the trace cannot follow of an f without tensors that require a gradient; empty if it can follow all."""
    try:
        return next(iter(_probed(task, task.integrand.function).problems), "")
    except McaaError:
        return ""


def _program(task: Task) -> Program:
    """f's decisions; of what the trace cannot follow there is a warning."""
    program = _probed(task, task.integrand.function)
    for problem in program.problems:
        warn(
            f"{problem}; jumps there count nothing towards the gradient: say where they are by level_set(g), or use discontinuities=False"
        )
    return program


def _looked(task: Task, program: Program, tensors: Sequence[Tensor], spp: int) -> list[str]:
    """What is found of f where it is not seen to decide."""
    with unheard(), torch.no_grad():
        ramps = "" if program.problems else steep(task, program, tensors, spp)
        return [said for said in (ramps, straight_through(task, program) if program.moves else "") if said]


def _asks(tensor: Tensor | None) -> bool:
    """Whether a tensor is to get a gradient."""
    return tensor is not None and tensor.requires_grad


def _held(task: Task, extent: Tensor | None) -> tuple[Function, Moved]:
    """f without parameters that say where it is asked, and those.

    A filter that ends in a step has no slope that could stand for their derivative: a transform is then one of f's own tensors.
    """
    f, transform, filter = task.integrand.function, None, task.filter
    smooth = is_continuous(filter)
    if extent is not None and not smooth:
        raise McaaError(
            f"a gradient with respect to the extent needs a filter that goes to 0 at its sides, got {filter}; take Tent()"
        )
    if isinstance(f, Texture) and f.transform is not None and _asks(f.transform) and smooth:
        transform, f = f.transform, copy.copy(f)
        f.transform = transform.detach()
    moved = Moved(task.screen, extent, transform)
    if moved.parameters:
        moved.check(task.boundary, reach_of(filter))
    return f, moved
