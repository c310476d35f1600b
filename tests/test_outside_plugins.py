"""Plugins of somebody else's package are treated as our own: conformance, scenes, comparisons, warm-up, digests."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
MODULES = ("agreement", "corners", "windows")
pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("outside")]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder on the module path in which the package is installed with its entry points."""
    folder = tmp_path_factory.mktemp("site")
    shutil.copytree(HERE / "outside" / "featreg_outside", folder / "featreg_outside")
    info = folder / "featreg_outside-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: featreg-outside\nVersion: 1.0\n")
    points = "".join(f"{name} = featreg_outside.{name}\n" for name in MODULES)
    (info / "entry_points.txt").write_text(f"[featreg.plugins]\n{points}")
    return folder


def run(site: Path, *arguments: str, folder: Path) -> str:
    environment = {**os.environ, "PYTHONPATH": str(site)}
    done = subprocess.run(
        [sys.executable, *arguments], env=environment, cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return done.stdout


def test_the_conformance_tests_hold(site: Path) -> None:
    said = run(
        site, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-n0", "tests/test_plugins.py", "-k", "outside",
        folder=HERE.parent,
    )  # fmt: skip
    passed = re.search(r"(\d+) passed", said)
    assert passed is not None
    assert int(passed[1]) == 11


def test_the_users_values_reach_a_parameter_of_any_name(site: Path, tmp_path: Path) -> None:
    code = """
import featreg
from featreg.simulate import sar_pair

pair = sar_pair((480, 500), rotation_deg=2.0, seed=3)
for given in ({}, {"describe": False}, {"describe": True}):
    reg = featreg.match(pair.reference, pair.secondary, detector="outside-corners", **given)
    assert reg.status == "ok", reg.reason
    assert reg.provenance["parameters"]["detector"]["describe"] is given.get("describe", True)
finder = featreg.extractor("outside-corners", "brief", describe=True)
assert finder.detector.describe is True
"""
    run(site, "-c", code, folder=tmp_path)


def test_in_a_scene(site: Path, tmp_path: Path) -> None:
    """Its form for blocks is used, its global filter runs once over all, in processes that load it by themselves."""
    code = """
import numpy as np
import featreg
from featreg.simulate import sar_pair

pair = sar_pair((520, 540), rotation_deg=0.4, scale=1.0, shift=(3.0, -2.0), seed=4)
keywords = dict(detector="outside-corners", filters=["gms", "outside-agreement"], initial=np.eye(3), search_radius=30.0)
whole = featreg.match(pair.reference, pair.secondary, block=False, **keywords)
made = [
    featreg.match(pair.reference, pair.secondary, block=260, executor=executor, workers=2, **keywords)
    for executor in ("serial", "processes")
]
scene = made[0]
assert scene.status == whole.status == "ok", (scene.reason, whole.reason)
assert list(scene.stages) == ["prior", "gms", "initial", "outside-agreement", "locate", "refine"], list(scene.stages)
assert scene.provenance["parameters"]["detector"]["spacing"] == 2
assert whole.provenance["parameters"]["detector"]["spacing"] == 3
assert featreg.evaluate(scene, pair.truth).stage == "locate"
assert np.array_equal(made[0].matches.reference_xy, made[1].matches.reference_xy)
windows = featreg.match(pair.reference, pair.secondary, method="sar-orb", matcher="outside-windows", block=260,
                        filters="outside-agreement", workers=1, initial=np.eye(3), search_radius=30.0)
assert windows.status == "ok", windows.reason
"""
    run(site, "-c", code, folder=tmp_path)


def test_in_a_comparison_whose_cache_knows_its_code(site: Path, tmp_path: Path) -> None:
    code = """
import sys
import featreg
from featreg.simulate import sar_pair

pair = sar_pair((480, 500), rotation_deg=2.0, seed=3)
methods = [("theirs", {"method": "sar-orb", "detector": "outside-corners", "filters": ["gms", "outside-agreement"]})]
table = featreg.compare([(pair.reference, pair.secondary, pair.truth)], methods, cache="kept", timing=False,
                        metrics=["ncm", "repeatability"])
row = table.rows[0]
assert row["status"] == "ok" and row["ncm"] > 30, row
print(len(list(__import__("pathlib").Path("kept").glob("*.json"))))
"""
    assert run(site, "-c", code, folder=tmp_path).split()[-1] == "1"
    assert run(site, "-c", code, folder=tmp_path).split()[-1] == "1"
    helper = site / "featreg_outside" / "agreement.py"
    helper.write_text(helper.read_text().replace("iterations=30", "iterations=20"))
    assert run(site, "-c", code, folder=tmp_path).split()[-1] == "2"


def test_it_is_warmed_up_and_listed(site: Path, tmp_path: Path) -> None:
    code = """
from featreg.warming import _methods

names = [value for keywords in _methods() for value in keywords.values()]
assert "outside-corners" in names and "outside-windows" in names and ["outside-agreement"] in names, names
"""
    run(site, "-c", code, folder=tmp_path)
    listed = run(site, "-m", "featreg", "list", "detector", folder=tmp_path)
    assert "outside-corners" in listed
