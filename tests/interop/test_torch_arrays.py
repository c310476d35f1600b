"""Images and features to torch tensors and frames and back."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError
from featreg.interop.torch_arrays import as_device, inference, to_image, to_tensor
from featreg.io import as_image
from featreg.types import Features

torch = pytest.importorskip("torch")
pytest.importorskip("kornia", minversion="0.9")
import kornia.feature as library  # noqa: E402

Texture = Callable[..., NDArray[np.float32]]


def test_a_frame_is_what_kornia_makes_of_centre_scale_and_angle(random_features: Callable[..., Features]) -> None:
    given = random_features()
    made = library.laf_from_center_scale_ori(
        torch.from_numpy(np.array(given.xy))[None],
        torch.from_numpy(np.array(given.scale)).reshape(1, -1, 1, 1),
        torch.from_numpy(np.rad2deg(given.angle)).reshape(1, -1, 1),
    )
    np.testing.assert_allclose(given.to_lafs().numpy(), made.numpy(), atol=1e-9)


def test_features_survive_the_way_to_frames_and_back(random_features: Callable[..., Features]) -> None:
    given = random_features(width=8)
    again = Features.from_lafs(given.to_lafs(), given.score, given.descriptors)
    for name in ("xy", "scale", "angle", "score", "descriptors"):
        np.testing.assert_allclose(getattr(again, name), getattr(given, name), rtol=1e-12, atol=1e-9)


def test_padding_is_left_out_and_an_elongated_or_mirrored_frame_becomes_a_circle() -> None:
    lafs = torch.tensor([[[[8.0, 0, 5], [0, -2, 7]], [[0, 0, 0], [0, 0, 0]]]])
    found = Features.from_lafs(lafs, [3.0, 0.0], np.ones((2, 4), np.float32))
    assert found.xy.tolist() == [[5, 7]]
    assert found.scale.tolist() == pytest.approx([4])
    assert found.score.tolist() == [3]
    assert found.descriptors is not None
    assert found.descriptors.shape == (1, 4)


def test_no_features_are_no_frames() -> None:
    assert Features.empty().to_lafs().shape == (1, 0, 2, 3)
    assert len(Features.from_lafs(torch.zeros(1, 5, 2, 3))) == 0


def test_the_patch_of_a_frame_is_the_image_around_it(sar_texture: Texture) -> None:
    """A circle of radius 10.5 at pixel (30, 40) is the 21 x 21 square around it: no half pixel lies between us."""
    tensor = to_tensor(as_image(sar_texture(100, 110)))
    one = Features(np.array([[30.0, 40.0]]), np.full(1, 10.5), np.zeros(1), np.ones(1), np.zeros(1, np.int64))
    patch = library.extract_patches_simple(tensor, one.to_lafs().float(), 21)[0, 0, 0]
    np.testing.assert_allclose(patch.numpy(), tensor[0, 0, 30:51, 20:41].numpy(), atol=1e-4)


def test_an_angle_turns_the_patch_counter_clockwise(sar_texture: Texture) -> None:
    tensor = to_tensor(as_image(sar_texture(100, 110)))
    one = Features(np.array([[30.0, 40.0]]), np.full(1, 10.5), np.full(1, np.pi / 2), np.ones(1), np.zeros(1, np.int64))
    patch = library.extract_patches_simple(tensor, one.to_lafs().float(), 21)[0, 0, 0]
    # Its x axis points up, so the row through its middle is the column of the image, from bottom to top.
    np.testing.assert_allclose(patch[10].numpy(), tensor[0, 0, 30:51, 30].flip(0).numpy(), atol=1e-4)


def test_an_image_survives_the_way_to_a_tensor_and_back(sar_texture: Texture) -> None:
    amplitude = sar_texture(40, 50)
    again = to_image(torch.from_numpy(amplitude)[None, None])
    np.testing.assert_array_equal(again.amplitude, amplitude)
    picture = to_tensor(as_image(amplitude))
    assert (tuple(picture.shape), picture.dtype) == ((1, 1, 40, 50), torch.float32)
    assert float(picture.min()) == 0.0
    assert float(picture.max()) == 1.0
    assert to_image(torch.ones(20, 30, dtype=torch.complex64) * torch.arange(30)).is_complex


@pytest.mark.parametrize("shape", [(2, 20, 20), (1, 3, 20, 20), (20,)])
def test_more_than_one_image_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="one image is"):
        to_image(torch.ones(shape))


@pytest.mark.parametrize("shape", [(2, 3), (2, 4, 2, 3), (4, 2, 2)])
def test_what_is_no_frame_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="LAFs have shape"):
        Features.from_lafs(torch.zeros(shape))


@pytest.mark.parametrize("name", ["tpu9", "", "cuda:99"])
def test_a_device_that_is_not_there_is_refused(name: str) -> None:
    with pytest.raises(ParameterError, match="device"):
        as_device(name)


def test_threads_and_gradients_are_as_before_afterwards() -> None:
    before = torch.get_num_threads()
    with inference(1):
        assert torch.get_num_threads() == 1
        assert not torch.is_grad_enabled()
        with inference(1):
            pass
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == before
    assert torch.is_grad_enabled()
