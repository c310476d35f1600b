"""Variables of the environment: what means nothing is said, not passed over."""

from __future__ import annotations

from typing import Any, cast

import pytest

from featreg.cli.main import main
from featreg.errors import InputError
from featreg.runtime import precompiled
from featreg.runtime.environment import KERNELS, OTHERS, VALUES, check_environment, setting
from featreg.sar.keypoints import corner_kernels


def test_values_that_mean_something_pass(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    for name, known in VALUES.items():
        for value in ("", *known):
            monkeypatch.setenv(name, value)
            assert setting(name) == value
            check_environment()
        monkeypatch.delenv(name)
        assert setting(name) == ""
    for name in (*OTHERS, "FEATREG_OF_SOMEBODY_ELSE"):
        monkeypatch.setenv(name, "anything")
    check_environment()
    assert caplog.text == ""


def test_a_misspelt_value_is_an_error_where_it_would_count(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(KERNELS, "nubma")
    for ask in (lambda: setting(KERNELS), lambda: precompiled.current(cast(Any, corner_kernels.in_order))):
        with pytest.raises(InputError, match=r"FEATREG_KERNELS is 'nubma', give 'numba' \(.*'bitcode' .*unset"):
            ask()


@pytest.mark.parametrize("name", list(VALUES))
def test_the_command_line_refuses_a_misspelt_value_in_one_line(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(name, "yse")
    assert main(["list", "model"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"error: the environment variable {name} is 'yse', give ")
    assert err.count("\n") == 1


def test_the_command_line_warns_of_a_misspelt_name(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FEATREG_KERNEL", "numba")
    assert main(["list", "model"]) == 0
    assert "warning: the environment variable FEATREG_KERNEL is read by nothing, did you mean FEATREG_KERNELS?" in (
        capsys.readouterr().err
    )
