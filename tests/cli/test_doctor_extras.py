"""`featreg doctor` looks at the parts of an extra that is made of others."""

from __future__ import annotations

import pytest

from featreg.cli.doctor import missing_extras

NEEDED = [
    "numpy>=1.26",
    "torch<3,>=2.4; extra == 'torch'",
    "no-such-library-at-all>=1; extra == 'odd'",
    "pytest>=8; extra == 'web'",
    "featreg[odd,web]; extra == 'most'",
    "featreg[most,all]; extra == 'all'",
]


def test_parts_are_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.metadata.requires", lambda name: NEEDED)
    found = missing_extras()
    for name in ("odd", "most", "all"):
        assert found[name] == {"missing": ["no-such-library-at-all"], "install": f"pip install 'featreg[{name}]'"}
    assert found["web"] == {"missing": [], "install": ""}
