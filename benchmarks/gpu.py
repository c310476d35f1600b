"""The dense maps in PyTorch on each device there is, beside the compiled loops on one thread.

    python benchmarks/gpu.py [--side 2000] [--batch 4] [--points 2000] [--rounds 5] [--seed 0]

Wall time, since a graphics processor spends none of the process'; the transfer of the images to the device and of the
maps back is in it. Where there is no such processor, only the CPU's rows are printed, and that is said.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from measuring import machine, on_one_thread, round_count, table

from featreg.interop.torch_maps import harris_module, local_correlations, roewa_module
from featreg.interop.torch_orientation import orientation_module
from featreg.sar import correlation
from featreg.sar.gradients.ratio import roewa
from featreg.sar.keypoints.harris import harris_response
from featreg.sar.orientation.field import field_of

HALF, SEARCH = 12, 3
COLUMNS = ("map", "device", "s, median (quartiles)", "ns a pixel", "over compiled", "largest difference")


def spent(function: Callable[[], Any], rounds: int) -> tuple[float, float, float]:
    function()
    seconds = []
    for _ in range(rounds):
        start = time.perf_counter()
        function()
        seconds.append(time.perf_counter() - start)
    low, middle, high = np.percentile(seconds, [25, 50, 75])
    return float(low), float(middle), float(high)


def on_device(function: Callable[..., Any], device: str, *arrays: Any) -> Callable[[], Any]:
    def run() -> Any:
        with torch.no_grad():
            return function(*(torch.from_numpy(array).to(device) for array in arrays)).cpu().numpy()

    return run


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--side", type=int, default=2000)
    parser.add_argument("--batch", type=int, default=4)
    parser.add_argument("--points", type=int, default=2000)
    parser.add_argument("--rounds", type=round_count, default=5)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    on_one_thread()
    torch.set_num_threads(1)
    rng = np.random.default_rng(given.seed)
    images = np.sqrt(rng.gamma(4, 0.25, (given.batch, given.side, given.side))).astype(np.float32)
    points = rng.integers(HALF + SEARCH + 1, given.side - HALF - SEARCH - 1, (given.points, 2))

    def response(view: Any) -> Any:
        return harris_response(*roewa(view, 2.0), 1.6)

    def correlated(first: Any, second: Any, at: Any) -> Any:
        return local_correlations(first, second, at, HALF, SEARCH)

    modules = {
        "ratio gradients": roewa_module(2.0),
        "orientation": orientation_module(3.0),
        "SAR-Harris": harris_module(2.0),
    }
    compiled: dict[str, Callable[[], Any]] = {
        "ratio gradients": lambda: np.stack([np.stack(roewa(view, 2.0)) for view in images]),
        "orientation": lambda: np.stack([np.moveaxis(field_of(view, 3.0), 2, 0) for view in images]),
        "SAR-Harris": lambda: np.stack([response(view) for view in images])[:, None],
        "correlation": lambda: correlation.local_correlations(images[0], images[-1], points, HALF, SEARCH),
    }
    devices = ["cpu", "cuda"] if torch.cuda.is_available() else ["cpu"]
    rows = []
    for name, plain in compiled.items():
        wanted, (low, middle, high) = plain(), spent(plain, given.rounds)
        pixels = given.side**2 * (1 if name == "correlation" else given.batch)
        rows.append([name, "compiled", f"{middle:.3g} ({low:.3g} to {high:.3g})", 1e9 * middle / pixels, 1.0, 0.0])
        for device in devices:
            if name == "correlation":
                run = on_device(correlated, device, images[0], images[-1], points)
            else:
                run = on_device(modules[name].to(device), device, images[:, None])
            off = float(np.abs(run() - wanted).max())
            low, there, high = spent(run, given.rounds)
            spread = f"{there:.3g} ({low:.3g} to {high:.3g})"
            rows.append([name, device, spread, 1e9 * there / pixels, there / middle, off])
    images_are = f"{given.batch} images of {given.side} x {given.side}, seed {given.seed}"
    print(f"{images_are}; {machine()}; torch {torch.__version__}")
    if "cuda" in devices:
        print(f"{torch.cuda.get_device_name(0)}\n")
    else:
        print("no graphics processor that torch can use here: its rows are left out\n")
    print(table(COLUMNS, rows))


if __name__ == "__main__":
    main()
