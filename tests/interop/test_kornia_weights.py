"""How files of kornia's weights are read, and what is said where there are none."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg import registry
from featreg.errors import InputError, ParameterError, PluginUnavailableError
from featreg.interop import kornia as featreg_kornia
from featreg.interop import weights as trained
from featreg.io import as_image
from featreg.types import Features
from made.networks import saved, seeded

torch = pytest.importorskip("torch")
pytest.importorskip("kornia", minversion="0.9")
import kornia.feature as library  # noqa: E402

Texture = Callable[..., NDArray[np.float32]]
ENTRIES = [
    e for kind in ("detector", "descriptor", "nearest", "matcher") for e in registry.entries(kind) if "kornia" in e.name
]
LEARNED = [e for e in ENTRIES if "weights" in e.parameters]


def describe_with(path: str) -> None:
    image = as_image(np.random.default_rng(0).gamma(4, size=(64, 64)))
    points = Features(np.full((1, 2), 30.0), np.full(1, 8.0), np.zeros(1), np.ones(1), np.zeros(1, np.int64))
    registry.create("descriptor", "kornia-hardnet", weights=path).describe_features(image, points)


def test_a_wrong_file_of_weights_is_named_with_what_is_wrong(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        describe_with(str(tmp_path / "none.pth"))
    (tmp_path / "text.pth").write_text("no weights")
    with pytest.raises(InputError, match="holds no tensors that torch can read"):
        describe_with(str(tmp_path / "text.pth"))
    torch.save([1, 2], tmp_path / "list.pth")
    with pytest.raises(InputError, match="a mapping of names to tensors is needed"):
        describe_with(str(tmp_path / "list.pth"))
    with pytest.raises(InputError, match="is not of HardNet: lacks"):
        describe_with(saved(library.HyNet(False), tmp_path / "hynet.pth"))


class Bomb:
    """Its pickle would run code."""

    def __reduce__(self) -> Any:
        return (print, ("code of the file ran",))


def test_code_in_a_file_of_weights_does_not_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    torch.save({"state_dict": Bomb()}, tmp_path / "bomb.pth")
    with pytest.raises(InputError, match="holds no tensors"):
        describe_with(str(tmp_path / "bomb.pth"))
    assert capsys.readouterr().out == ""


def test_a_file_that_changed_is_read_again(tmp_path: Path, sar_texture: Texture) -> None:
    image = as_image(sar_texture(64, 64))
    points = Features(np.full((1, 2), 30.0), np.full(1, 8.0), np.zeros(1), np.ones(1), np.zeros(1, np.int64))
    tables = []
    for number in range(2):
        torch.manual_seed(number)
        path = saved(library.HardNet(False), tmp_path / "weights.pth")
        (tmp_path / "weights.pth").touch()
        found = registry.create("descriptor", "kornia-hardnet", weights=path).describe_features(image, points)
        assert found.descriptors is not None
        tables.append(found.descriptors)
        time.sleep(0.02)
    assert not np.array_equal(tables[0], tables[1])


@pytest.mark.parametrize("entry", LEARNED, ids=lambda e: e.name)
def test_without_weights_and_network_the_cure_is_named(
    entry: registry.Entry, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, sar_texture: Texture
) -> None:
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    monkeypatch.setattr(featreg_kornia, "reachable", lambda: False)
    monkeypatch.setattr(trained, "find_spec", lambda name: None)
    made = registry.create(entry.kind, entry.name)  # type: ignore[call-overload]
    assert made.row.on_demand
    assert "give weights=FILE" in made.row.unavailable
    with pytest.raises(PluginUnavailableError, match=f"{entry.name}: its trained weights are not on this machine"):
        made.network()


def test_weights_in_kornias_cache_make_a_plugin_available(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    row = registry.create("descriptor", "kornia-hardnet").row  # type: ignore[attr-defined]
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    assert row.unavailable
    folder = tmp_path / "hub" / "checkpoints"
    folder.mkdir(parents=True)
    torch.save({"state_dict": seeded(lambda: library.HardNet(False)).state_dict()}, folder / row.files({})[0])
    assert not row.unavailable
    featreg_kornia._network.cache_clear()
    try:
        assert type(registry.create("descriptor", "kornia-hardnet").network()).__name__ == "HardNet"  # type: ignore[attr-defined]
    finally:
        featreg_kornia._network.cache_clear()


def test_a_silent_network_is_given_up_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    def silent(*_: Any, **__: Any) -> Any:
        time.sleep(0.5)
        raise OSError

    monkeypatch.setattr(socket, "create_connection", silent)
    monkeypatch.setattr(featreg_kornia, "PATIENCE", 0.05)
    assert not featreg_kornia.reachable()


@pytest.mark.parametrize(
    ("kind", "name", "parameters"),
    [
        ("detector", "kornia-harris", {"n_features": 0}),
        ("detector", "kornia-dog", {"orientation": "up"}),
        ("detector", "kornia-dog", {"normalise": "loud"}),
        ("detector", "kornia-disk", {"checkpoint": "deep"}),
        ("detector", "kornia-disk", {"weights": 7}),
        ("descriptor", "kornia-sift", {"patch_size": 0}),
        ("descriptor", "kornia-mkd", {"kernel_type": "square"}),
        ("nearest", "kornia-smnn", {"threshold": -0.1}),
        ("nearest", "kornia-lightglue", {"features": "orb"}),
    ],
)
def test_impossible_parameters_are_refused(kind: Any, name: str, parameters: dict[str, Any]) -> None:
    with pytest.raises(ParameterError, match=next(iter(parameters))):
        registry.create(kind, name, **parameters)
