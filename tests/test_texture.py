"""Textures against grid_sample, against Python integers, and the closed-form pixel values against quadrature.

Unless a test says otherwise its tolerance is TIGHT: float64 coordinates of size 30 are known to 7e-15, times slopes of size 3, and
sums of a few hundred products of numbers of size 1 round to 1e-14.
"""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Sequence

import numpy as np
import pytest
import texture_truth
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.nn import functional

from torch_mcaa.errors import McaaError
from torch_mcaa.texture import Interpolation, Texture, Wrap

INTERPOLATIONS = ("nearest", "bilinear", "bicubic")
WRAPS = ("zeros", "border", "repeat", "mirror")
HEIGHT, WIDTH = 4, 7
TIGHT = {"rtol": 0, "atol": 1e-13}

every_interpolation = pytest.mark.parametrize("interpolation", INTERPOLATIONS)
every_wrap = pytest.mark.parametrize("wrap", WRAPS)


def picture(channels: int = 2, height: int = HEIGHT, width: int = WIDTH, dtype: torch.dtype = torch.float64) -> Tensor:
    return torch.rand(channels, height, width, dtype=dtype, generator=torch.Generator().manual_seed(5))


def scattered(n: int, low: float, high: float, seed: int = 3) -> tuple[Tensor, Tensor]:
    x, y = torch.rand(2, n, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) * (high - low) + low
    return x, y


def kernel(d: float, interpolation: Interpolation) -> float:
    """The weight of a texel whose centre is d texels away; bicubic: Keys (1981), eq. (15)."""
    d = abs(d)
    if interpolation == "bilinear":
        return max(0.0, 1 - d)
    if d <= 1:
        return 1.5 * d**3 - 2.5 * d**2 + 1
    return -0.5 * d**3 + 2.5 * d**2 - 4 * d + 2 if d < 2 else 0.0


def slow(image: Tensor, u: Sequence[float], v: Sequence[float], interpolation: Interpolation, wrap: Wrap) -> Tensor:
    """(C, n) values by Python's unbounded integers, one point and one texel at a time."""

    def taps(t: float, n: int) -> list[tuple[int, float]]:
        if interpolation == "nearest":
            all_taps = [(math.floor(t), 1.0)]
        else:
            near = math.floor(t - 0.5)
            all_taps = [(j, kernel((t - 0.5 - near) - (j - near), interpolation)) for j in range(near - 1, near + 3)]
        real = [(texture_truth.real_texel(j, n, wrap), weight) for j, weight in all_taps]
        return [(j, weight) for j, weight in real if j is not None]

    values = torch.zeros(image.shape[0], len(u), dtype=torch.float64)
    for k, (a, b) in enumerate(zip(u, v)):
        for i, down in taps(b, image.shape[1]):
            for j, across in taps(a, image.shape[2]):
                values[:, k] += down * across * image[:, i, j].double()
    return values


def normal(d: Tensor, std: float) -> Tensor:
    return torch.exp(-((d / std) ** 2) / 2) / (std * math.sqrt(2 * math.pi))


def sampled(image: Tensor, u: Tensor, v: Tensor, mode: str, wrap: Wrap) -> Tensor:
    """(C, n) values by grid_sample, whose -1 .. 1 spans the texture's outer edges when align_corners is False."""
    grid = torch.stack([2 * u / image.shape[2] - 1, 2 * v / image.shape[1] - 1], -1)[None, None]
    padding = {"zeros": "zeros", "border": "border", "mirror": "reflection"}[wrap]
    return functional.grid_sample(image[None], grid, mode=mode, padding_mode=padding, align_corners=False)[0, :, 0]


