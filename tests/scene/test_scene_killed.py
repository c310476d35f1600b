"""A scene that was killed goes on where it stopped, and two that run at once disturb each other in nothing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg.results.registration import Registration
from made.scene_results import again, undisturbed_text

COMMAND = [sys.executable, "-m", "featreg", "match"]


def started(located_pair: Any, state: Path, out: Path, *more: str) -> subprocess.Popen[bytes]:
    command = [*COMMAND, str(located_pair.reference), str(located_pair.secondary), "--block", "150"]
    command += ["--workers", "2", "--resume", str(state), "--json", str(out), *more]
    return subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
        # A shell that runs the tests in the background has them ignore what Ctrl-C sends.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def wait_for_files(state: Path, count: int, process: subprocess.Popen[bytes]) -> None:
    end = time.monotonic() + 120
    while len(list(state.glob("*.npz"))) < count and process.poll() is None and time.monotonic() < end:
        time.sleep(0.005)


@pytest.mark.slow
def test_killed_at_several_moments_it_ends_as_if_nothing_had_happened(located_pair: Any, tmp_path: Path) -> None:
    wanted = featreg.match(located_pair.reference, located_pair.secondary, block=150, workers=1)
    state, out = tmp_path / "state", tmp_path / "r.json"
    before = 0
    for count in (1, 6, 13):
        process = started(located_pair, state, out)
        wait_for_files(state, count, process)
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        assert len(list(state.glob("*.npz"))) >= before
        before = len(list(state.glob("*.npz")))
    assert before >= 13
    process = started(located_pair, state, out)
    _, said = process.communicate(timeout=300)
    assert process.returncode == 0, said.decode()
    result = Registration.from_json(out)
    counts = result.provenance["blocks"]
    assert counts["reused"] == before
    assert counts["computed"] == counts["total"] - before
    assert result.model
    assert wanted.model
    assert np.array_equal(result.model.parameters["coefficients"], wanted.model.parameters["coefficients"])
    assert np.array_equal(result.matches.secondary_xy, wanted.matches.secondary_xy)
    assert np.array_equal(result.inliers, wanted.inliers)


@pytest.mark.slow
def test_interrupted_by_hand_it_says_how_to_go_on(located_pair: Any, tmp_path: Path) -> None:
    state, out = tmp_path / "state", tmp_path / "r.json"
    process = started(located_pair, state, out)
    wait_for_files(state, 3, process)
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=120)
    assert process.returncode == 130, said.decode()
    assert said.decode().count("\n") == 1
    assert "--resume" in said.decode()
    assert not out.exists()
    assert len(list(state.glob("*.npz"))) >= 3


def test_two_runs_on_one_folder_at_once_disturb_each_other_in_nothing(
    located_pair: Any, undisturbed: tuple[Path, Registration], tmp_path: Path
) -> None:
    state = tmp_path / "state"
    command = [*COMMAND, str(located_pair.reference), str(located_pair.secondary), "--block", "200", "--workers", "1"]
    command += ["--method", "sar-orb", "--resume", str(state)]
    running = [
        subprocess.Popen(
            [*command, "--json", str(tmp_path / f"{k}.json")], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        )
        for k in range(2)
    ]
    for k, process in enumerate(running):
        _, said = process.communicate(timeout=300)
        assert process.returncode == 0, said.decode()
        assert said == b""
        assert undisturbed_text(Registration.from_json(tmp_path / f"{k}.json")) == undisturbed_text(undisturbed[1])
    total = undisturbed[1].provenance["blocks"]["total"]
    assert len(list(state.iterdir())) == total
    assert again(located_pair, state).provenance["blocks"]["reused"] == total
