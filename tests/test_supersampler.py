"""The layer: what it returns, what its gradients are equal to, and how it lives with the rest of PyTorch."""

from __future__ import annotations

import copy
import io
import pickle
import time
import warnings
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.autograd import forward_ad
from torch.utils.checkpoint import checkpoint

import torch_mcaa as mcaa
from torch_mcaa import scenes
from torch_mcaa.errors import McaaError, McaaWarning
from torch_mcaa.filters import Filter

SIZE = 5, 6
EXACT: dict[str, Any] = {"estimator": mcaa.Shared(), "redraw": False, "decorrelate": False}
CENTRES = torch.meshgrid(torch.arange(24) + 0.5, torch.arange(24) + 0.5, indexing="xy")


def weights(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def waves(p: Tensor) -> Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]:
    return lambda x, y: (torch.sin(p[0] * x / 2 + p[1] * y), p[2] * torch.cos(0.3 * x * p[0]))


def _step(x: Tensor, edge: Tensor) -> Tensor:
    return (x < edge).to(torch.float32)


def _floored(d: Tensor) -> Tensor:
    d = d / 40
    d //= 1
    return d + 1


STEPS: dict[str, Callable[[Tensor], Tensor]] = {
    "heaviside": lambda d: torch.heaviside(d, torch.ones(())),
    "heaviside_": lambda d: d.heaviside_(torch.ones(())),
    "//": lambda d: d // 40 + 1,
    "//=": _floored,
    "number //": lambda d: 5 // (5 - d / 20),
    "floor_divide": lambda d: torch.floor_divide(d, other=40) + 1,
    "floor_divide_": lambda d: d.floor_divide_(40) + 1,
}