class TestValues:
    # "repeat" has no counterpart. On a texel's edge "nearest" differs by convention (round half to even): no point lies on one here
    @pytest.mark.parametrize("interpolation", ["nearest", "bilinear"])
    @pytest.mark.parametrize("wrap", ["zeros", "border", "mirror"])
    def test_agrees_with_grid_sample(self, interpolation: Interpolation, wrap: Wrap) -> None:
        image, (u, v) = picture(), scattered(2000, -20, 30)
        found = torch.stack(Texture(image, interpolation, wrap)(u, v))
        torch.testing.assert_close(found, sampled(image, u, v, interpolation, wrap), **TIGHT)

    @pytest.mark.parametrize("wrap", ["zeros", "border", "mirror"])
    def test_bicubic_agrees_with_grid_sample_along_a_row(self, wrap: Wrap) -> None:
        """grid_sample has a = -3/4. Weights are affine in a, and a = 0 blends two texels by 3f² - 2f³: -1/2 is 2/3 of the way."""
        image, (u, _) = picture(), scattered(2000, -20, 30)
        v = torch.full_like(u, 1.5)
        base = torch.floor(u - 0.5)
        f = u - 0.5 - base
        smooth = sampled(image, base + 0.5 + f * f * (3 - 2 * f), v, "bilinear", wrap)
        expected = smooth + 2 / 3 * (sampled(image, u, v, "bicubic", wrap) - smooth)
        torch.testing.assert_close(torch.stack(Texture(image, "bicubic", wrap)(u, v)), expected, **TIGHT)

    @every_interpolation
    @every_wrap
    @pytest.mark.parametrize("where", [0.0, -1e6, 1e6, 2.0**31 + 1, -3e12])
    def test_agrees_with_integers_everywhere(self, interpolation: Interpolation, wrap: Wrap, where: float) -> None:
        image, (u, v) = picture(), scattered(40, -12, 12)
        u, v = u + where, v - where
        found = torch.stack(Texture(image, interpolation, wrap)(u, v))
        torch.testing.assert_close(found, slow(image, u.tolist(), v.tolist(), interpolation, wrap), **TIGHT)

    @every_interpolation
    @every_wrap
    @pytest.mark.parametrize("where", [0.0, -1e6, 1e6])
    def test_float32_coordinates_mean_what_they_say(self, interpolation: Interpolation, wrap: Wrap, where: float) -> None:
        image, (u, v) = picture(), scattered(40, -12, 12)
        u, v = (u + where).float(), (v - where).float()
        found = torch.stack(Texture(image, interpolation, wrap)(u, v))
        # fractions near 0 lose 1/2's last bit in float32, nothing else: slopes of size 3, two axes
        torch.testing.assert_close(found, slow(image, u.tolist(), v.tolist(), interpolation, wrap), rtol=0, atol=1e-6)

    @every_wrap
    def test_nearest_at_the_end_of_float32(self, wrap: Wrap) -> None:
        image = picture()
        u = torch.tensor([3e38, -3e38, 1e30, -1e30, 2.0**63, -(2.0**63)])
        expected = slow(image, u.tolist(), u.tolist(), "nearest", wrap)
        torch.testing.assert_close(torch.stack(Texture(image, "nearest", wrap)(u, u)), expected, rtol=0, atol=0)

    @every_interpolation
    @pytest.mark.parametrize(("wrap", "periods"), [("repeat", 1), ("repeat", -3), ("mirror", 2), ("mirror", -6)])
    def test_periods(self, interpolation: Interpolation, wrap: Wrap, periods: int) -> None:
        texture = Texture(picture(), interpolation, wrap)
        u, v = ((t * 64).round() / 64 for t in scattered(500, -20, 30))  # dyadic, so that adding a period is exact
        for here, there in zip(texture(u, v), texture(u + periods * WIDTH, v - periods * HEIGHT)):
            assert torch.equal(here, there)

    @every_interpolation
    def test_mirror_is_even_about_every_edge(self, interpolation: Interpolation) -> None:
        texture = Texture(picture(), interpolation, "mirror")
        u, v = scattered(500, -20, 30)
        for here, there in zip(texture(u, v), texture(-u, 2 * HEIGHT - v)):
            torch.testing.assert_close(here, there, **TIGHT)

    @every_interpolation
    def test_zeros_is_zero_outside_the_reach(self, interpolation: Interpolation) -> None:
        reach = {"nearest": 0.0, "bilinear": 0.5, "bicubic": 1.5}[interpolation]
        texture = Texture(picture() + 1, interpolation, "zeros")
        inside = torch.tensor([1.0, 1.0], dtype=torch.float64)
        for n, point in ((WIDTH, lambda t: (t, inside)), (HEIGHT, lambda t: (inside, t))):
            outside = torch.tensor([-reach - 1e-9, n + reach], dtype=torch.float64)
            assert all(not channel.any() for channel in texture(*point(outside)))
            just_inside = torch.tensor([-reach + 1e-3, n + reach - 1e-3], dtype=torch.float64)
            assert all(channel.all() for channel in texture(*point(just_inside)))

    @every_interpolation
    @pytest.mark.parametrize("wrap", ["border", "repeat", "mirror"])
    @pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
    def test_a_constant_comes_out_exactly(self, interpolation: Interpolation, wrap: Wrap, dtype: torch.dtype) -> None:
        value = torch.tensor(0.3, dtype=dtype)
        u, v = scattered(1000, -50, 50)
        (found,) = Texture(value.expand(1, 3, 5), interpolation, wrap)(u, v)
        assert torch.equal(found, value.expand(1000))

    @every_interpolation
    def test_texel_centres_return_the_texels(self, interpolation: Interpolation) -> None:
        image = picture()
        v, u = torch.meshgrid(torch.arange(HEIGHT) + 0.5, torch.arange(WIDTH) + 0.5, indexing="ij")
        assert torch.equal(torch.stack(Texture(image, interpolation)(u, v)), image)

    def test_linear_and_quadratic_pictures_are_reproduced(self) -> None:
        u, v = scattered(500, 2, 6)
        centre = torch.arange(8, dtype=torch.float64) + 0.5
        ramp = 2 * centre[None, :] - 3 * centre[:, None]
        (found,) = Texture(ramp, "bilinear")(u, v)
        torch.testing.assert_close(found, 2 * u - 3 * v, **TIGHT)
        # Keys: a = -1/2 alone reproduces second-degree polynomials
        (found,) = Texture(centre[None, :] ** 2 - centre[:, None] ** 2 + ramp, "bicubic")(u, v)
        torch.testing.assert_close(found, u * u - v * v + 2 * u - 3 * v, rtol=0, atol=1e-12)

    @every_interpolation
    @every_wrap
    def test_one_texel(self, interpolation: Interpolation, wrap: Wrap) -> None:
        image, (u, v) = picture(1, 1, 1), scattered(50, -4, 4)
        expected = slow(image, u.tolist(), v.tolist(), interpolation, wrap)
        torch.testing.assert_close(torch.stack(Texture(image, interpolation, wrap)(u, v)), expected, **TIGHT)

    @every_interpolation
    @every_wrap
    @pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
    @pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
    def test_coordinates_that_are_not_finite_give_nan(
        self, interpolation: Interpolation, wrap: Wrap, bad: float, dtype: torch.dtype
    ) -> None:
        texture = Texture(picture(), interpolation, wrap)
        x = torch.tensor([bad, 1.0, bad, 1.0], dtype=dtype)
        y = torch.tensor([1.0, bad, bad, 1.0], dtype=dtype)
        for channel in texture(x, y):
            assert channel.isnan().tolist() == [True, True, True, False]

    def test_infinite_texels_stay_where_they_are(self) -> None:
        image = torch.ones(3, 5)
        image[1, 4] = math.inf
        (found,) = Texture(image, "bilinear", "zeros")(torch.tensor([9.0, 2.0]), torch.tensor([1.5, 1.5]))
        assert found.tolist() == [0.0, 1.0]

    @given(
        st.floats(allow_nan=False, allow_infinity=False, width=32),
        st.floats(allow_nan=False, allow_infinity=False),
        st.sampled_from(["nearest", "bilinear"]),
        st.sampled_from(["border", "repeat", "mirror"]),
        st.sampled_from([torch.float32, torch.float64]),
    )
    @settings(max_examples=200, deadline=None, derandomize=True)
    def test_values_lie_within_the_texels(
        self, x: float, y: float, interpolation: Interpolation, wrap: Wrap, dtype: torch.dtype
    ) -> None:
        image = picture(dtype=dtype)
        limit = torch.finfo(dtype).max
        x_, y_ = torch.tensor([x], dtype=dtype), torch.tensor([y], dtype=torch.float64).clamp(-limit, limit).to(dtype)
        for channel, plane in zip(Texture(image, interpolation, wrap)(x_, y_), image):
            assert float(plane.min()) <= float(channel) <= float(plane.max())


