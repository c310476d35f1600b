"""Images as the tensors that PyTorch and kornia use, and back; on which device and how many threads networks run.

kornia counts pixels as this package does: x to the right, y down, the centre of the first pixel at (0, 0). Features as
its local affine frames: `Features.to_lafs`.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError
from featreg.interop.opencv import grey
from featreg.runtime.optional import import_torch
from featreg.types import Image

if TYPE_CHECKING:
    from torch import Tensor

DEVICES = "'cpu', 'cuda', 'cuda:1', 'mps' or 'auto'"


def to_tensor(image: Image, normalise: str = "auto", device: str = "cpu") -> Tensor:
    """Return the picture of an image that networks are given.

    Parameters
    ----------
    image : of (H, W) pixels
    normalise : how amplitude becomes 8 bits; see `featreg.sar.normalise.to_uint8`
    device : where the tensor lies; see `as_device`

    Returns
    -------
    (1, 1, H, W) float32, 0 to 1; invalid pixels hold the median of the valid ones
    """
    torch = import_torch()
    picture = np.array(grey(image, normalise), np.float32) / np.float32(255)
    tensor: Tensor = torch.from_numpy(picture)[None, None].to(as_device(device))
    return tensor


def to_image(tensor: Tensor, mask: NDArray[np.bool_] | None = None, name: str = "tensor") -> Image:
    """Return a tensor as an image of linear amplitude or complex samples.

    Parameters
    ----------
    tensor : (H, W), (1, H, W) or (1, 1, H, W), real and not negative, or complex
    mask : (H, W) bool, True = valid
    name : what the image is called

    Raises
    ------
    InputError
        Another shape, or values that no image can hold.
    """
    from dataclasses import replace

    from featreg.io import as_image

    if tensor.ndim not in (2, 3, 4) or any(n != 1 for n in tensor.shape[:-2]):
        raise InputError(f"{name}: has shape {tuple(tensor.shape)}; one image is (H, W), (1, H, W) or (1, 1, H, W)")
    samples = tensor.detach().cpu().reshape(tuple(tensor.shape[-2:]))
    if samples.dtype.is_floating_point:
        samples = samples.float()
    return replace(as_image(samples.numpy(), mask=mask), name=name)


def as_device(name: str) -> Any:
    """Return the `torch.device` of a name; "auto" is the first accelerator there is, else the processor.

    Raises
    ------
    ParameterError
        No such device on this machine.
    """
    torch = import_torch()
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "mps" if torch.backends.mps.is_available() else "cpu"
    try:
        device = torch.device(name)
    except (RuntimeError, TypeError) as error:
        raise ParameterError(f"unknown device {name!r}: give {DEVICES}") from error
    there = {
        "cpu": True,
        "cuda": torch.cuda.is_available() and (device.index or 0) < torch.cuda.device_count(),
        "mps": torch.backends.mps.is_available(),
    }
    if not there.get(device.type, False):
        raise ParameterError(f"device {name!r} is not on this machine: use 'cpu', or 'auto' for the best there is")
    return device


_pin = threading.Lock()
_pinned = 0
_before = 0


@contextmanager
def inference(threads: int = 1) -> Iterator[None]:
    """Run a network inside the block: without gradients, and on so many threads of the processor (0: as torch has it).

    With one thread the sums of a network have one order, and with it one result, on every machine of a kind. The
    setting is per process: of blocks that overlap the first sets it, and the last puts back what was there before.
    """
    global _pinned, _before
    torch = import_torch()
    if threads > 0:
        with _pin:
            if _pinned == 0:
                _before = torch.get_num_threads()
                torch.set_num_threads(threads)
            _pinned += 1
            if torch.get_num_threads() != threads:
                torch.set_num_threads(threads)
    try:
        with torch.no_grad():
            yield
    finally:
        if threads > 0:
            with _pin:
                _pinned -= 1
                if _pinned == 0:
                    torch.set_num_threads(_before)