class Net(torch.nn.Module):
    """A small coordinate network of three channels."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = torch.nn.Sequential(torch.nn.Linear(2, 8), torch.nn.Tanh(), torch.nn.Linear(8, 3))
        generator = torch.Generator().manual_seed(2)
        for parameter in self.parameters():
            torch.nn.init.normal_(parameter, generator=generator)

    def forward(self, x: Tensor, y: Tensor) -> Tensor:
        return self.layers(torch.stack([x, y], -1) / 8).movedim(-1, 0)


def gradients(loss: Tensor, net: torch.nn.Module) -> list[Tensor]:
    return list(torch.autograd.grad(loss, list(net.parameters())))


def same(a: list[Tensor], b: list[Tensor]) -> bool:
    return all(torch.equal(x, y) for x, y in zip(a, b, strict=True))


class TestValues:
    def test_calls_are_renderings_with_one_seed_after_the_other(self) -> None:
        layer = mcaa.Supersampler(SIZE, seed=4)
        f = scenes.Disc(3, 2, 1.5)
        for call in range(3):
            assert torch.equal(layer(f), mcaa.render(f, SIZE, seed=4 + call, progress=False).image)
        assert torch.equal(layer(f, call=1), mcaa.render(f, SIZE, seed=5, progress=False).image)
        assert layer.calls == 3
        fixed = mcaa.Supersampler(SIZE, redraw=False)
        assert torch.equal(fixed(f), fixed(f))

    def test_textures_are_a_batch_of_pictures(self) -> None:
        textures = torch.rand(2, 3, 8, 9, generator=torch.Generator().manual_seed(1))
        layer = mcaa.Supersampler(SIZE, redraw=False)
        pictures = layer(textures)
        assert pictures.shape == (2, 3, *SIZE)
        each = torch.stack([mcaa.render(mcaa.Texture(t), SIZE, progress=False).image for t in textures])
        assert torch.equal(pictures, each)
        assert layer(textures.half()).dtype == torch.half and layer(textures.double()).dtype == torch.double

    def test_without_grad_mode_nothing_is_asked_for_a_gradient(self) -> None:
        asked = []

        def f(x: Tensor, y: Tensor) -> Tensor:
            asked.append(len(x))
            return weight * x

        weight = torch.ones((), requires_grad=True)
        layer = mcaa.Supersampler(SIZE, redraw=False)
        with torch.no_grad():
            assert not layer(f).requires_grad
        before = len(asked)
        assert layer(f).requires_grad and len(asked) > 2 * before


class TestGradients:
    @pytest.mark.parametrize("boundary", ["extend", "zero", "renormalize"])
    @pytest.mark.parametrize("filter", [mcaa.Gaussian(0.5), mcaa.Box(), mcaa.Lanczos(3)], ids=repr)
    def test_gradcheck(self, filter: Filter, boundary: Any) -> None:
        p = torch.tensor([0.7, 0.3, 1.1], dtype=torch.float64, requires_grad=True)
        layer = mcaa.Supersampler((3, 4), filter=filter, spp=5, boundary=boundary, **EXACT).double()
        assert torch.autograd.gradcheck(lambda p: layer(waves(p)), [p])

    def test_gradcheck_of_textures(self) -> None:
        textures = torch.rand(2, 1, 3, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(1)).requires_grad_()
        assert torch.autograd.gradcheck(mcaa.Supersampler((2, 3), spp=5, **EXACT), [textures])

    def test_modules_and_what_was_computed_before(self) -> None:
        """A network whose first weights are made by another one, against central differences of its own values."""
        net, code = Net().double(), torch.tensor([0.3, -0.8], dtype=torch.float64, requires_grad=True)
        layer = mcaa.Supersampler(SIZE, spp=8, **EXACT).double()
        grad = weights(3, *SIZE)

        def loss() -> Tensor:
            first = torch.tanh(code).repeat(8, 1)

            def f(x: Tensor, y: Tensor) -> Tensor:
                hidden = torch.tanh(torch.stack([x, y], -1) @ first.T / 8)
                return net.layers[2](hidden).movedim(-1, 0)

            return (layer(f) * grad).sum()

        loss().backward()
        for tensor in (code, net.layers[2].weight):
            assert tensor.grad is not None
            with torch.no_grad():
                h, flat = 1e-6, tensor.view(-1)
                for index in (0, 1):
                    flat[index] += h
                    ahead = loss()
                    flat[index] -= 2 * h
                    behind = loss()
                    flat[index] += h
                    # differences of sums of size 10 are good to 1e-8
                    torch.testing.assert_close(tensor.grad.view(-1)[index], (ahead - behind) / (2 * h), rtol=1e-6, atol=1e-7)

    def test_only_what_is_used_later_is_saved(self) -> None:
        """Memory does not grow with the samples: what autograd keeps is the picture and the parameters."""
        saved: list[int] = []

        def note(tensor: Tensor) -> Tensor:
            saved.append(tensor.numel())
            return tensor

        net = Net()
        for spp in (4, 64):
            saved.clear()
            with torch.autograd.graph.saved_tensors_hooks(note, lambda kept: kept):
                mcaa.Supersampler((16, 16), spp=spp)(net)
            assert sum(saved) == 3 * 16 * 16 + sum(p.numel() for p in net.parameters())

    def test_decorrelated_gradients_are_unbiased(self) -> None:
        """Of sum(phi^2) / 2 with f = a s, s of +-1 as good as random: a's derivative is sum(phi^2), about 0; that of the forward's own
        points has the variance of the estimate in it. 100 seeds, significance 1e-5 (4.4 standard errors).
        """
        a = torch.ones((), dtype=torch.float64, requires_grad=True)

        def f(x: Tensor, y: Tensor) -> Tensor:
            return a * torch.sign(torch.sin(43758.5453 * torch.sin(12.9898 * x + 78.233 * y)))

        def mean_and_error(decorrelate: bool) -> tuple[float, float]:
            layer = mcaa.Supersampler(
                (2, 2), estimator=mcaa.Shared(), spp=3, decorrelate=decorrelate, discontinuities=False
            ).double()
            found = torch.stack([torch.autograd.grad(layer(f).square().sum() / 2, a)[0] for _ in range(100)])
            return float(found.mean()), float(found.std()) / 10

        many = mcaa.Supersampler((2, 2), estimator=mcaa.Shared(), spp=4001, discontinuities=False).double()
        truth = float(many(f).detach().square().sum())
        mean, error = mean_and_error(True)
        assert abs(mean - truth) < 4.4 * error
        mean, error = mean_and_error(False)
        assert mean - truth > 2 * 4.4 * error

    def test_a_disc(self) -> None:
        """The closed form's derivative in the radius. The spread over 12 calls tells the error (7.3 of it: 1e-5 of Student's t)."""
        radius = torch.tensor(7.0, requires_grad=True)
        grad = weights(1, 24, 24)

        def exact(r: float) -> float:
            return float((scenes.Disc(12.3, 11.6, r).exact(*CENTRES, mcaa.Gaussian(0.5)) * grad[0]).sum())

        def f(x: Tensor, y: Tensor) -> Tensor:
            return (torch.hypot(x - 12.3, y - 11.6) < radius).to(x)

        layer = mcaa.Supersampler((24, 24), spp=32)
        found = torch.stack([torch.autograd.grad((layer(f) * grad).sum(), radius)[0] for _ in range(12)])
        truth = (exact(7.0005) - exact(6.9995)) / 1e-3
        assert float((found.mean() - truth).abs()) < 7.3 * float(found.std()) / 12**0.5
        assert float(found.std()) < 0.02 * float(grad.square().sum().sqrt())
        # the sum over the pixels is the area, whose derivative the lines give far better: each meets the disc in a chord
        (whole,) = torch.autograd.grad(layer(f).sum(), radius)
        assert abs(float(whole) / (2 * torch.pi * 7) - 1) < 0.01

    def test_a_slope_inside_f(self) -> None:
        """As for a normal: f differentiates by its own points. Of (x - c)^2 in x: 2 (x - c), whose derivative in c is -2."""
        centre = torch.tensor([3.0, 4.0], requires_grad=True)

        def f(x: Tensor, y: Tensor) -> Tensor:
            with torch.enable_grad():
                places = torch.stack([x, y], -1).requires_grad_()
                distance = (places - centre).square().sum(-1)
                (slope,) = torch.autograd.grad(distance.sum(), places, create_graph=True)
            return slope[..., 0]

        mcaa.Supersampler(SIZE, estimator=mcaa.Shared())(f).sum().backward()
        assert centre.grad is not None
        torch.testing.assert_close(centre.grad, torch.tensor([-2.0 * SIZE[0] * SIZE[1], 0.0]), rtol=1e-4, atol=1e-4)

    @pytest.mark.parametrize("name", STEPS)
    def test_steps_whose_slope_autograd_does_not_know(self, name: str) -> None:
        """That of the same step by a comparison, beside a smooth part."""
        found = []
        for step in (STEPS[name], lambda d: (d > 0).to(d)):
            radius = torch.tensor(5.0, requires_grad=True)

            def f(x: Tensor, y: Tensor, r: Tensor = radius, step: Callable[[Tensor], Tensor] = step) -> Tensor:
                return step(r - torch.hypot(x - 8.2, y - 8)) + torch.sin(r * x / 9)

            layer = mcaa.Supersampler((16, 16), estimator=mcaa.Shared())
            layer(f).square().sum().backward()
            found.append(radius.grad)
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                mcaa.Supersampler((16, 16), discontinuities=False)(f).sum().backward()
        torch.testing.assert_close(*found, rtol=1e-3, atol=0)

    def test_what_pytorch_cannot_differentiate_is_named(self) -> None:
        p = torch.tensor(2.0, requires_grad=True)
        picture = mcaa.Supersampler(SIZE)(lambda x, y: torch.special.zeta(p + x.abs(), y.abs() + 1))
        with pytest.raises(McaaError, match="cannot differentiate.*zeta.*detached"):
            picture.sum().backward()

    def test_second_derivatives_are_refused(self) -> None:
        p = torch.tensor([0.7, 0.3, 1.1], requires_grad=True)
        (first,) = torch.autograd.grad(mcaa.Supersampler(SIZE)(waves(p)).sum(), p, create_graph=True)
        with pytest.raises(McaaError, match="second derivatives"):
            first.sum().backward()

    def test_parameters_changed_before_the_backward_pass(self) -> None:
        p = torch.tensor([0.7, 0.3, 1.1], requires_grad=True)
        loss = mcaa.Supersampler(SIZE)(waves(p)).sum()
        with torch.no_grad():
            p += 1
        with pytest.raises(RuntimeError, match="modified by an inplace operation"):
            loss.backward()


def test_a_layer_of_many_samples_is_made_at_once() -> None:
    began = time.perf_counter()
    mcaa.Supersampler((8, 8), spp=10**9)
    assert time.perf_counter() - began < 20


def test_batches_of_gradients_are_refused_in_words() -> None:
    radius = torch.tensor(3.0, requires_grad=True)
    picture = mcaa.Supersampler((8, 8), spp=4)(lambda x, y: (torch.hypot(x - 4, y - 4) < radius).to(x))
    batch = torch.ones(2, *picture.shape)

    def one(grad: Tensor) -> Tensor:
        return torch.autograd.grad(picture, [radius], grad, retain_graph=True)[0]

    with pytest.raises(McaaError, match="one gradient at a time"):
        torch.autograd.grad(picture, [radius], batch, retain_graph=True, is_grads_batched=True)
    with pytest.raises(McaaError, match="one gradient at a time"):
        torch.func.vmap(one)(batch)
    assert one(batch[0]) > 0


class TestPyTorch:
    def test_state_dict_copies_and_pickles_go_on_where_they_were(self) -> None:
        layer = mcaa.Supersampler(SIZE, filter=mcaa.Gaussian(torch.nn.Parameter(torch.tensor(0.6))))
        f = scenes.Disc(3, 2, 1.5)
        layer(f)
        loaded = mcaa.Supersampler(SIZE, filter=mcaa.Gaussian(torch.nn.Parameter(torch.tensor(0.4))))
        stream = io.BytesIO()
        torch.save(layer.state_dict(), stream)
        stream.seek(0)
        loaded.load_state_dict(torch.load(stream, weights_only=True))
        copies = [loaded, copy.deepcopy(layer), pickle.loads(pickle.dumps(layer))]
        expected = layer(f)
        for other in copies:
            assert other.calls == 1 and torch.equal(other(f), expected)
            (parameter,) = other.parameters()
            # the filter's own tensor, not another one of its value
            assert parameter is not next(layer.parameters()) and parameter is other.filter.learned[0]

    @pytest.mark.parametrize("default", [torch.bfloat16, torch.float16, torch.float64])
    def test_made_under_another_default_dtype(self, default: torch.dtype) -> None:
        weight, before = torch.tensor(2.0, requires_grad=True), torch.get_default_dtype()
        try:
            torch.set_default_dtype(default)
            layer = mcaa.Supersampler(SIZE, redraw=False)
            picture = layer(lambda x, y: weight * torch.hypot(x - 2, y - 3) + (x < 1 + weight))
            picture.sum().backward()
        finally:
            torch.set_default_dtype(before)
        assert picture.dtype == (torch.float64 if default == torch.float64 else torch.float32)
        again = torch.tensor(2.0, requires_grad=True)
        mcaa.Supersampler(SIZE, redraw=False)(lambda x, y: again * torch.hypot(x - 2, y - 3) + (x < 1 + again)).sum().backward()
        torch.testing.assert_close(weight.grad, again.grad, rtol=1e-3, atol=0)

    def test_moved_to_another_dtype(self) -> None:
        layer = mcaa.Supersampler(SIZE)
        assert layer(scenes.Disc(3, 2, 1.5)).dtype == torch.float32
        assert layer.double()(scenes.Disc(3, 2, 1.5)).dtype == torch.float64
        with pytest.raises(McaaError, match="dtype"):
            layer.half()(scenes.Disc(3, 2, 1.5))

    @pytest.mark.parametrize("reentrant", [False, True])
    def test_checkpoint(self, reentrant: bool) -> None:
        net, scale = Net(), torch.ones((), requires_grad=True)

        def loss(layer: mcaa.Supersampler, wrap: Callable[..., Tensor]) -> Tensor:
            return wrap(lambda s: (s * layer(net)).square(), scale).sum()

        plain, wrapped = mcaa.Supersampler(SIZE), mcaa.Supersampler(SIZE)
        for _ in range(2):
            for p in net.parameters():
                p.grad = None
            expected = loss(plain, lambda f, s: f(s))
            expected.backward()
            grads = [p.grad for p in net.parameters()]
            for p in net.parameters():
                p.grad = None
            found = loss(wrapped, lambda f, s: checkpoint(f, s, use_reentrant=reentrant))  # type: ignore[return-value]
            found.backward()
            assert torch.equal(found, expected)
            assert all(torch.equal(a, p.grad) for a, p in zip(grads, net.parameters(), strict=True))  # type: ignore[arg-type]
        assert plain.calls == wrapped.calls == 2

    def test_checkpoint_of_several_calls_wants_their_numbers(self) -> None:
        net, layer = Net(), mcaa.Supersampler(SIZE)
        twice = [checkpoint(lambda: layer(net).square(), use_reentrant=False) for _ in range(2)]
        with pytest.warns(McaaWarning, match="which call is meant"):
            (twice[0] + twice[1]).sum().backward()  # type: ignore[operator]
        told = [checkpoint(lambda call: layer(net, call).square(), call, use_reentrant=False) for call in (5, 6)]
        plain = [layer(net, call).square() for call in (5, 6)]
        for a, b in zip(gradients(sum(told).sum(), net), gradients(sum(plain).sum(), net), strict=True):  # type: ignore[union-attr]
            assert torch.equal(a, b)

    def test_autocast(self) -> None:
        """f runs under it, the sums do not; the backward pass has f as the forward pass had it."""
        net, layer, seen = Net(), mcaa.Supersampler(SIZE, spp=8, **EXACT), set()
        net.layers[0].register_forward_hook(lambda module, args, out: seen.add(out.dtype))
        grad = weights(3, *SIZE).float()
        with torch.autocast("cpu", torch.bfloat16):
            picture = layer(net)
            assert picture.dtype == torch.float32
        assert torch.equal(layer(lambda x, y: (x < 3).float()), layer(lambda x, y: (x < 3).float()))
        # decisions are looked for in full precision
        assert torch.bfloat16 in seen
        seen.clear()
        found = gradients((picture * grad).sum(), net)
        assert seen == {torch.bfloat16}
        seen.clear()
        for a, b in zip(found, gradients((layer(net) * grad).sum(), net), strict=True):
            # of 8 bits, over some 200 samples
            torch.testing.assert_close(a, b, rtol=0.03, atol=0.03 * float(b.abs().max()))
        assert seen == {torch.float32}

    @pytest.mark.parametrize("estimator", [mcaa.Auto(), mcaa.Shared()])
    def test_autocast_of_decisions(self, estimator: Any) -> None:
        """Where f jumps is found in full precision: half of it takes a straight edge for stairs."""
        net = torch.nn.Linear(2, 1)
        with torch.no_grad():
            net.weight.copy_(torch.tensor([[0.8, 0.6]]))
            net.bias.fill_(-12.0)
        layer = mcaa.Supersampler((16, 16), estimator=estimator)
        with torch.autocast("cpu", torch.bfloat16):
            picture = layer(lambda x, y: (net(torch.stack([x, y], -1))[..., 0] > 0).float())
        (bias,) = torch.autograd.grad(picture.sum(), net.bias)
        # the edge 0.8 x + 0.6 y = 12 is 20 px long on the screen, and 1 of bias moves it by 1 px; corners cut it a little
        assert float(bias) == pytest.approx(20, rel=0.005)

    def test_autocast_that_f_needs_is_said(self) -> None:
        net = torch.nn.Linear(2, 1).bfloat16()

        def f(x: Tensor, y: Tensor) -> Tensor:
            return (net(torch.stack([x, y], -1))[..., 0] > 0).float()

        with torch.autocast("cpu", torch.bfloat16), pytest.warns(McaaWarning, match="under autocast alone"):
            mcaa.Supersampler((8, 8), estimator=mcaa.Shared())(f)

    def test_a_checkpoint_inside_f(self) -> None:
        radius = torch.tensor(3.0, requires_grad=True)

        def inner(x: Tensor, y: Tensor) -> Tensor:
            return torch.where(torch.hypot(x - 4, y - 4) < radius, x * radius, 0.1)

        picture = mcaa.Supersampler((8, 8))(lambda x, y: checkpoint(inner, x, y, use_reentrant=False))
        with pytest.raises(McaaError, match=r"uses torch.utils.checkpoint inside.*leave it out"):
            picture.sum().backward()

    def test_warnings_are_at_the_line_that_called(self) -> None:
        """Forward and backward, and as a module's call, whose frames are PyTorch's."""
        radius = torch.tensor(3.0, requires_grad=True)
        with pytest.warns(McaaWarning, match="numpy") as said:
            picture = mcaa.Supersampler((8, 8))(lambda x, y: radius * torch.from_numpy((x.detach().numpy() > 3).astype("float32")))
        with pytest.warns(McaaWarning, match="f is random") as random:
            mcaa.render(lambda x, y: torch.rand_like(x), (16, 16))
        late = mcaa.Supersampler((8, 8), estimator=mcaa.Shared())(lambda x, y: (torch.hypot(x - 99, y) < radius).float())
        with pytest.warns(McaaWarning, match="no gradient reaches") as behind:
            late.sum().backward()
        for warning in (*said, *random, *behind):
            assert warning.filename == __file__
        assert picture.shape == (1, 8, 8)

    def test_made_inside_a_transform(self) -> None:
        with pytest.raises(McaaError, match="make it outside"):
            torch.func.grad(lambda p: mcaa.Supersampler((8, 8))(lambda x, y: x * p).sum())(torch.tensor(4.0))

    @pytest.mark.filterwarnings("ignore:The .grad attribute:UserWarning")
    def test_compile(self) -> None:
        """The layer is left out of compiled code; what is around it is compiled."""
        net, layer = Net(), mcaa.Supersampler(SIZE)

        def loss(factor: Tensor) -> Tensor:
            return (factor * layer(net)).square().mean()

        compiled = torch.compile(loss, backend="eager")
        for call in range(3):
            layer.calls = call
            expected = loss(torch.tensor(2.0))
            layer.calls = call
            found = compiled(torch.tensor(2.0))
            assert torch.equal(found, expected) and same(gradients(found, net), gradients(expected, net))

    def test_nothing_global_changes(self) -> None:
        net = Net()
        before = torch.get_rng_state(), torch.get_default_dtype(), list(warnings.filters)
        mcaa.Supersampler(SIZE)(net).sum().backward()
        after = torch.get_rng_state(), torch.get_default_dtype(), list(warnings.filters)
        assert torch.equal(before[0], after[0]) and before[1:] == after[1:]


class TestBadInput:
    @pytest.mark.parametrize(
        ("arguments", "said"),
        [
            ({"size": (0, 4)}, "at least one pixel"),
            ({"size": (4, 4), "spp": 0}, "spp must be"),
            ({"size": (4, 4), "boundary": "wrap"}, "boundary must be"),
            ({"size": (4, 4), "discontinuities": True}, "discontinuities must be"),
            ({"size": (4, 4), "redraw": 1}, "redraw must be"),
            ({"size": (4, 4), "seed": -1}, "seed must be"),
            ({"size": (4, 4), "extent": torch.zeros(4)}, "x0 != x1"),
            ({"size": (4, 4), "filter": "box"}, "filter must be"),
            ({"size": (4, 4), "estimator": mcaa.Importance, "spp": 4}, "estimator must be"),
        ],
    )
    def test_arguments(self, arguments: dict[str, Any], said: str) -> None:
        with pytest.raises(McaaError, match=said):
            mcaa.Supersampler(**arguments)

    def test_inputs(self) -> None:
        layer = mcaa.Supersampler(SIZE)
        for textures in (torch.rand(3, 8, 8), torch.zeros(1, 1, 8, 8, dtype=torch.uint8), torch.rand(0, 3, 8, 8)):
            with pytest.raises(McaaError, match=r"\(B, C, h, w\)"):
                layer(textures)
        with pytest.raises(McaaError, match="call must be"):
            layer(Net(), call=-1)
        with pytest.raises(McaaError, match=r"pictures are on cpu, f's parameter layers.0.weight on meta"):
            layer(Net().to("meta"))
        elsewhere = torch.tensor(3.0, device="meta", requires_grad=True)
        with pytest.raises(McaaError, match=r"pictures are on cpu, and f uses a tensor of shape \(\) on meta; move one"):
            layer(lambda x, y: x * elsewhere)
        with pytest.raises(McaaError, match="dense floating tensor.*on meta, where there are no values"):
            layer(torch.zeros(1, 1, 4, 4, device="meta"))
        for textures in (
            torch.nested.nested_tensor([torch.zeros(1, 4, 4)], layout=torch.jagged),
            torch.zeros(1, 1, 4, 4).to_sparse(),
        ):
            with pytest.raises(McaaError, match="dense floating tensor.*, got a (nested tensor|.*layout torch.sparse_coo)"):
                layer(textures)

    def test_values_from_code_that_nobody_sees_are_no_silent_zero(self) -> None:
        radius = torch.tensor(3.0, requires_grad=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            step: Callable[..., Tensor] = torch.jit.script(_step)
        layer = mcaa.Supersampler((8, 8), estimator=mcaa.Shared())
        with pytest.warns(McaaWarning, match=r"test_supersampler.py:\d+: .* the trace cannot see .* the picture gets no gradient"):
            assert not layer(lambda x, y: step(x, radius)).requires_grad
        with warnings.catch_warnings(), torch.no_grad():
            warnings.simplefilter("error")
            layer(lambda x, y: step(x, radius))

    def test_transforms_of_functions_are_refused(self) -> None:
        layer = mcaa.Supersampler(SIZE)

        def loss(p: Tensor) -> Tensor:
            return layer(lambda x, y: p * x).sum()

        def dual(p: Tensor) -> Tensor:
            with forward_ad.dual_level():
                return loss(forward_ad.make_dual(p, p))

        p = torch.tensor(2.0)
        for transformed in (
            torch.func.grad(loss),
            lambda p: torch.func.jvp(loss, (p,), (p,)),
            lambda p: torch.func.vmap(loss)(p.expand(3)),
            torch.func.jacrev(loss),
            dual,
        ):
            # PyTorch scripts its own derivatives at the first jvp, and deprecates that
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", FutureWarning)
                with pytest.raises(McaaError, match=r"torch.autograd: loss.backward\(\)"):
                    transformed(p)
        with pytest.raises(McaaError, match="backward pass of its own"):
            torch.func.grad(lambda t: layer(t).sum())(torch.rand(1, 1, 4, 4))
        loss(p.requires_grad_()).backward()

    def test_a_module_that_ignores_its_parameters(self) -> None:
        class Ignores(Net):
            def forward(self, x: Tensor, y: Tensor) -> Tensor:
                return torch.sin(x + y)

        with pytest.warns(McaaWarning, match="none of its 4 parameters"):
            assert not mcaa.Supersampler(SIZE)(Ignores()).requires_grad

    def test_jumps_without_discontinuities(self) -> None:
        radius = torch.tensor(2.0, requires_grad=True)

        def f(x: Tensor, y: Tensor) -> Tensor:
            return (torch.hypot(x - 3, y - 2) < radius).to(x)

        layer = mcaa.Supersampler(SIZE, discontinuities=False)
        with pytest.warns(McaaWarning, match="no gradient to the tensors"):
            picture = layer(f)
        with pytest.warns(McaaWarning, match="no gradient reaches"):
            picture.sum().backward()
        assert radius.grad is None

    def test_a_loss_that_no_edge_reaches(self) -> None:
        radius = torch.tensor(2.0, requires_grad=True)
        picture = mcaa.Supersampler(SIZE)(lambda x, y: (torch.hypot(x - 300, y - 2) < radius).to(x))
        with pytest.warns(McaaWarning, match="no jump that moves was met where f was seen to decide; check_discontinuities"):
            picture.sum().backward()
        assert radius.grad is not None and float(radius.grad) == 0

    def test_statistics_of_a_module_in_training(self) -> None:
        norm, weight = torch.nn.BatchNorm1d(1), torch.tensor(2.0, requires_grad=True)
        layer = mcaa.Supersampler(SIZE, estimator=mcaa.Shared())

        def f(x: Tensor, y: Tensor) -> Tensor:
            return weight * norm(x[:, None])[:, 0]

        with pytest.warns(McaaWarning, match=r"BatchNorm's: call its eval\(\)"):
            layer(f)
        norm.eval()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            layer(f).sum().backward()

    def test_in_place_operations_and_numbers(self) -> None:
        weight = torch.ones((), requires_grad=True)
        layer = mcaa.Supersampler(SIZE)
        with pytest.raises(McaaError, match="in-place"):
            layer(lambda x, y: x * weight.mul_(2))
        with pytest.warns(McaaWarning, match="parameter's value out of PyTorch"):
            layer(lambda x, y: x * weight.item())


def test_a_change_in_place_that_spoils_a_derivative_is_said() -> None:
    """hypot's derivative needs its value, which -= has changed."""
    radius = torch.tensor(8.0, requires_grad=True)

    def f(x: Tensor, y: Tensor) -> Tensor:
        r = torch.hypot(x - 8, y - 8)
        r -= radius
        return (r < 0).to(x)

    layer = mcaa.Supersampler((16, 16), estimator=mcaa.Shared(), spp=32)
    with pytest.raises(mcaa.McaaError, match="in place"):
        layer(f).sum().backward()