class TestPlacing:
    def test_unbound_coordinates_are_texels(self) -> None:
        image = picture()
        found = Texture(image, "nearest")(torch.tensor([0.0, 6.99]), torch.tensor([3.5, 0.0]))
        assert [c.tolist() for c in found] == [[float(p[3, 0]), float(p[0, 6])] for p in image]

    def test_on_covers_the_screen_once(self) -> None:
        image, size = picture(), (10, 30)
        x, y = scattered(300, -5, 40)
        texture = Texture(image)
        bound = texture.on(size)
        for found, expected in zip(bound(x, y), texture(x * WIDTH / 30, y * HEIGHT / 10)):
            assert torch.equal(found, expected)
        assert texture.size is None
        assert bound.size == size
        assert bound.image is texture.image

    @pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
    def test_edges_of_texels_on_whole_pixels_are_exact(self, dtype: torch.dtype) -> None:
        for n in range(1, 60):
            texture = Texture(torch.arange(7.0)[None, :], "nearest", "zeros").on((1, 7 * n))
            (found,) = texture(torch.arange(7 * n, dtype=dtype), torch.full((7 * n,), 0.5, dtype=dtype))
            assert found.tolist() == [float(j // n) for j in range(7 * n)]

    def test_a_size_or_a_transform_of_its_own_stays(self) -> None:
        sized, moved = Texture(picture(), size=(8, 9)), Texture(picture(), transform=torch.eye(3))
        assert sized.on((20, 20)) is sized
        assert moved.on((20, 20)) is moved

    @pytest.mark.parametrize("as_given", [torch.as_tensor, np.asarray, list])
    def test_a_transform_maps_the_screen_to_texels(self, as_given: object) -> None:
        rows = [[0.3, -0.1, 2.0], [0.05, 0.4, -1.0], [0.002, -0.004, 1.0]]
        image, (x, y) = picture(), scattered(300, -30, 30)
        found = Texture(image, "bicubic", "repeat", transform=as_given(rows))(x, y)  # pyright: ignore[reportCallIssue]
        d = 0.002 * x - 0.004 * y + 1
        expected = Texture(image, "bicubic", "repeat")((0.3 * x - 0.1 * y + 2) / d, (0.05 * x + 0.4 * y - 1) / d)
        # list and array are float64, the tensor float32
        atol = 1e-12 if as_given is not torch.as_tensor else 1e-5
        torch.testing.assert_close(torch.stack(found), torch.stack(expected), rtol=0, atol=atol)

    @every_interpolation
    @every_wrap
    def test_nothing_is_seen_beyond_the_horizon(self, interpolation: Interpolation, wrap: Wrap) -> None:
        matrix = torch.tensor([[1.0, 0, 0], [0, 0, 2], [0, 1, -4]], dtype=torch.float64)  # D = y - 4
        x, y = torch.full((5,), 3.0, dtype=torch.float64), torch.tensor([-1e9, 3.999, 4.0, 4.5, 6.0], dtype=torch.float64)
        image = picture() + 1
        seen = Texture(image, interpolation, wrap, transform=matrix)(x, y)
        for channel, expected in zip(seen, Texture(image, interpolation, wrap)(x[3:] / (y[3:] - 4), 2 / (y[3:] - 4))):
            assert not channel[:3].any()
            torch.testing.assert_close(channel[3:], expected, **TIGHT)
        for channel in Texture(image, interpolation, wrap, transform=-matrix)(x, y):
            assert not channel[2:].any()

    def test_a_coordinate_that_is_nan_shows_through_a_transform(self) -> None:
        (found,) = Texture(torch.ones(2, 2), "nearest", transform=torch.eye(3))(torch.tensor([math.nan]), torch.tensor([1.0]))
        assert found.isnan().all()

    def test_large_translations_and_other_units_are_not_degenerate(self) -> None:
        far, fine, whole = [[1, 0, 1e12], [0, 1, -1e12], [0, 0, 1]], np.diag([1e-7, 1e-7, 1.0]), [[3, 1, 0], [1, 2, 0], [0, 0, 1]]
        for matrix in (far, fine, whole):
            Texture(picture(), transform=matrix)


class TestKinds:
    @pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
    @pytest.mark.parametrize("coordinates", [torch.float32, torch.float64])
    @every_interpolation
    def test_values_have_the_images_dtype(self, dtype: torch.dtype, coordinates: torch.dtype, interpolation: Interpolation) -> None:
        x = torch.rand(3, 5, dtype=coordinates, generator=torch.Generator().manual_seed(1))
        image = picture(dtype=dtype)
        for texture in (Texture(image, interpolation, "zeros"), Texture(image.numpy(), interpolation)):
            for placed in (texture, texture.on((3, 9)), Texture(texture.image, interpolation, transform=torch.eye(3))):
                assert all(channel.dtype == dtype and channel.shape == x.shape for channel in placed(x, x))

    @pytest.mark.parametrize(
        ("dtype", "values", "expected"),
        [
            (np.uint8, [0, 51, 255], [0, 0.2, 1]),
            (np.uint16, [0, 13107, 65535], [0, 0.2, 1]),
            (np.bool_, [False, True, True], [0, 1, 1]),
            (np.float16, [-1.5, 0.25, 40], [-1.5, 0.25, 40]),
            (">f4", [-1.5, 0.25, 40], [-1.5, 0.25, 40]),
            (">u2", [0, 13107, 65535], [0, 0.2, 1]),
        ],
    )
    def test_integers_are_scaled(self, dtype: object, values: list[float], expected: list[float]) -> None:
        array = np.array([values], dtype=dtype)  # pyright: ignore[reportCallIssue, reportArgumentType]
        array.setflags(write=False)
        pictures = [array, array[None], array[:, ::-1][:, ::-1]]
        if array.dtype.isnative:
            pictures.append(torch.from_numpy(array.copy()))
        for image in pictures:
            stored = Texture(image).image
            assert stored.shape == (1, 1, 3)
            assert torch.equal(stored, torch.tensor([[expected]], dtype=torch.float32))

    def test_floats_are_not_copied(self) -> None:
        image, plane, array = picture(), picture()[0], picture().numpy()
        assert Texture(image).image is image
        assert Texture(plane).image.data_ptr() == plane.data_ptr()
        assert np.shares_memory(Texture(array).image.numpy(), array)
        image.mul_(2)
        assert torch.equal(torch.stack(Texture(image)(torch.tensor([0.5]), torch.tensor([0.5])))[:, 0], image[:, 0, 0])

    @every_interpolation
    def test_layout_does_not_matter(self, interpolation: Interpolation) -> None:
        image, (u, v) = picture(3), scattered(100, -3, 9)
        channels_last = image.permute(1, 2, 0).contiguous().permute(2, 0, 1)
        transposed = image.mT.contiguous().mT
        for other in (channels_last, transposed):
            for a, b in zip(Texture(image, interpolation)(u, v), Texture(other, interpolation)(u, v)):
                assert torch.equal(a, b)

    @pytest.mark.parametrize("shape", [(), (0,), (3,), (2, 3), (4, 2, 3)])
    def test_any_shape_of_coordinates(self, shape: tuple[int, ...]) -> None:
        found = Texture(picture(3), "bicubic", "zeros").on((5, 5))(torch.ones(shape), torch.ones(shape))
        assert [channel.shape for channel in found] == [shape] * 3

    @pytest.mark.parametrize("clone", [copy.deepcopy, copy.copy, lambda texture: pickle.loads(pickle.dumps(texture))])
    def test_copies_are_the_same_function(self, clone: object) -> None:
        u, v = scattered(50, -3, 9)
        for texture in (Texture(picture(), "bicubic", "mirror").on((6, 5)), Texture(picture(), transform=torch.eye(3))):
            for a, b in zip(texture(u, v), clone(texture)(u, v)):  # pyright: ignore[reportCallIssue]
                assert torch.equal(a, b)

    def test_is_one_graph(self) -> None:
        x, y = scattered(64, -3, 9)
        flat = Texture(picture(), "bicubic", "zeros").on((6, 5))
        for texture in (flat, Texture(picture(), "bilinear", "mirror", transform=torch.eye(3))):
            compiled = torch.compile(texture.__call__, fullgraph=True, backend="eager")
            for a, b in zip(texture(x, y), compiled(x, y)):
                assert torch.equal(a, b)

    @pytest.mark.parametrize(
        ("image", "message"),
        [
            (np.zeros((2, 3), np.int64), r"a numpy array of shape \(2, 3\) and dtype int64"),
            (torch.zeros(2, 3, dtype=torch.int32), "torch.int32"),
            (torch.zeros(2, 3, dtype=torch.complex64), "torch.complex64"),
            (np.zeros((2, 3), np.complex64), "dtype complex64"),
            (np.array([["a"]]), "dtype <U1"),
            ([[0.0, 1.0]], "got a list"),
            (None, "got NoneType"),
            (torch.zeros(3), r"got a tensor of shape \(3,\)"),
            (torch.zeros(1, 3, 4, 4), r"\(1, 3, 4, 4\)"),
            (torch.zeros(3, 0, 4), r"\(3, 0, 4\)"),
            (np.zeros((0, 4, 4)), r"\(0, 4, 4\)"),
        ],
    )
    def test_bad_images(self, image: object, message: str) -> None:
        with pytest.raises(McaaError, match=message):
            Texture(image)  # pyright: ignore[reportArgumentType]

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"interpolation": "linear"}, "'linear'"),
            ({"wrap": "clamp"}, "'clamp'"),
            ({"wrap": None}, "None"),
            ({"interpolation": ["nearest"]}, "nearest"),
            ({"size": (0, 4)}, "size must be"),
            ({"size": (4.5, 4)}, "size must be"),
            ({"size": (4, 4), "transform": torch.eye(3)}, r"size=\(4, 4\)"),
            ({"transform": torch.eye(2)}, r"shape \(2, 2\)"),
            ({"transform": torch.eye(3, dtype=torch.complex64)}, "complex64"),
            ({"transform": "identity"}, "'identity'"),
            ({"transform": [[1, 2], [3]]}, r"\[\[1, 2\], \[3\]\]"),
            ({"transform": torch.zeros(3, 3)}, "invertible"),
            ({"transform": torch.tensor([[1.0, 2, 3], [2, 4, 6], [0, 0, 1]])}, "invertible"),
            ({"transform": [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6], [0.7, 0.8, 0.9]]}, "invertible"),
            ({"transform": np.diag([1.0, 1.0, math.nan])}, "finite"),
            ({"transform": np.diag([1.0, 1.0, math.inf])}, "finite"),
        ],
    )
    def test_bad_options(self, options: dict[str, object], message: str) -> None:
        with pytest.raises(McaaError, match=message):
            Texture(picture(), **options)  # pyright: ignore[reportArgumentType]

    def test_bad_screen_and_device(self) -> None:
        with pytest.raises(McaaError, match="size must be"):
            Texture(picture()).on((-1, 4))
        with pytest.raises(McaaError, match="on cpu, x on meta"):
            Texture(picture())(torch.ones(2, device="meta"), torch.ones(2, device="meta"))


