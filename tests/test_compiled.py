"""The compiled graph of the shared lattice: the same picture as eager blocks, the same bits again, and what happens where it cannot be."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.compiling import Compiled, NotCompiled
from torch_mcaa.estimators import Task

pytestmark = pytest.mark.skipif(shutil.which(os.environ.get("CXX", "g++")) is None, reason="the compiler needs a C++ compiler")
SIZE = (75, 90)


def disc(x: Tensor, y: Tensor) -> Tensor:
    return (torch.hypot(x - 40.3, y - 30.8) < 20).float()


def three(x: Tensor, y: Tensor) -> tuple[Tensor, ...]:
    return torch.sin(0.3 * x), 30 * (torch.hypot(x - 40.3, y - 30.8) < 20), torch.cos(0.1 * y * x)


class Disc(torch.nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.radius = torch.nn.Parameter(torch.tensor(20.0))

    def forward(self, x: Tensor, y: Tensor) -> Tensor:
        return (self.radius - torch.hypot(x - 40.3, y - 30.8)).sigmoid()


TEXTURE = mcaa.Texture(torch.rand(3, 40, 50, generator=torch.Generator().manual_seed(1)), interpolation="nearest")
CASES: list[tuple[str, Callable[..., object], dict[str, object]]] = [
    ("disc", disc, {}),
    ("one evaluation", disc, {"spp": 1}),
    ("64 evaluations", disc, {"spp": 64}),
    ("three channels", three, {"seed": 5}),
    ("float64", three, {"dtype": torch.float64, "filter": mcaa.Mitchell(1 / 3, 1 / 3)}),
    ("box", disc, {"filter": mcaa.Box()}),
    ("lanczos", three, {"filter": mcaa.Lanczos(3), "spp": 7}),
    ("extent", disc, {"extent": (10.0, 100.0, 50.0, 0.0)}),
    ("far away", lambda x, y: torch.sin(0.25 * (x - 1e6)), {"extent": (1e6, 1e6 + 90, 0.0, 75.0)}),
    ("module", Disc(), {}),
    ("texture", TEXTURE, {}),
]


def both(f: Callable[..., object], **arguments: object) -> tuple[mcaa.Rendering, mcaa.Rendering]:
    return tuple(
        mcaa.render(f, SIZE, estimator=mcaa.Shared(), compile=compile, **arguments)  # pyright: ignore[reportArgumentType]
        for compile in (True, False)
    )


@pytest.mark.parametrize(("f", "arguments"), [c[1:] for c in CASES], ids=[c[0] for c in CASES])
def test_same_picture_as_eager(f: Callable[..., object], arguments: dict[str, object]) -> None:
    compiled, eager = both(f, **arguments)
    scale = float(eager.image.abs().max())
    # sums of up to some hundreds of terms in another order: measured at most 6 roundings of the largest value
    tolerance = 32 * torch.finfo(eager.image.dtype).eps * scale
    torch.testing.assert_close(compiled.image, eager.image, rtol=0, atol=tolerance)
    torch.testing.assert_close(compiled.stderr, eager.stderr, rtol=1e-3, atol=tolerance)
    assert torch.equal(compiled.spp, eager.spp)
    assert compiled.evaluations >= compiled.spp.sum()


def test_what_is_not_finite_is_left_to_eager_blocks() -> None:
    def hole(x: Tensor, y: Tensor) -> Tensor:
        return torch.where(x * x + y * y < 100, torch.nan, x)

    with pytest.raises(mcaa.McaaError, match=r"f returned nan at x = ") as raised:
        both(hole)
    assert "channel 0" in str(raised.value)
    compiled, eager = both(hole, nonfinite="ignore")
    assert int(compiled.invalid.sum()) > 0
    assert torch.equal(compiled.invalid, eager.invalid)
    torch.testing.assert_close(compiled.image, eager.image, rtol=0, atol=0, equal_nan=True)


def test_poles_and_dual_tones_are_seen() -> None:
    def pole(x: Tensor, y: Tensor) -> Tensor:
        return ((x - 40.3) ** 2 + (y - 30.8) ** 2) ** -0.75

    with pytest.warns(mcaa.McaaWarning, match="no second moment"):
        compiled, eager = both(pole)
    assert bool(compiled.stderr.isinf().any()) and torch.equal(compiled.stderr.isinf(), eager.stderr.isinf())

    from torch_mcaa.patterns.lattice import Lattice

    basis = Lattice().strip(16, 0, True, (0.0, 0.0)).basis
    (a, b), (c, d) = basis.tolist()
    # k . p is whole for all p of the lattice
    k = d / (a * d - b * c), -c / (a * d - b * c)
    compiled, eager = both(lambda x, y: torch.cos(2 * torch.pi * (k[0] * x + k[1] * y)))
    assert float(eager.stderr.median()) > 0.05
    torch.testing.assert_close(compiled.stderr, eager.stderr, rtol=0.05, atol=0)


def test_same_bits_for_every_number_of_threads_and_again() -> None:
    before, pictures = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 2):
            torch.set_num_threads(threads)
            pictures.append(mcaa.render(three, (130, 270), estimator=mcaa.Shared(), compile=True))
    finally:
        torch.set_num_threads(before)
    for other in pictures[1:]:
        assert torch.equal(other.image, pictures[0].image) and torch.equal(other.stderr, pictures[0].stderr)


def test_one_compilation_serves_a_picture_its_edges_and_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    compilations: list[object] = []

    def counting(graph: torch.fx.GraphModule, inputs: list[Tensor]) -> Callable[..., object]:
        compilations.append(graph)
        return graph.forward

    real = torch.compile
    monkeypatch.setattr(torch, "compile", lambda f, **options: real(f, backend=counting, **options))
    radius = torch.tensor(200.0)

    def f(x: Tensor, y: Tensor) -> Tensor:
        return (torch.hypot(x - 200, y - 500) < radius).float()

    first = mcaa.render(f, (610, 900), estimator=mcaa.Shared(), compile=True)
    assert len(compilations) == 1
    radius.mul_(2)
    second = mcaa.render(f, (610, 900), estimator=mcaa.Shared(), compile=True, seed=9)
    assert len(compilations) == 1
    assert float(second.image.sum()) > 2 * float(first.image.sum())


def test_an_f_without_a_hash() -> None:
    class Unhashable:
        __hash__ = None  # pyright: ignore[reportAssignmentType]

        def __call__(self, x: Tensor, y: Tensor) -> Tensor:
            return x * y

    compiled, eager = both(Unhashable())
    torch.testing.assert_close(compiled.image, eager.image, rtol=1e-5, atol=0)


class TestRefused:
    @pytest.mark.parametrize(
        "f",
        [
            lambda x, y: x if (y * 0).sum() == 0 else y,
            lambda x, y: torch.from_numpy((x * 0).numpy().copy()) if not torch.compiler.is_compiling() else x.nonsense,
        ],
        ids=["graph break", "not while compiling"],
    )
    def test_runs_eagerly_with_one_warning(self, f: Callable[[Tensor, Tensor], Tensor]) -> None:
        eager = mcaa.render(f, SIZE, estimator=mcaa.Shared(), compile=False)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            picture = mcaa.render(f, SIZE, estimator=mcaa.Shared(), compile=True)
        assert [w.category for w in caught] == [mcaa.McaaWarning]
        assert "f was not compiled and ran eagerly: " in str(caught[0].message)
        assert torch.equal(picture.image, eager.image) and torch.equal(picture.stderr, eager.stderr)

    def test_its_own_error_is_told(self) -> None:
        def f(x: Tensor, y: Tensor) -> Tensor:
            raise ValueError("no light")

        with pytest.raises(mcaa.McaaError, match="f raised ValueError: no light"):
            mcaa.render(f, SIZE, estimator=mcaa.Shared(), compile=True)

    def test_a_wrong_shape_is_told(self) -> None:
        with pytest.raises(mcaa.McaaError, match="f must return a tensor of its input's shape"):
            mcaa.render(lambda x, y: x.sum(), SIZE, estimator=mcaa.Shared(), compile=True)

    def test_an_endless_compilation_is_stopped(self) -> None:
        def endless(x: Tensor) -> Tensor:
            for _ in range(10**9):
                x = x * 1.000001
            return x

        begin = time.monotonic()
        with pytest.raises(NotCompiled, match="it took longer than 3 s"):
            Compiled(endless, limit=3.0)(torch.ones(4))
        assert time.monotonic() - begin < 20
        for thread in threading.enumerate():
            if thread.name == "compilation":
                thread.join(30)
                assert not thread.is_alive()

    def test_more_functions_than_the_compiler_keeps_for_one_code(self) -> None:
        def kernel(factor: float) -> Callable[[Tensor], Tensor]:
            return lambda x: x * factor

        for factor in range(12):
            doubled = Compiled(kernel(float(factor)))(torch.ones(3))  # pyright: ignore[reportArgumentType]
            assert doubled.tolist() == [factor] * 3


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"compile": "yes"}, "compile must be 'auto', True or False, got 'yes'"),
        (
            {"compile": True, "estimator": mcaa.Auto()},
            r"compile=True cannot be done: Auto\(.*\) has no graph .* take Shared\(Lattice\(\)\)",
        ),
        ({"compile": True, "estimator": mcaa.Shared(mcaa.Sobol())}, "has no graph"),
        ({"compile": True, "estimator": mcaa.Shared(replicates=2)}, "has no graph"),
        ({"compile": True, "tolerance": 0.1}, "leave out tolerance and seconds"),
        ({"compile": True, "boundary": "zero"}, "needs boundary='extend', got 'zero'"),
        ({"compile": True, "filter": mcaa.Sinc(), "boundary": "zero"}, "needs boundary='extend', got 'zero'"),
    ],
)
def test_what_cannot_be_compiled_is_refused(arguments: dict[str, object], words: str) -> None:
    with pytest.raises(mcaa.McaaError, match=words):
        mcaa.render(disc, SIZE, **{"estimator": mcaa.Shared(), **arguments})  # pyright: ignore[reportArgumentType]


@pytest.fixture
def decided(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Whether each picture is to be compiled, without rendering it."""
    seen: list[bool] = []

    def check(self: mcaa.Shared, task: Task, spp: int, adaptive: bool) -> tuple[int, int]:
        seen.append(task.compiled)
        raise InterruptedError

    monkeypatch.setattr(mcaa.Shared, "cell", check)
    return seen


@pytest.mark.parametrize(
    ("size", "spp", "compiled"), [((8192, 8192), 16, True), ((8192, 8191), 16, False), ((512, 512), 16, False)]
)
def test_auto_decides_by_size_and_spp(decided: list[bool], size: tuple[int, int], spp: int, compiled: bool) -> None:
    for arguments in ({}, {"compile": False}, {"tolerance": 0.1}, {"boundary": "renormalize"}):
        with pytest.raises(InterruptedError):
            mcaa.render(disc, size, estimator=mcaa.Shared(), spp=spp, **arguments)
    assert decided == [compiled, False, False, False]


def test_a_small_picture_imports_no_compiler() -> None:
    code = (
        "import sys, torch_mcaa as mcaa; mcaa.render(lambda x, y: x, (32, 32), estimator=mcaa.Shared()); "
        "print('torch._dynamo' in sys.modules, 'torch._inductor' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]
