from __future__ import annotations

import dataclasses
import itertools

import pytest
import torch
import torch.nn.functional as F
from torch import nn

from viewnet.config import ModelConfig
from viewnet.errors import ViewnetError
from viewnet.geometry import azimuth_elevation
from viewnet.model.fast_layers import FirstDeconv, Upsample2x
from viewnet.model.networks import AdaIN, Encoder, Generator, gaussian_prior, parameters
from viewnet.model.viewnet import ViewNet, ViewpointNetwork
from viewnet.model.volume import joined
from viewnet.recipes import make_config

SMALL = make_config(profile="smoke").model


def small(**changes) -> ModelConfig:
    return dataclasses.replace(SMALL, **changes)


# Encoder


@pytest.mark.parametrize("size", [8, 32, 64, 128])
def test_the_encoder_ends_in_a_vector_whatever_the_image_s_size(size):
    encoder = Encoder((4,) * 7, 5, size)
    assert encoder(torch.rand(3, 3, size, size)).shape == (3, 5)
    assert sum(isinstance(m, nn.Conv2d) for m in encoder) == size.bit_length()


@pytest.mark.parametrize(
    ("channels", "size", "message"),
    [
        ((8, 8, 8), 48, "image_size 48: expected a power of two of 8 or more"),
        ((8, 8, 8), 4, "image_size 4: expected a power of two"),
        ((8, 8), 32, "5 are needed for images of 32 pixels"),
    ],
)
def test_encoders_that_cannot_be(channels, size, message):
    with pytest.raises(ViewnetError, match=message):
        Encoder(channels, 4, size)


def test_the_paper_s_encoder_has_as_many_numbers_as_its_table():
    config = make_config(profile="paper").model
    widths = (3, 64, 128, 256, 512, 512)
    convolutions = sum(9 * a * b for a, b in itertools.pairwise(widths)) + 4 * 512 * 512
    norms = 2 * (sum(widths[1:]) + 512)
    model = ViewNet(config)
    assert parameters(model.appearance) == convolutions + norms + 512 * 256 + 256
    assert parameters(model.viewpoint) == convolutions + norms + 512 * 12 + 12


# Viewpoint network


@pytest.mark.parametrize(("heads", "in_plane"), [(1, False), (3, False), (5, True)])
def test_hypotheses(heads, in_plane):
    torch.manual_seed(0)
    found = ViewpointNetwork(small(heads=heads, in_plane=in_plane))(torch.rand(4, 3, 32, 32))
    assert found.vectors.shape == (4, heads, 3)
    assert found.logits.shape == (4, heads)
    assert torch.allclose(found.vectors.norm(dim=-1), torch.ones(4, heads), atol=1e-5)
    assert found.world_from_camera.shape == (4, heads, 3, 3)
    assert torch.allclose(torch.linalg.det(found.world_from_camera), torch.ones(4, heads), atol=1e-4)
    assert torch.allclose(found.world_from_camera[..., 2], found.vectors, atol=1e-5)
    if in_plane:
        assert torch.allclose(found.ups.norm(dim=-1), torch.ones(4, heads), atol=1e-5)
    else:
        assert found.ups is None
    index = torch.arange(4) % heads
    assert torch.equal(found.of_heads(index), torch.stack([found.vectors[n, m] for n, m in enumerate(index)]))


def test_elevations_stay_within_their_limits_and_azimuths_go_all_around():
    network = ViewpointNetwork(small(elevation_limits=(-22.0, 42.0)))
    raw = 20 * torch.randn(2000, 3, generator=torch.Generator().manual_seed(0))
    azimuth, elevation = azimuth_elevation(network.on_sphere(raw))
    assert elevation.min() >= -22.001
    assert elevation.max() <= 42.001
    assert elevation.max() - elevation.min() > 60
    assert torch.histc(azimuth, 12, 0, 360).min() > 100


# Generator


def test_adain_starts_as_instance_normalisation_for_the_average_appearance():
    torch.manual_seed(0)
    layer, x = AdaIN(6, 5), 3 + 2 * torch.randn(2, 6, 4, 4, 4)
    assert torch.allclose(layer(x, torch.zeros(2, 5)), F.relu(F.instance_norm(x)), atol=1e-6)


def test_adain_applies_one_affine_map_to_all_of_a_channel():
    """So it cannot change the spatial layout of a channel (section 3.2)."""
    torch.manual_seed(0)
    layer, x, appearance = AdaIN(6, 5), torch.randn(2, 6, 4, 4, 4), torch.randn(2, 5)
    plain, styled = F.instance_norm(x).flatten(2), layer(x, appearance).flatten(2)
    scale, shift = layer.affine(appearance).chunk(2, dim=1)
    assert torch.allclose(styled, F.relu(scale[..., None] * plain + shift[..., None]), atol=1e-5)
    assert not torch.allclose(styled[0], styled[1], atol=0.1)


def test_the_opening_is_the_transposed_convolution_it_stands_for():
    torch.manual_seed(0)
    layer, x = FirstDeconv(5, 3), torch.randn(2, 5, 1, 1, 1)
    for weight in (layer.weight, layer.weight.contiguous(memory_format=torch.channels_last_3d)):
        layer.weight.data = weight.data
        assert torch.allclose(layer(x), F.conv_transpose3d(x, layer.weight), atol=1e-6)