class TestGradients:
    @every_interpolation
    @every_wrap
    def test_reach_the_image(self, interpolation: Interpolation, wrap: Wrap) -> None:
        u, v = scattered(12, -3, 9)
        image = picture(2, 3, 4).requires_grad_()
        assert torch.autograd.gradcheck(lambda image: Texture(image, interpolation, wrap)(u, v), image)

    @pytest.mark.parametrize("interpolation", ["bilinear", "bicubic"])
    @every_wrap
    def test_reach_the_coordinates(self, interpolation: Interpolation, wrap: Wrap) -> None:
        u, v = scattered(12, -3, 9)
        # bilinear has kinks between its pieces: differences of +-1e-6 must not step over one
        assert float(((u - 0.5) - (u - 0.5).round()).abs().min()) > 1e-4
        assert float(((v - 0.5) - (v - 0.5).round()).abs().min()) > 1e-4
        texture = Texture(picture(), interpolation, wrap)
        assert torch.autograd.gradcheck(texture, (u.requires_grad_(), v.requires_grad_()))

    @pytest.mark.parametrize("interpolation", ["bilinear", "bicubic"])
    def test_reach_the_transform_and_stop_at_the_horizon(self, interpolation: Interpolation) -> None:
        matrix = torch.tensor([[0.7, 0.1, 0.3], [-0.2, 0.9, 0.2], [0.01, 0.2, 0.1]], dtype=torch.float64, requires_grad=True)
        x, y = scattered(12, -3, 9)
        assert 0 < int((0.01 * x + 0.2 * y + 0.1 <= 0).sum()) < 12
        assert torch.autograd.gradcheck(lambda m: Texture(picture(), interpolation, "repeat", transform=m)(x, y), matrix)

    def test_a_step_taken_in_place_is_seen(self) -> None:
        parameter = torch.nn.Parameter(picture()[0].clone())
        texture = Texture(parameter).on((8, 8))
        x, y = scattered(64, 0, 8)
        losses = []
        for _ in range(2):
            loss = texture(x, y)[0].square().sum()
            losses.append(float(loss.detach()))
            (gradient,) = torch.autograd.grad(loss, parameter)
            with torch.no_grad():
                parameter -= 0.01 * gradient
        assert losses[1] < losses[0]


