"""Calling featreg: where it is, what it is told, what it answers."""

import os
import shutil
import signal
import subprocess
import tempfile
import threading

from processing.core.ProcessingConfig import ProcessingConfig
from qgis.core import QgsProcessingException

SETTING = "FEATREG_PROGRAM"
#: QGIS sets these for its own Python and its own GDAL; featreg brings its own.
QGIS_OWN = ("PYTHONHOME", "PYTHONPATH", "GDAL_DATA", "GDAL_DRIVER_PATH", "PROJ_LIB", "PROJ_DATA")
UNTRUSTED = 3


def program():
    """Return the path of featreg: that of the settings, of the variable FEATREG_PROGRAM, or the one on PATH."""
    given = ProcessingConfig.getSetting(SETTING) or os.environ.get(SETTING) or "featreg"
    found = shutil.which(given)
    if found is None:
        raise QgsProcessingException(
            f"'{given}' is no program; install it (pip install featreg) and give its path in "
            "Settings > Options > Processing > Providers > featreg"
        )
    return found


def run(arguments, feedback):
    """Run featreg and return whether its result can be trusted.

    What it prints goes to the log; a refusal (usage, unreadable images) is raised with its own words.
    """
    command = [program(), *arguments]
    feedback.pushCommandInfo(" ".join(command))
    environment = {name: value for name, value in os.environ.items() if name not in QGIS_OWN}
    hidden = {"creationflags": subprocess.CREATE_NO_WINDOW} if os.name == "nt" else {}
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=errors, env=environment, text=True, errors="replace", **hidden
        )
        done = threading.Event()
        threading.Thread(target=_cancel, args=(process, done, feedback), daemon=True).start()
        for line in process.stdout:
            feedback.pushInfo(line.rstrip())
        code = process.wait()
        done.set()
        errors.seek(0)
        said = errors.read().decode(errors="replace").strip()
    if feedback.isCanceled():
        raise QgsProcessingException("cancelled")
    if code not in (0, UNTRUSTED):
        raise QgsProcessingException(said.removeprefix("error: ") or f"featreg ended with code {code}")
    for line in said.splitlines():
        feedback.pushWarning(line)
    if code == UNTRUSTED:
        feedback.pushWarning("The result cannot be trusted; see its reason above, and `featreg explain`.")
    return code == 0


def _cancel(process, done, feedback):
    """Stop the program as Ctrl-C does, so that it leaves nothing half written."""
    while not done.wait(0.2):
        if feedback.isCanceled():
            process.send_signal(signal.SIGTERM if os.name == "nt" else signal.SIGINT)
            return