def test_steep_ramps_are_looked_for_in_every_f_of_one_wrapper() -> None:
    """All run the wrapper's code, and the third is the first that has a ramp."""
    layer, edge = mcaa.Supersampler((32, 32), estimator=mcaa.Shared()), torch.tensor(10.0, requires_grad=True)

    def around(f: Any) -> Any:
        return lambda x, y: f(x, y)

    for f in (lambda x, y: (x > edge).to(x), lambda x, y: (y > edge).to(x)):
        layer(around(f)).sum().backward()
    with pytest.warns(mcaa.McaaWarning, match="changes by"):
        layer(around(lambda x, y: torch.nn.functional.normalize((x - edge)[:, None], dim=1)[:, 0])).sum().backward()


def test_a_sign_by_division_moves() -> None:
    edge = torch.tensor(20.2, requires_grad=True)
    layer = mcaa.Supersampler((64, 64), spp=64, estimator=mcaa.Shared())
    layer(lambda x, y: torch.sin(2 * x) + 0.1 * (x - edge) / (x - edge).abs()).sum().backward()
    assert edge.grad is not None and abs(float(edge.grad) + 0.2 * 64) < 0.2


@pytest.mark.parametrize("made", [mcaa.Supersampler((4, 4)), lambda f: mcaa.render(f, (4, 4)).image])
def test_a_picture_is_not_made_inside_an_f_that_is_followed(made: Any) -> None:
    edge = torch.tensor(2.0, requires_grad=True)

    def f(x: Tensor, y: Tensor) -> tuple[Tensor, ...]:
        return mcaa.Texture(made(lambda x, y: (x < edge).to(x)))(x, y)

    with pytest.raises(McaaError, match="made inside an f"):
        mcaa.Supersampler((8, 8))(f)