def test_doubling_is_the_transposed_convolution_it_stands_for():
    torch.manual_seed(0)
    layer = Upsample2x(5)
    nn.init.normal_(layer.weight)
    x = torch.randn(2, 5, 3, 4, 2, requires_grad=True)
    expected = F.conv_transpose3d(x, layer.weight, layer.bias, stride=2)
    found = joined(layer.blocks(x))
    assert found.shape == (2, 4, 6, 8, 4)
    assert torch.allclose(found, expected, atol=1e-5)
    weights = torch.randn_like(expected)
    for a, b in zip(
        torch.autograd.grad((found * weights).sum(), [x, *layer.parameters()]),
        torch.autograd.grad((expected * weights).sum(), [x, *layer.parameters()]),
        strict=True,
    ):
        assert torch.allclose(a, b, atol=1e-4)


def test_the_eight_of_a_voxel_start_equal():
    torch.manual_seed(0)
    fresh = joined(Upsample2x(5).blocks(torch.randn(2, 5, 3, 3, 3)))
    assert torch.allclose(fresh, F.interpolate(F.avg_pool3d(fresh, 2), scale_factor=2), atol=1e-5)


@pytest.mark.parametrize("size", [8, 16, 32])
@pytest.mark.parametrize(("kernel", "refine"), [(2, False), (4, True)])
def test_the_generator_fills_a_volume_of_the_size_asked_for(size, kernel, refine):
    channels = (8, 6, 4)[: size.bit_length() - 3]
    config = small(volume_size=size, generator_channels=channels, generator_last_kernel=kernel, generator_refine=refine)
    assert Generator(config)(torch.randn(2, config.appearance_size)).shape == (2, 4, size, size, size)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"volume_size": 24}, "volume_size 24: expected a power of two of 8 or more"),
        ({"volume_size": 64}, "4 are needed for a volume of 64 voxels a side"),
    ],
)
def test_generators_that_cannot_be(changes, message):
    with pytest.raises(ViewnetError, match=message):
        Generator(small(**changes))


def test_the_code_is_drawn_once_and_never_trained():
    torch.manual_seed(3)
    generator = Generator(small())
    assert "code" in generator.state_dict()  # it has to be saved, though
    assert not any(name.endswith("code") for name, _ in generator.named_parameters())
    torch.manual_seed(3)
    assert torch.equal(Generator(small()).code, generator.code)


def test_the_encoder_decoder_ablation_takes_the_appearance_at_its_entrance_only():
    generator = Generator(small(decoder="encoder_decoder"))
    assert not any(isinstance(m, AdaIN) for m in generator.modules())
    assert any(isinstance(m, AdaIN) for m in Generator(small()).modules())
    one, two = generator.eval()(torch.randn(2, SMALL.appearance_size))
    assert not torch.allclose(one, two)
    assert generator.stages[0].convolution.in_channels == SMALL.appearance_size


def test_the_prior_is_the_gaussian_of_the_middle():
    prior = gaussian_prior(8)
    axis = [(2 * i + 1) / 8 - 1 for i in range(8)]
    assert prior[3, 4, 5] == pytest.approx(
        torch.exp(torch.tensor(-(axis[3] ** 2 + axis[4] ** 2 + axis[5] ** 2) / 0.05))
    )
    for axis in range(3):
        assert torch.allclose(prior, prior.flip(axis))


# The whole model


@pytest.mark.parametrize("decoder", ["adain", "encoder_decoder", "hologan"])
def test_images_of_every_decoder(decoder):
    torch.manual_seed(0)
    model = ViewNet(small(decoder=decoder)).eval()
    images = torch.rand(2, 4, 32, 32)
    code = model.appearance(model.composite(images))
    shape, found = model.generate(code), model.viewpoint(model.composite(images))
    drawn = model.render(shape, code, found.world_from_camera.flatten(0, 1))
    assert drawn.shape == (6, 4, SMALL.render_size, SMALL.render_size)
    assert drawn.min() >= 0
    assert drawn.max() <= 1 + 1e-5
    assert (drawn[:, :3] <= drawn[:, 3:] + 1e-5).all()  # colours are multiplied by the mask
    # The viewpoint is what changes the image of one object.
    assert not torch.allclose(drawn[0], drawn[1], atol=1e-4)


def test_the_volume_keeps_to_its_range_and_starts_near_the_prior():
    torch.manual_seed(0)
    model = ViewNet(small())
    shape = model.generate(torch.zeros(2, SMALL.appearance_size))
    assert shape.min() >= 0
    assert shape.max() <= 1
    with torch.no_grad():
        model.decoder.last.weight.zero_()
        model.decoder.last.bias.zero_()
    shape = model.generate(torch.zeros(1, SMALL.appearance_size))
    assert torch.allclose(shape[0, 3], model.prior, atol=1e-6)  # Q' = 0 leaves S
    assert torch.allclose(shape[0, :3], torch.full((), 0.5))
    bare = ViewNet(small(shape_prior=False))
    with torch.no_grad():
        bare.decoder.last.weight.zero_()
        bare.decoder.last.bias.zero_()
    shape = bare.generate(torch.zeros(1, SMALL.appearance_size))
    assert torch.equal(shape[0, 3], torch.zeros_like(model.prior))  # without S, nothing is there
    assert torch.allclose(shape[0, :3], torch.full((), 0.5))


def test_encoders_see_the_object_over_the_backdrop():
    image = torch.zeros(1, 4, 2, 2)
    image[0, :, 0, 0] = torch.tensor([0.9, 0.1, 0.2, 1.0])
    image[0, :, 0, 1] = torch.tensor([0.2, 0.2, 0.2, 0.5])
    seen = ViewNet(small(backdrop=0.5)).composite(image)
    assert torch.allclose(seen[0, :, 0, 0], torch.tensor([0.9, 0.1, 0.2]))
    assert torch.allclose(seen[0, :, 0, 1], torch.tensor([0.45, 0.45, 0.45]))
    assert torch.allclose(seen[0, :, 1, 1], torch.tensor([0.5, 0.5, 0.5]))