class TestTruth:
    PROFILES = {  # noqa: RUF012
        "box 1": (texture_truth.box(1.0), lambda d: torch.ones_like(d)),
        "box 2.3": (texture_truth.box(2.3), lambda d: torch.full_like(d, 1 / 2.3)),
        "gaussian": (texture_truth.gaussian(0.35), lambda d: normal(d, 0.35)),
        "cut gaussian": (texture_truth.gaussian(0.5, 0.8), lambda d: normal(d, 0.5) / math.erf(0.8 / 0.5 / math.sqrt(2))),
    }

    @staticmethod
    def rule(centre: float, reach: float, scale: float) -> tuple[Tensor, Tensor]:
        """Gauss-Legendre nodes and weights on every piece of the integrand: cut at texels' edges and centres and at half pixels."""
        reach = min(reach, 2.8)  # eight standard deviations of the uncut normal: 1e-15 is left
        low, high = centre - reach, centre + reach
        cuts = {low, high}
        cuts |= {k / (2 * scale) for k in range(math.floor(low * 2 * scale), math.ceil(high * 2 * scale) + 1)}
        cuts |= {k / 2 for k in range(math.floor(2 * low), math.ceil(2 * high) + 1)}
        edges = torch.tensor(sorted(cut for cut in cuts if low <= cut <= high), dtype=torch.float64)
        nodes, weights = (torch.from_numpy(a) for a in np.polynomial.legendre.leggauss(8))
        half = (edges[1:] - edges[:-1])[:, None] / 2
        return (edges[:-1, None] + half * (1 + nodes)).reshape(-1), (half * weights).reshape(-1)

    @pytest.mark.parametrize("interpolation", ["nearest", "bilinear"])
    @every_wrap
    @pytest.mark.parametrize("profile", PROFILES)
    @pytest.mark.parametrize("size", [(3, 4), (1, 5)])
    def test_agrees_with_quadrature(self, interpolation: Interpolation, wrap: Wrap, profile: str, size: tuple[int, int]) -> None:
        """8 nodes on pieces of at most 1.5 standard deviations: the rule's own error is 2e-14."""
        exact, density = self.PROFILES[profile]
        image = picture(2, 2, 3)
        f = Texture(image, interpolation, wrap).on(size)
        truth = texture_truth.pixel_values(image, size, exact, interpolation, wrap)
        assert truth.shape == (2, *size)
        for i in range(size[0]):
            y, across_y = self.rule(i + 0.5, exact.reach, 2 / size[0])
            for j in range(size[1]):
                x, across_x = self.rule(j + 0.5, exact.reach, 3 / size[1])
                weight = (across_y * density(y - i - 0.5))[:, None] * (across_x * density(x - j - 0.5))
                grid_y, grid_x = torch.meshgrid(y, x, indexing="ij")
                found = torch.stack([(channel * weight).sum() for channel in f(grid_x, grid_y)])
                torch.testing.assert_close(found, truth[:, i, j], **TIGHT)

    @pytest.mark.parametrize("interpolation", ["nearest", "bilinear"])
    @pytest.mark.parametrize("wrap", ["border", "repeat", "mirror"])
    @pytest.mark.parametrize("profile", PROFILES)
    def test_weights_sum_to_one(self, interpolation: Interpolation, wrap: Wrap, profile: str) -> None:
        matrix = texture_truth.weights(9, 13, self.PROFILES[profile][0], interpolation, wrap)
        torch.testing.assert_close(matrix.sum(1), torch.ones(9, dtype=torch.float64), **TIGHT)

    def test_one_texel_a_pixel_under_a_box_is_the_texture(self) -> None:
        image = picture()
        found = texture_truth.pixel_values(image, (HEIGHT, WIDTH), texture_truth.box(1.0), "nearest", "zeros")
        torch.testing.assert_close(found, image, **TIGHT)
